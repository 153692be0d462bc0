"""Outlines that people bring: the corners of a body seen from above, read from a file and checked."""

from pathlib import Path

import cv2
import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.points import read_arrays
from piegraph_cli.recording.text import read_table

NEEDED = "the outline's corners in order, x,y in metres: a line each of a .csv, or an array outline [K, 2] of an .npz"
LARGEST, SMALLEST = 5.0, 2e-3
"""Metres: an outline beyond these is in other units."""
FINE = 1e-4
"""Metres that a drawing is followed to."""
MOST = 2000
"""Corners, once those are left out that a straight line would do without."""


def read_outline(path: Path) -> np.ndarray:
    """Corners [K, 2] (m) of a body seen from above, in any frame, from a .csv or .npz; closed by itself.

    Raises `DataError` for what is no outline: too few corners, numbers that are none, other units, pieces that cross.
    """
    kind = path.suffix.lower()
    if kind == ".npz":
        arrays = read_arrays(path, ["outline"])
        if "outline" not in arrays:
            raise DataError("no array outline", str(path), f"give {NEEDED}")
        corners = arrays["outline"]
    elif kind == ".csv":
        corners = read_table(path, f"give {NEEDED}", columns=2, commas=True)
    else:
        raise DataError(
            f"cannot read an outline from {path.suffix or 'a file without suffix'}", str(path), f"give {NEEDED}"
        )
    return checked_outline(corners, str(path))


def checked_outline(corners: np.ndarray, where: str) -> np.ndarray:
    """Corners [K, 2] (m) without what adds nothing. Raises `DataError`, as `read_outline` does."""

    def refuse(message: str, hint: str = f"give {NEEDED}") -> DataError:
        return DataError(message, where, hint)

    if corners.dtype.kind not in "fiu" or corners.ndim != 2 or corners.shape[1] != 2:
        raise refuse(f"the outline is no array [K, 2] but {corners.dtype} {list(corners.shape)}")
    bad = np.flatnonzero(~np.isfinite(corners).all(1))
    if len(bad):
        raise refuse(f"corner {bad[0] + 1} of the outline is not finite")
    size = float(np.ptp(corners, axis=0).max(initial=0.0)) if len(corners) else 0.0
    if size > LARGEST:
        raise refuse(
            f"the outline is {size:.3g} m large: it is in other units", "give metres; of millimetres divide by 1000"
        )
    if 0 < size < SMALLEST:
        raise refuse(f"the outline is {size * 1000:.2g} mm large: it is in other units", "give metres")
    corners = _thinned(corners.astype(float))
    if len(corners) < 3:
        raise refuse(f"an outline of {len(corners)} corners encloses nothing")
    if len(corners) > MOST:
        raise refuse(
            f"the outline has {len(corners)} corners, at most {MOST}", "a coarser outline, 0.1 mm is fine enough"
        )
    crossing = _crossing(corners)
    if crossing is not None:
        near = ", ".join(f"{value:.3f}" for value in crossing)
        raise refuse(f"the outline crosses itself at ({near}) m", "give its corners in order, one way round")
    return corners


def _thinned(corners: np.ndarray) -> np.ndarray:
    """Without corners that lie within `FINE` of a line between others."""
    middle = corners.mean(0) if len(corners) else np.zeros(2)
    local = ((corners - middle) / FINE).astype(np.float32).reshape(-1, 1, 2)
    kept = cv2.approxPolyDP(local, 1.0, closed=True).reshape(-1, 2) if len(corners) else local.reshape(-1, 2)
    return kept.astype(float) * FINE + middle


def _crossing(corners: np.ndarray) -> np.ndarray | None:
    """Where two pieces of a closed outline that are no neighbours cross or touch, or None."""
    start, end = corners, np.roll(corners, -1, 0)
    count = len(corners)
    for k in range(count - 1):
        others = np.arange(k + 2, count - (k == 0))
        a, b, c, d = start[k], end[k], start[others], end[others]
        sides = _side(a, b, c) * _side(a, b, d), _side(c, d, a) * _side(c, d, b)
        crossed = np.flatnonzero((sides[0] <= 0) & (sides[1] <= 0) & _overlap(a, b, c, d))
        if len(crossed):
            return (a + b + c[crossed[0]] + d[crossed[0]]) / 4
    return None


def _side(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Which side of lines a-b points p are on: a sign."""
    ab, ap = b - a, p - a
    return np.sign(ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0])


def _overlap(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether the boxes of two pieces overlap: of pieces on one line, this alone tells."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    return ((np.minimum(c, d) <= high) & (np.maximum(c, d) >= low)).all(-1)
