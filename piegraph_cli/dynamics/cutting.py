"""From a hand's path to strokes, and from strokes to training pairs."""

import numpy as np

from piegraph_cli.dynamics.stroke import MIN_STROKE


def cut_strokes(end_effector: np.ndarray, contact: np.ndarray, min_length: float) -> np.ndarray:
    """Strokes [S, 2] (first and last frame) from the hand's path [F, 3] (m, NaN unknown) and contact [F].

    A stroke is a run of frames in contact with a known path; one whose ends are closer than `min_length` (m) is dropped.
    """
    touching = contact & np.isfinite(end_effector).all(-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touching, [False]]).astype(np.int8)))
    runs = [(first, last - 1) for first, last in edges.reshape(-1, 2)]
    far = [np.linalg.norm(end_effector[last, :2] - end_effector[first, :2]) >= min_length for first, last in runs]
    return np.array([run for run, keep in zip(runs, far, strict=True) if keep], np.int64).reshape(-1, 2)


def frame_pairs(first: int, last: int, end_effector: np.ndarray, min_gap: int) -> np.ndarray:
    """All pairs (i, j) [P, 2] of a stroke's frames at least `min_gap` apart between which the hand moved.

    Part-strokes teach more than whole ones. Source: paper, III-D; the pairs are this project's.
    """
    i, j = np.triu_indices(last - first + 1, min_gap)
    moved = np.linalg.norm(end_effector[first + j, :2] - end_effector[first + i, :2], axis=-1) > MIN_STROKE
    return np.stack([first + i[moved], first + j[moved]], 1)
