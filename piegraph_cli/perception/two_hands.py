"""Two hands in view: whether there is a second one, which landmarks are whose, and which hand handles the object."""

from collections.abc import Callable, Sequence

import numpy as np

from piegraph_cli.perception.hands import LANDMARKS, PALM, lift
from piegraph_cli.recording.camera import Camera

LOOKS = 3
"""Frames of each camera in which a second hand is looked for."""
SURE = 0.6
"""Score that a second hand must have."""
SIZES_APART = 0.6
"""Distance between two palms, in lengths of the larger, from which they are two hands."""
APART = 0.08
"""Distance (m) between two palms in space from which they are two hands."""


def look_frames(count: int) -> np.ndarray:
    """The frames of a sequence of `count` in which a second hand is looked for."""
    return np.unique(np.linspace(0, count - 1, LOOKS + 2).round().astype(int)[1:-1])


def sees_two(landmarks: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Frames [F] bool in which detections [F, 2, 21, 2] (px) with scores [F, 2] are surely two hands."""
    with np.errstate(invalid="ignore"):
        palms = landmarks[:, :, list(PALM)].mean(axis=2)
        sizes = np.linalg.norm(landmarks[:, :, 9] - landmarks[:, :, 0], axis=-1).max(axis=1)
        apart = np.linalg.norm(palms[:, 0] - palms[:, 1], axis=-1) > SIZES_APART * sizes
    return apart & (score >= SURE).all(axis=1)


def separate_hands(
    landmarks: np.ndarray, depth: Callable[[int, int], np.ndarray], cameras: Sequence[Camera]
) -> np.ndarray:
    """Each hand's landmarks [2, F, C, 21, 2] of detections [F, C, 2, 21, 2] (px, NaN where unseen) in no order.

    A detection belongs to the hand whose palm was nearest in space before; `depth(frame, camera)` as in
    `hands.lift_hands`. All belong to the first hand where no two palms are ever apart.
    """
    frames, count = landmarks.shape[:2]
    palms = np.full((frames, count, 2, 3), np.nan)
    for f, c, n in np.argwhere(np.isfinite(landmarks).all(axis=(3, 4))):
        points = lift(landmarks[f, c, n], depth(f, c), cameras[c])[1][list(PALM)]
        if np.isfinite(points).all(axis=1).any():
            palms[f, c, n] = np.nanmedian(points, axis=0)
    apart = np.linalg.norm(palms[:, :, 0] - palms[:, :, 1], axis=-1)
    separated = np.full((2, frames, count, LANDMARKS, 2), np.nan)
    with np.errstate(invalid="ignore"):
        begin = np.argwhere(apart > APART)
    if len(begin) == 0:
        separated[0] = landmarks[:, :, 0]
        return separated
    first, camera = begin[0]
    for order in (range(first, frames), range(first - 1, -1, -1)):
        last = palms[first, camera].copy()
        for f in order:
            owner = [_owners(palms[f, c], last) for c in range(count)]
            for hand in range(2):
                own = [(c, n) for c in range(count) for n in range(2) if owner[c][n] == hand]
                for c, n in own:
                    separated[hand, f, c] = landmarks[f, c, n]
                if own:
                    last[hand] = np.median([palms[f, c, n] for c, n in own], axis=0)
    return separated


def _owners(palms: np.ndarray, last: np.ndarray) -> tuple[int, int]:
    """Whose each of two palms [2, 3] is, given where the two hands [2, 3] were (m); -1 where a palm is unknown."""
    cost = np.linalg.norm(palms[:, None] - last[None], axis=-1)
    known = np.isfinite(palms).all(axis=1)
    if known.all():
        return (0, 1) if cost[0, 0] + cost[1, 1] <= cost[0, 1] + cost[1, 0] else (1, 0)
    owners = np.where(known, np.where(cost[:, 0] <= cost[:, 1], 0, 1), -1)
    return int(owners[0]), int(owners[1])


def travel(end_effector: np.ndarray) -> float:
    """How far (m) a path [F, 3] goes from its middle, outliers apart; 0 where it is unknown."""
    known = end_effector[np.isfinite(end_effector).all(axis=1)]
    if len(known) == 0:
        return 0.0
    return float(np.percentile(np.linalg.norm(known - np.median(known, axis=0), axis=1), 90))
