"""Cameras that stop: pictures that repeat byte for byte while all others go on, which no sensor does."""

from collections.abc import Sequence

import numpy as np

from piegraph_cli.recording.encoded import decode_image

LONG = 3
"""So many repeated pictures on end are no picture that was written twice, but a camera that stopped."""
NOISY = 0.2
"""Share of the pixels that noise changes from one picture to the next; rendered without it, a still view repeats rightly."""


def find_frozen(color: Sequence[bytes], depth: Sequence[bytes], there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which colour and which depth images bool [F, C] repeat the one before, in runs, while others change.

    `color` and `depth` are encoded images [F * C], frame by frame; `there` bool [F, C] says which were recorded.
    """
    kinds = [_grid(images, there.shape) for images in (color, depth)]
    same = np.stack([_repeats(images, there) for images in kinds])
    going_on = (~same & there).any((0, 2))
    found = [_runs(of_kind & going_on[:, None]) for of_kind in same]
    for images, repeated, frozen in zip(kinds, same, found, strict=True):
        changed = np.argwhere(~repeated[1:] & there[1:] & there[:-1])
        for c in np.flatnonzero(frozen.any(0)):
            own = changed[changed[:, 1] == c]
            pair = next(iter(own if len(own) else changed), None)  # others tell of one that never began
            if pair is None or not _noisy(images[pair[0]][pair[1]], images[pair[0] + 1][pair[1]]):
                frozen[:, c] = False
    return found[0], found[1]


def _grid(images: Sequence[bytes], shape: tuple[int, ...]) -> list[Sequence[bytes]]:
    return [images[f * shape[1] : (f + 1) * shape[1]] for f in range(shape[0])]


def _repeats(images: Sequence[Sequence[bytes]], there: np.ndarray) -> np.ndarray:
    """Which images [F, C] are those of the frame before."""
    same = np.zeros(there.shape, bool)
    for f, c in np.argwhere(there[1:] & there[:-1]):
        same[f + 1, c] = images[f + 1][c] == images[f][c]
    return same


def _runs(same: np.ndarray) -> np.ndarray:
    """Those of flags [F, C] that stand in a run of `LONG` or more."""
    length = np.zeros(same.shape, int)
    for f in range(len(same)):
        length[f] = np.where(same[f], length[f - 1] + 1 if f else 1, 0)
    for f in range(len(same) - 2, -1, -1):
        length[f] = np.where(same[f] & same[f + 1], length[f + 1], length[f])
    return length >= LONG


def _noisy(one: bytes, other: bytes) -> bool:
    import cv2

    return bool((decode_image(one, cv2.IMREAD_UNCHANGED) != decode_image(other, cv2.IMREAD_UNCHANGED)).mean() > NOISY)
