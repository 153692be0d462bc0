"""Settings of `ingest` and `import`."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_serializer

from piegraph_cli.params import Box, Mode, Params, Table, split_commas, split_pairs

CheckName = Literal[
    "pose", "readings", "exposure", "sharpness", "table", "view", "edges", "clouds", "outlines", "texture", "clocks"
]
"""Checks of a recording's geometry (docs/checks.md), in the order in which they are made."""

LAYOUT_HELP: dict[str, str] = {
    "piegraph": "SEQUENCE/CAMERA/color, depth and timestamps.txt, with cameras.json (docs/formats.md)",
    "tum": "TUM RGB-D: SEQUENCE/rgb.txt, depth.txt and groundtruth.txt, one camera at rest",
    "gbnd": "GBND: SEQUENCE/camera_I with images, camera_params.npy and camera_extrinsics.npy",
    "phystwin": "PhysTwin: CASE/color, depth/CAM/STEP.npy, metadata.json and calibrate.pkl; mask where there is one",
    "pgnd": "PGND, raw: SEQUENCE/camera_I/rgb, depth, timestamps.txt and calibration/; robot where there is one",
    "stills": "one moment: SCENE/NAME_color.png, NAME_depth.png and cameras.json; for a look, since nothing moves",
    "ros": "ROS bags: SEQUENCE.bag, .db3 or .mcap, or a folder SEQUENCE with a bag per camera",
}
"""Layouts of recordings that can be read; each has a module in `readers/`."""


def _several(value: object) -> object:
    """One folder means a list of one."""
    return (value,) if isinstance(value, str | Path) else value


class ReadParams(Params):
    """What reading one sequence depends on, beside where it is."""

    later = ("offsets", "tool_point", "tf_world", "tf_end_effector")

    layout: Literal["auto", "piegraph", "tum", "gbnd", "phystwin", "pgnd", "stills", "ros"] = Field(
        "auto", description="layout of the recording; auto: by what its folders hold"
    )
    fps: float = Field(5.0, gt=0, description="frames a second to resample to [Hz]")
    max_skew: float = Field(
        0.05, gt=0, description="largest difference in time between the cameras' images of a frame [s]"
    )
    offsets: Annotated[dict[str, float], BeforeValidator(split_pairs)] = Field(
        {},
        description="how late what a camera shows is against its time stamps, taken off them: CAMERA=SECONDS,... [s]",
    )
    workspace: Box = Field(
        (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35),
        description="box of interest in the world, heights from the table: xmin,xmax,ymin,ymax,zmin,zmax [m]",
    )
    table: Table = Field(
        (0.0, 0.0, 0.0),
        description="plane of the table in the cameras' world: HEIGHT [m], or HEIGHT,SLOPE_X,SLOPE_Y; it becomes z = 0",
    )
    tool_point: Annotated[tuple[float, float, float], BeforeValidator(split_commas)] = Field(
        (0.0, 0.0, 0.0), description="the tip in the frame of an end-effector that was recorded: x,y,z [m]"
    )
    tf_world: str | None = Field(
        None, description="frame of a bag's tf that is the world (default: world, map, base_link or base)"
    )
    tf_end_effector: str | None = Field(
        None, description="frame of a bag's tf that is the end-effector (default: none)"
    )
    accept: Annotated[tuple[CheckName, ...], BeforeValidator(split_commas)] = Field(
        (), description="checks of geometry that may be bad: NAME,... (docs/checks.md)"
    )

    def content(self) -> dict[str, Any]:
        """As for all settings; a table at z = 0 is written in one number."""
        return super().content() | ({} if any(self.table) else {"table": 0.0})


class SequenceParams(ReadParams):
    """What one sequence depends on."""

    recording: Path
    sequence: str
    """Its folder in the recording."""

    def content(self) -> dict[str, Any]:
        """As for all settings, without the folder's name: what it holds counts."""
        return {name: value for name, value in super().content().items() if name != "sequence"} | {"exclude": []}

    def files(self) -> dict[str, Path]:
        """The sequence's folder, which stands for its recording, and the calibration beside it that PGND has."""
        beside = self.recording / "calibration"
        found = {"recording": self.recording / self.sequence}
        return found | ({"calibration": beside} if (beside / "intrinsics.npy").is_file() else {})


class IngestParams(ReadParams):
    """Settings of `ingest`: what is recorded, and where."""

    recording: Annotated[tuple[Path, ...], BeforeValidator(_several)] = Field(
        (), description="recording folder (docs/formats.md); several of them: give it again for each"
    )
    exclude: Annotated[tuple[str, ...], BeforeValidator(split_commas)] = Field(
        (), description="sequences to leave out, by name, beside the one that shows the calibration board"
    )

    @field_serializer("recording")
    def _one_or_several(self, value: tuple[Path, ...]) -> str | list[str]:
        return str(value[0]) if len(value) == 1 else [str(path) for path in value]


class MotionParams(Params):
    """What one imported file depends on, beside its content."""

    later = ("particles",)

    mode: Mode = Field("push", description="how the hand moves the object, where the file does not say")
    radius: float = Field(
        0.03, gt=0, description="hand and particles closer than this touch, where the file has no contact [m]"
    )
    particles: int | None = Field(
        None, ge=4, description="keep so many of the particles, spread by farthest points (default: all)"
    )


class MotionFileParams(MotionParams):
    """Settings of one imported file."""

    file: Path = Field(description="file of particles over time")

    def content(self) -> dict[str, Any]:
        """As for all settings, without where the file is: what it holds counts."""
        return {name: value for name, value in super().content().items() if name != "file"}


class ImportParams(MotionParams):
    """Settings of `import`: particles over time from motion capture, another tracker or a simulator."""

    sources: Annotated[tuple[Path, ...], BeforeValidator(split_commas)] = Field(
        (), description="files .npz, .h5 or .csv, or folders of them (docs/formats.md)"
    )
