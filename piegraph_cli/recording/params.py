"""Settings of `ingest` and `import`."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from piegraph_cli.params import Box, Mode, Params, split_commas

CheckName = Literal["pose", "readings", "exposure", "sharpness", "table", "view", "edges", "clouds", "outlines"]
"""Checks of a recording's geometry (docs/checks.md), in the order in which they are made."""

LAYOUT_HELP: dict[str, str] = {
    "piegraph": "SEQUENCE/CAMERA/color, depth and timestamps.txt, with cameras.json (docs/formats.md)",
    "tum": "TUM RGB-D: SEQUENCE/rgb.txt, depth.txt and groundtruth.txt, one camera at rest",
    "gbnd": "GBND: SEQUENCE/camera_I with images, camera_params.npy and camera_extrinsics.npy",
}
"""Layouts of recordings that can be read; each has a module in `readers/`."""


class IngestParams(Params):
    """Settings of `ingest`: what is recorded, and where."""

    recording: Path | None = Field(None, description="recording folder (docs/formats.md)")
    layout: Literal["auto", "piegraph", "tum", "gbnd"] = Field(
        "auto", description="layout of the recording; auto: by what its folders hold"
    )
    fps: float = Field(5.0, gt=0, description="frames a second to resample to [Hz]")
    max_skew: float = Field(
        0.05, gt=0, description="largest difference in time between the cameras' images of a frame [s]"
    )
    exclude: Annotated[tuple[str, ...], BeforeValidator(split_commas)] = Field(
        (), description="sequences to leave out, by name, beside the one that shows the calibration board"
    )
    workspace: Box = Field(
        (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35),
        description="box of interest in the world: xmin,xmax,ymin,ymax,zmin,zmax [m]",
    )
    tool_point: Annotated[tuple[float, float, float], BeforeValidator(split_commas)] = Field(
        (0.0, 0.0, 0.0), description="the tip in the frame of an end-effector that was recorded: x,y,z [m]"
    )
    table: float = Field(0.0, description="height of the table in the world, for the checks of geometry [m]")
    accept: Annotated[tuple[CheckName, ...], BeforeValidator(split_commas)] = Field(
        (), description="checks of geometry that may be bad: NAME,... (docs/checks.md)"
    )


class MotionParams(Params):
    """What one imported file depends on, beside its content."""

    mode: Mode = Field("push", description="how the hand moves the object, where the file does not say")
    radius: float = Field(
        0.03, gt=0, description="hand and particles closer than this touch, where the file has no contact [m]"
    )


class MotionFileParams(MotionParams):
    """Settings of one imported file."""

    file: Path = Field(description="file of particles over time")

    def content(self) -> dict[str, Any]:
        """As for all settings, without where the file is: what it holds counts."""
        return self.model_dump(mode="json", exclude={"file"})


class ImportParams(MotionParams):
    """Settings of `import`: particles over time from motion capture, another tracker or a simulator."""

    sources: Annotated[tuple[Path, ...], BeforeValidator(split_commas)] = Field(
        (), description="files .npz, .h5 or .csv, or folders of them (docs/formats.md)"
    )
