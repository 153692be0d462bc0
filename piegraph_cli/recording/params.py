"""Settings of `ingest`."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from piegraph_cli.params import Box, Params, split_commas

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
