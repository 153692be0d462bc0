"""Patterns on a cloth: band-limited noise over the flat cloth, the same on both faces, weaker on the back."""

import math
from typing import Literal

import cv2
import numpy as np

from piegraph_cli.environments.render import Print

_TEXEL = 0.001
_BACK = 0.5
"""Contrast of the back, times that of the front."""
_OCTAVES = 3
_PRINTED, _SPREAD = 0.22, 0.13
"""Mean and deviation of a print's albedo, of each colour."""
_FAINT = 0.15
"""Deviation of a faint pattern, as a share of the cloth's own colour."""
_MOST = 1.6
"""Deviations beyond which noise ends: no albedo is below 0."""
_CELLS = {"print": (0.007, 0.030), "faint": (0.005, 0.012)}
"""Smallest and largest details, metres."""


def printed(texture: Literal["faint", "print"], base: np.ndarray, flat: np.ndarray, rng: np.random.Generator) -> Print:
    """The pattern of a cloth of albedo `base` [3] whose points lie at flat [V, 2] (m).

    `faint` changes how light the cloth is, `print` gives each colour noise of its own.
    """
    low, high = flat.min(0), flat.max(0)
    size = np.ceil((high - low) / _TEXEL).astype(int) + 1
    if texture == "faint":
        image = base * (1 + _FAINT * _noise(rng, size, *_CELLS["faint"])[..., None])
    else:
        image = _PRINTED + _SPREAD * np.stack([_noise(rng, size, *_CELLS["print"]) for _ in range(3)], -1)
    coordinates = np.column_stack([(flat - low) / _TEXEL, np.ones(len(flat))])
    both = np.concatenate([coordinates, coordinates * [1, 1, _BACK]])
    return Print(both.astype(np.float32), image.astype(np.float32), np.asarray(base, np.float32))


def _noise(rng: np.random.Generator, size: np.ndarray, finest: float, coarsest: float) -> np.ndarray:
    """Noise [rows, columns] = [y, x] of deviation 1, with details between two sizes (m)."""
    columns, rows = size.tolist()
    total = np.zeros((rows, columns), np.float32)
    for cell in np.geomspace(finest, coarsest, _OCTAVES):
        texels = cell / _TEXEL
        grid = rng.standard_normal([math.ceil(n / texels) + 2 for n in (rows, columns)], np.float32)
        wide = cv2.resize(grid, None, fx=texels, fy=texels, interpolation=cv2.INTER_CUBIC)
        total += wide[:rows, :columns]
    return (total / total.std()).clip(-_MOST, _MOST)
