"""What the commands around the stages tell programs with `--json`, as models; docs/json.md is made from them."""

from typing import Any, Literal

from pydantic import BaseModel, Field

from piegraph_cli.experiments.told import Reproduced
from piegraph_cli.report.told import Reported
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.results import RESULTS as OF_STAGES
from piegraph_cli.stages.results import Error, Number, Outcomes, Result


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


class Take(Result):
    """What became of a take."""

    sequence: str
    frames: dict[str, int]
    """Images by camera."""
    dropped: dict[str, int]
    """Images that a camera left out, by the gaps between its times."""
    seconds: float
    kept: bool


class Recorded(Result):
    """What was recorded."""

    recording: str
    takes: list[Take]
    cameras: list[str]
    uncalibrated: list[str]
    """Cameras whose pose is not known."""
    next: str | None
    """Command."""


class Finding(Result):
    """What is wrong with some cameras."""

    check: str
    verdict: Literal["doubtful", "bad"]
    cameras: list[str]
    text: str
    try_: str = Field(alias="try")


class Check(Result):
    """One figure that was checked."""

    check: str
    cameras: list[str]
    figure: Number
    unit: str
    verdict: Literal["good", "doubtful", "bad"]


class Seen(Result):
    """What was seen in one set of images."""

    source: str
    verdict: Literal["good", "doubtful", "bad"]
    findings: list[Finding]
    checks: list[Check]
    points: int
    """Of the cloud."""
    particles: list[tuple[float, float, float]] | None
    """x, y, z [m]; `null` where the verdict is bad."""
    seconds: dict[str, float]
    """By what they were spent on."""
    frame: Literal["world"]
    units: Literal["m"]
    cloud: str | None
    """File that was written."""
    picture: str | None
    """File that was written."""


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


class UnpackedSequence(Result):
    """A bag that was written as image files."""

    sequence: str
    images: int
    """Of each camera."""
    warnings: list[str]


class Unpacked(Result):
    """Bags that were written as image files."""

    out: str
    sequences: list[UnpackedSequence]


class CalibratedCamera(Result):
    """How well the corners of the board fit."""

    error_px: float
    frames_px: dict[str, float]
    """By image."""
    warnings: list[str]


class Calibrated(Result):
    """Cameras located by a board."""

    cameras: dict[str, CalibratedCamera]
    sequence: str | list[str]
    """That shows the board, or those that do."""
    legacy_board: bool
    """Whether the board has the layout from before OpenCV 4.6."""
    places: int
    """Where the board lay."""
    origin: str
    """The image in which the board lies at the world's origin."""
    notes: list[str]
    picture: str
    numbers: str
    """File that keeps the errors."""


class Off(Result):
    """How far a camera's own table is from that of all."""

    off_mm: float
    off_deg: float


class Leveled(Result):
    """`calibrate --table`."""

    height_mm: float
    """By which the table lay above z = 0."""
    tilt_deg: float
    cameras: dict[str, Off]
    notes: list[str]
    picture: str
    numbers: str
    """File that keeps the errors."""


class Residual(Result):
    """Of one method of hand-eye calibration."""

    residual_mm: float
    residual_deg: float


class RobotBase(Result):
    """`calibrate --robot` or `--touched`."""

    T_world_robot: list[list[float]]
    """4 × 4, metres."""
    notes: list[str]
    off_mm: dict[str, float]
    """How far each pose or point is off."""
    methods: dict[str, Residual]


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


RESULTS: dict[str, tuple[type[BaseModel], ...]] = {
    "run": (Outcomes, Foreseen),
    "status": (Status,),
    "clean": (Cleaned,),
    "report": (Reported,),
    "record": (Recorded,),
    "look": (Seen,),
    "serve": (Serving,),
    "reproduce": (Reproduced,),
    "list": (Names,),
    "unpack": (Unpacked,),
    "calibrate": (Calibrated, Leveled, RobotBase),
    "doctor": (Machine, Fetched),
    "bench": (Bench,),
}


def results_of(command: str) -> tuple[type[BaseModel], ...]:
    """The kinds of results that a command may have. Raises KeyError where it has no `--json`."""
    if command in STAGES:
        return OF_STAGES.get(command, (Outcomes,))
    return RESULTS[command]
