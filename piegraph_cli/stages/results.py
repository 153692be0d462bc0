"""What the stages' commands tell programs: the `result` of their `--json`, as models; docs/json.md is made from them."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Number = float | None
"""`null` where there is none: NaN and infinity are no JSON."""
Interval = tuple[Number, Number, Number]
"""Mean, and the ends of its interval (95 %)."""


class Result(BaseModel):
    """Base of all results: keys that are not described are refused. A key with a default may be left out."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)


class Error(Result):
    """Why something failed."""

    kind: Literal["usage", "data", "input", "missing", "busy", "bug", "interrupted"]
    """`usage`: a wrong option, setting or recipe; `data`: a bad recording or file; `input`: what a stage reads was not
    made yet; `missing`: a package, weights or a device that this machine lacks; `busy`: `serve` is asked too much at
    once; `bug`: one in piegraph."""
    message: str
    where: str | None
    """File, sequence, camera, frame, as far as they are known."""
    try_: str | None = Field(alias="try")
    """The command or change to try next."""
    exit_code: int
    """Of a command that ends with this: 2, 3, 3, 4, 4, 1, 130 (143 by SIGTERM, 129 by SIGHUP) in the order of the kinds."""


class Outcome(Result):
    """What became of one unit of a stage."""

    stage: str
    unit: str | None
    """A sequence, a model, a trial; `null` where the stage makes one thing of the whole run."""
    state: Literal["done", "cached", "failed"]
    """`cached`: it was fresh."""
    seconds: float
    quality: str
    """The line that people read."""
    warnings: list[str]
    error: Error | None


class Outcomes(Result):
    """What became of each unit."""

    run: str
    """Folder."""
    outcomes: list[Outcome]
    strokes_per_second: float | None = None
    """Of `simulate`, where something was made."""


class Rendered(Result):
    """`simulate --render`: the recording that was written."""

    recording: str
    sequences: list[str]


class Failed(Result):
    """A model or trial that failed."""

    model: str | None = None
    trial: str | None = None
    error: Error


class Missing(Failed):
    """A model or trial whose inputs nobody made."""

    command: str
    """It makes them."""


class Errors(Result):
    """Errors of a model's predictions over all windows of one horizon; each is [mean, low, high] of the 95 % interval."""

    model: str
    horizon: int
    """Strokes in a row."""
    windows: int
    seeds: int
    cd: Interval
    """Chamfer distance, both ways summed [cm]."""
    s: Interval
    """Shape error [cm²]."""
    cd_s: Interval = Field(alias="cd+s")
    pd: Interval
    """Particle distance [cm]."""
    pd_truth: Interval
    """To the true particles [cm]."""


class Score(Result):
    """Perception or tracking against the truth, over all frames."""

    score: str
    """Its name and unit."""
    values: int
    mean: float
    median: float
    p90: float


class Bin(Result):
    """Predictions that are as sure as one another."""

    expected: float
    """Mean expected error [m]."""
    error: float
    """Mean real one [m]."""


class Reliability(Result):
    """What error was expected of a model's predictions, by those of other sequences, and what it was."""

    model: str
    horizon: int
    """Strokes in a row."""
    predictions: int
    seeds: int
    rank: float
    """Rank correlation of expected and real errors."""
    within: float
    """Share of the real errors below the bound that should hold for nine in ten."""
    bins: list[Bin]
    """A fifth of the predictions each, the surest first."""


class Evaluation(Result):
    """Errors of all models."""

    metrics: str
    """Folder of the artifacts."""
    rows: list[Errors]
    scores: list[Score]
    reliability: list[Reliability]
    """By horizon and model, where 20 predictions and more say how sure they are."""
    missing: list[Missing]
    failed: list[Failed]


class WayPoint(Result):
    """Where the tool's tip is at a time."""

    time: float
    """From the beginning of the stroke's path [s]."""
    point: tuple[float, float, float]
    """[m], in the frame of the plan."""
    part: Literal["approach", "stroke", "retreat"]
    """What it ends."""
    closed: bool
    """Whether a gripper is closed from there on."""


class Stroke(Result):
    """A stroke of a plan. Start and end are [x, y] on the table in the run's world, or [x, y, z] in another frame."""

    episode: int
    mode: str
    """`push` or `pick`."""
    start: list[float]
    end: list[float]
    yaw: float | None = None
    """Heading about the frame's z [rad]; left out in the run's own world."""
    quaternion_xyzw: tuple[float, float, float, float] | None = None
    """Turns the frame's axes to x along the stroke and z up from the table; left out in the run's own world."""
    predicted_distance: Number
    """To the goal [m]."""
    expected_error: Number
    """How far the predicted particles may be off [m]; `null` where the model was not evaluated."""
    distance: Number = None
    """To the goal after the stroke [m], where it was executed."""
    true_distance: Number = None
    """How far it truly was then, where cameras saw it: particle distance to the nearest copy of the goal [m]."""
    blocked: bool | None = None
    """Whether the tool was stopped, where it was executed."""
    path: list[WayPoint]
    """The tool's whole way: approach, stroke, retreat."""


class Plan(Result):
    """The strokes of a plan."""

    plan: str | None
    """The artifact; `null` where it could not be kept."""
    quality: str
    """The line that people read."""
    strokes: list[Stroke]
    frame: str
    """`world` or `robot`."""
    units: Literal["m"]
    goal: str | None = None
    """In words, and in which frame it was given; of a plan from a cloud."""
    metric: str
    """The distance to the goal."""
    start_distance: list[float]
    """Of each episode [m]."""
    end_distance: list[Number] | None = None
    """Of each episode that was executed [m]."""
    ending: list[str] | None = None
    """Of each episode that was executed: `reached`, `strokes spent`, `no stroke is possible`, or `no stroke is expected to
    help`, with `--stop`."""
    expected_gain: Number = None
    """How much nearer to the goal the strokes are predicted to bring the object [m], where they were not executed."""


class Spread(Result):
    """Of final distances [m]."""

    mean: float
    low: Number
    high: Number
    median: float


class Success(Result):
    """Trials that came nearer than a threshold."""

    below: float
    """Threshold [m]."""
    rate: float
    strokes: Number
    """Median over all trials, those that never got there as more than any; `null` where these are half or more."""
    unsolved: int


class Trials(Result):
    """Trials of one model in one environment."""

    environment: str
    model: str
    trials: int
    pd: Spread
    """Particle distance."""
    cd: Spread
    """Chamfer distance, both ways summed."""
    success: list[Success]
    """By threshold."""
    seconds_per_plan: Number


class StrokesDelta(Result):
    """Cliff's δ of strokes to a threshold."""

    below: float
    """Threshold [m]."""
    delta: Interval


class Delta(Result):
    """Cliff's δ between two models; above 0: the first is better."""

    environment: str
    first: str
    second: str
    pairs: int
    """Tasks that both have; without any there is no δ."""
    pd: Interval | None = None
    strokes: list[StrokesDelta] | None = None


class TrialsResult(Result):
    """All trials of the run."""

    trials: str
    """Folder of the artifacts."""
    units: Literal["m"]
    results: list[Trials]
    cliffs_delta: list[Delta]
    missing: list[Missing]
    failed: list[Failed]


RESULTS: dict[str, tuple[type[Result], ...]] = {
    "simulate": (Outcomes, Rendered),
    "evaluate": (Evaluation,),
    "plan": (Plan,),
    "trials": (TrialsResult,),
}
"""By command, where a stage tells more than what became of each unit."""
