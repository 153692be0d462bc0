"""Point clouds that a command is given: files of others, and artifacts of runs."""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording import points
from piegraph_cli.workspace.artifact import read_artifact


def read_points(path: Path, frame: int | None, key: str | None = None) -> np.ndarray:
    """Points [P, 3] float32 (m, world) of a .ply, .npz ([P, 3] or [F, P, 3]) or .h5 (clouds or tracks) file.

    Of several frames the given one, else the last; of an .npz the array called `key`, else the first. Raises `DataError`
    for what cannot be trusted to be whole.
    """
    return points.read_points(path, frame, {".h5": _frames_of_artifact}, key)


def _frames_of_artifact(path: Path) -> points.Frames:
    found = read_artifact(path, foreign=True)
    if found.name == "clouds":
        return points.Clouds(found["points"], found["offsets"])
    if found.name == "tracks":
        return found["positions"]
    raise DataError(f"holds {found.name}, expected clouds or tracks", str(path), "give the file of the right stage")


def read_rest(path: Path) -> np.ndarray | None:
    """The particles [N, 3] (m) of a track's first frame, which are those of all its frames; None for any other file."""
    found = read_artifact(path, foreign=True) if path.suffix.lower() == ".h5" else None
    return found["positions"][0] if found and found.name == "tracks" else None
