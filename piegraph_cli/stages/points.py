"""Point clouds that a command is given: files of others, and artifacts of runs."""

from pathlib import Path

import numpy as np

from piegraph_cli.recording import points
from piegraph_cli.workspace.artifact import read_artifact, read_header


def read_points(path: Path, frame: int | None, key: str | None = None) -> np.ndarray:
    """Points [P, 3] float32 (m, world) of a .ply, .npz ([P, 3] or [F, P, 3]) or .h5 (clouds or tracks) file.

    Of several frames the given one, else the last; of an .npz the array called `key`, else the first. Raises `DataError`
    for what cannot be trusted to be whole.
    """
    return points.read_points(path, frame, {".h5": _frames_of_artifact}, key)


def _frames_of_artifact(path: Path) -> points.Frames:
    if read_header(path, "clouds"):
        clouds = read_artifact(path, "clouds")
        return points.Clouds(clouds["points"], clouds["offsets"])
    return read_artifact(path, "tracks")["positions"]


def read_rest(path: Path) -> np.ndarray | None:
    """The particles [N, 3] (m) of a track's first frame, which are those of all its frames; None for any other file."""
    if path.suffix != ".h5" or not read_header(path, "tracks"):
        return None
    return read_artifact(path, "tracks")["positions"][0]
