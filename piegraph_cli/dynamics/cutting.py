"""From a hand's path to strokes, straight pieces of it, and from strokes to training pairs."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from piegraph_cli.dynamics.stroke import MIN_STROKE

SMOOTHING = 2
"""Frames to either side over which a path is averaged before its bends are looked for: a tracked hand trembles."""


@dataclass(frozen=True)
class Cut:
    """What a hand's path was cut into."""

    strokes: np.ndarray
    """[S, 2] first and last frame; two pieces of one push share the frame where it was cut."""
    run: np.ndarray
    """[S] which run of contact each is of."""
    bent: int
    """Runs of contact that were cut where they bend."""
    pieces: int
    """What these were cut into."""
    short: int
    """Pieces of these that are too short to be strokes."""


def cut_strokes(end_effector: np.ndarray, contact: np.ndarray, min_length: float, max_bend: np.ndarray | float) -> Cut:
    """Strokes from the hand's path [F, 3] (m, NaN unknown) and contact [F].

    A stroke is a run of frames in contact with a known path, or, where that strays further than `max_bend` (m, or [F] by the
    run's first frame) from a straight stroke, a piece of it that does not. What has its ends closer than `min_length` (m) is
    dropped.
    """
    touching = contact & np.isfinite(end_effector).all(-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touching, [False]]).astype(np.int8))).reshape(-1, 2)
    limit = np.broadcast_to(max_bend, len(contact))
    strokes, owner, bent, pieces, short = [], [], 0, 0, 0
    for run, (first, end) in enumerate(edges):
        found = [(first + a, first + b) for a, b in straight_pieces(end_effector[first:end, :2], limit[first])]
        kept = [p for p in found if np.linalg.norm(end_effector[p[1], :2] - end_effector[p[0], :2]) >= min_length]
        strokes += kept
        owner += [run] * len(kept)
        if len(found) > 1:
            bent, pieces, short = bent + 1, pieces + len(found), short + len(found) - len(kept)
    return Cut(np.array(strokes, np.int64).reshape(-1, 2), np.array(owner, np.int64), bent, pieces, short)


def straight_pieces(path: np.ndarray, max_bend: float) -> list[tuple[int, int]]:
    """First and last row of the pieces of a path [F, 2] (m) that stay within `max_bend` (m) of a straight stroke.

    A piece may lie no further than that beside its chord, and go no further than that back along it. Source: Douglas and
    Peucker (1973), on the smoothed path; the backward motion is ours.
    """
    smooth = np.array([path[i - k : i + k + 1].mean(0) for i, k in _reaches(len(path))])
    done, open_ = [], [(0, len(path) - 1)]
    while open_:
        first, last = open_.pop()
        at = _worst_bend(smooth[first : last + 1], max_bend)
        if at is None:
            done.append((first, last))
        else:
            open_ += [(first + at, last), (first, first + at)]
    return done


def _reaches(frames: int) -> Iterator[tuple[int, int]]:
    """How many rows to either side each is averaged over: fewer near the ends, which stay where they are."""
    return ((i, min(SMOOTHING, i, frames - 1 - i)) for i in range(frames))


def _worst_bend(path: np.ndarray, max_bend: float) -> int | None:
    """The row at which to cut a path [F, 2], or None where it is straight enough."""
    if len(path) < 3:
        return None
    chord, offset = path[-1] - path[0], path - path[0]
    length = float(np.linalg.norm(chord))
    ahead = offset @ chord / length if length > 0 else np.zeros(len(path))
    direction = chord / length if length > 0 else chord
    beside = np.linalg.norm(offset - ahead.clip(0, length)[:, None] * direction, axis=1)
    inner = 1 + int(beside[1:-1].argmax())
    if beside[inner] > max_bend:
        return inner
    furthest = np.maximum.accumulate(ahead)
    turned = int((furthest - ahead).argmax())
    if furthest[turned] - ahead[turned] > max_bend:
        return int(ahead[: turned + 1].argmax())
    return None


def frame_pairs(first: int, last: int, end_effector: np.ndarray, min_gap: int) -> np.ndarray:
    """All pairs (i, j) [P, 2] of a stroke's frames at least `min_gap` apart between which the hand moved.

    Of a stroke that has no two such frames, its first and last. Part-strokes teach more than whole ones. Source: paper,
    III-D; the pairs are this project's.
    """
    i, j = np.triu_indices(last - first + 1, min(min_gap, last - first))
    moved = np.linalg.norm(end_effector[first + j, :2] - end_effector[first + i, :2], axis=-1) > MIN_STROKE
    return np.stack([first + i[moved], first + j[moved]], 1)
