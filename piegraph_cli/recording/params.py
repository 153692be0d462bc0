"""Settings of `ingest`."""

from pathlib import Path

from pydantic import Field

from piegraph_cli.params import Box, Params


class IngestParams(Params):
    """Settings of `ingest`: what is recorded, and where."""

    recording: Path | None = Field(None, description="recording folder (docs/formats.md)")
    fps: float = Field(5.0, gt=0, description="frames a second to resample to [Hz]")
    max_skew: float = Field(0.05, gt=0, description="largest difference in time between cameras in one frame [s]")
    workspace: Box = Field(
        (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35),
        description="box of interest in the world: xmin,xmax,ymin,ymax,zmin,zmax [m]",
    )
