"""What the commands around cameras and recordings tell programs with `--json`, as models; docs/json.md is made from them."""

from typing import Literal

from pydantic import Field

from piegraph_cli.stages.results import Number, Result


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
