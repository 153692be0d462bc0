"""Strokes that others measured in one file, as files for `import`: a sequence of two frames each."""

import io
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.points import read_arrays

NAMES = ("before", "after", "start", "end")
HEIGHT = 0.01
"""Metres above the table of what was measured in the plane."""
NEEDED = "before and after [S, N, 2 or 3], start and end [S, 2 or 3], metres"


def write_strokes(file: Path | None, folder: Path) -> None:
    """Write each stroke of `file` into `folder`: particles `before` and `after` it, `start` and `end` of the pusher.

    Raises `UsageError` without a file and `DataError` for one that lacks something. Files that are there stay where they
    hold the same, so that what was made of them stays fresh; those of strokes that `file` lacks go.
    """
    if file is None:
        raise UsageError("whose strokes?", "pushes", f"--data FILE.npz with {NEEDED}")
    arrays = read_arrays(file, NAMES)
    missing = [name for name in NAMES if name not in arrays]
    if missing:
        raise DataError(f"no array {missing[0]}", str(file), f"an .npz of {NEEDED}")
    before, after, start, end = (_in_space(arrays[name], name, file) for name in NAMES)
    if before.ndim != 3 or before.shape != after.shape or {start.shape, end.shape} != {(len(before), 3)}:
        raise DataError("arrays do not belong together", str(file), f"an .npz of {NEEDED}")
    if not len(before):
        raise DataError("holds no stroke", str(file), f"an .npz of {NEEDED}")
    for number in range(len(before)):
        path, stream = folder / f"{number:05d}.npz", io.BytesIO()
        np.savez(
            stream,
            particles=np.stack([before[number], after[number]]),
            end_effector=np.stack([start[number], end[number]]),
            times=np.array([0.0, 1.0]),
            contact=np.array([1, 1]),
        )
        if path.is_file() and path.read_bytes() == stream.getvalue():
            continue
        with atomic_file(path) as temporary:
            temporary.write_bytes(stream.getvalue())
    for path in folder.glob("[0-9][0-9][0-9][0-9][0-9].npz"):
        if int(path.stem) >= len(before):
            path.unlink()


def _in_space(array: np.ndarray, name: str, file: Path) -> np.ndarray:
    """Points [..., 3] of points [..., 2 or 3]."""
    if array.dtype.kind not in "fiu" or array.ndim < 2 or array.shape[-1] not in (2, 3):
        raise DataError(f"{name} is no array of points but {array.dtype} {list(array.shape)}", str(file), NEEDED)
    if array.shape[-1] == 3:
        return array
    return np.concatenate([array, np.full((*array.shape[:-1], 1), HEIGHT)], -1)
