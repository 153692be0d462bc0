"""What the commands around the stages tell programs with `--json`, as models; docs/json.md is made from them."""

from typing import Any, Literal

from pydantic import BaseModel

from piegraph_cli.commands.camera_results import Calibrated, Leveled, Recorded, RobotBase, Seen, Unpacked
from piegraph_cli.experiments.told import Reproduced
from piegraph_cli.report.told import Reported
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.results import RESULTS as OF_STAGES
from piegraph_cli.stages.results import Error, Outcomes, Result


class Envelope(Result):
    """What every command prints."""

    command: str | None
    """`null` where there is no such command."""
    version: str
    """Of piegraph."""
    result: dict[str, Any] | None
    """As below; `null` where the command failed and has nothing to show."""
    warnings: list[str]
    """What was said on stderr, or among the lines for people, and should be read."""
    error: Error | None
    """`null` where the exit code is 0. Where units of a stage failed, that of the first."""


class ToMake(Result):
    """What a run would make."""

    stage: str
    unit: str | None
    reason: str


class Foreseen(Result):
    """`run --dry`."""

    run: str
    would_make: list[ToMake]


class StageCounts(Result):
    """Units of a stage by state, and what its artifacts take."""

    stage: str
    fresh: int
    stale: int
    missing: int
    failed: int
    bytes: int


class Artifact(Result):
    """One artifact of a run, or its place."""

    stage: str
    unit: str | None
    artifact: str
    """File."""
    bytes: int
    state: Literal["fresh", "stale", "missing", "failed"]
    quality: str
    """Of what is fresh."""
    failure: str
    """Why it failed."""
    reason: str
    """Why it is stale."""


class Status(Result):
    """What a run has and lacks."""

    run: str
    stages: list[StageCounts]
    bytes: int
    artifacts: list[Artifact]
    next: list[str]
    """What to do next, the first best: commands, or what mends the first failure."""


class Waste(Result):
    """A file that could go."""

    file: str
    bytes: int
    reason: str


class Cleaned(Result):
    """Files that could go, or went."""

    run: str
    removed: bool
    """Whether they were removed."""
    bytes: int
    files: list[Waste]


class Serving(Result):
    """What `serve` says at once, when it can be asked; what it answers is in docs/robot.md."""

    url: str
    model: str
    """Its label."""
    key: str | None
    """Of the model's artifact; `null` where nothing is trained."""


class Names(Result):
    """Names, each with what it is."""

    models: dict[str, str] | None = None
    environments: dict[str, str] | None = None
    recipes: dict[str, str] | None = None
    experiments: dict[str, str] | None = None
    layouts: dict[str, str] | None = None


class MachineCheck(Result):
    """One thing that was looked at."""

    name: str
    ok: bool
    needed: bool
    detail: str


class Machine(Result):
    """What this machine has and lacks."""

    checks: list[MachineCheck]


class Fetched(Result):
    """`doctor --fetch`: the file of weights."""

    fetched: str


class BenchRow(Result):
    """One measurement; what was not measured is left out."""

    subject: str
    case: str
    seconds: float
    """Median."""
    cores: int
    error: float | None = None
    """Largest deviation from the reference [m]."""
    flop: float | None = None
    bytes: float | None = None
    """Loaded and stored."""
    reference_seconds: float | None = None
    """Of the reference on the same input in the same run."""
    share: float | None = None
    """Of the machine's peak."""
    device: str
    gflops: float | None = None
    """1e9 operations a second."""
    ratio: float | None = None
    """How many times faster than the reference."""


class Bench(Result):
    """All measurements."""

    rows: list[BenchRow]


class Pretrained(Result):
    """`pretrain`: what was made, and what it has seen."""

    file: str | None
    """`null` where the hours ended before the steps; the same command goes on. Alone where the file is there already."""
    settings: dict[str, Any] | None = None
    simulators: list[str] | None = None
    seen: dict[str, Any] | None = None
    """What is drawn, by what it is."""
    strokes: int | None = None
    cpu_minutes: float | None = None
    loss: float | None = None


class SuggestedStroke(Result):
    """A stroke to record."""

    mode: Literal["push", "pick"]
    start: list[float]
    """x, y in metres."""
    end: list[float]
    """As `start`."""
    unsure: float
    """Metres: how far off its prediction may be."""
    new: float
    """0 to 1: how unlike it is to what was recorded and to those before it."""


class SuggestedStrokes(Result):
    """`suggest`."""

    strokes: list[SuggestedStroke]
    """The most telling first."""
    unsure_is: Literal["spread", "expected error", "motion"]
    recorded: int
    """Strokes that the model has learned from."""
    picture: str


RESULTS: dict[str, tuple[type[BaseModel], ...]] = {
    "run": (Outcomes, Foreseen),
    "status": (Status,),
    "clean": (Cleaned,),
    "report": (Reported,),
    "suggest": (SuggestedStrokes,),
    "record": (Recorded,),
    "look": (Seen,),
    "serve": (Serving,),
    "reproduce": (Reproduced,),
    "list": (Names,),
    "unpack": (Unpacked,),
    "pretrain": (Pretrained,),
    "calibrate": (Calibrated, Leveled, RobotBase),
    "doctor": (Machine, Fetched),
    "bench": (Bench,),
}


def results_of(command: str) -> tuple[type[BaseModel], ...]:
    """The kinds of results that a command may have. Raises KeyError where it has no `--json`."""
    if command in STAGES:
        return OF_STAGES.get(command, (Outcomes,))
    return RESULTS[command]
