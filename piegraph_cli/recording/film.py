"""What every reader makes of one camera in one sequence."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.recording.camera import Camera


@dataclass(frozen=True)
class Film:
    """One camera's images of a sequence, with their time stamps."""

    camera: Camera
    times: np.ndarray
    """[image] s, rising."""
    files: list[tuple[Path, Path]]
    """Colour and depth of each image."""
    numbers: np.ndarray
    """[image] what each is called by in the recording."""
