"""Settings of `ingest`."""

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from piegraph_cli.params import Box, Params, split_commas


class IngestParams(Params):
    """Settings of `ingest`: what is recorded, and where."""

    recording: Path | None = Field(None, description="recording folder (docs/formats.md)")
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
