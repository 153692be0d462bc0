"""How far off a track is expected to be, from what the cameras made of it: no truth is needed.

Two things tell. A shape that is not where it should be lies badly in the cloud, normals and all. And where particles are
hidden, nothing is known but that their springs hold while the object moves on. One thing does not show: a sheet that slides
within its own surface lies as well in its cloud as before, so that what it has moved counts against it.
"""

import numpy as np
import torch

from piegraph_cli.physics.rigid import rigid_projection

LEAST = 0.001
"""Metres of error that the best track has."""

STRETCH = 2.0
"""Metres of error that a metre of misfit beyond the usual one stands for. Fitted to rendered recordings."""

DRIFT = 0.5
"""Share of the object's motion by which a hidden particle may be off. Fitted to rendered recordings."""

FORGET = 0.97
"""Share of a particle's doubt that is left a frame after it is seen again: what went wrong meanwhile stays for long."""

UNKNOWN = 0.05
"""Metres by which an object that was lost may be off."""


RIGID = 2e-4
"""Metres from the first frame's shape, moved rigidly, up to which a shape is that one: then what is seen tells of the rest."""

STIFF = 0.2
"""Share of the drift that is left there."""

SHEET = 0.1
"""An object is a sheet whose particles spread less than this across its two larger extents, as a share of the second."""

SLIDE = 0.02
"""Share of its path by which a particle of a sheet may have slid along it. From rendered cloths that were picked up."""


def expected_error(positions: np.ndarray, weight: np.ndarray, misfit: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """Expected mean particle error [F] float32 (m) of tracked positions [F, N, 3] (m).

    weight [F, N]: 0 for what is not seen; misfit [F] (m) between particles and cloud, first the usual one; unknown [F]:
    frames without a cloud or with the object lost.
    """
    motion = np.zeros(len(positions))
    motion[1:] = np.median(np.linalg.norm(np.diff(positions, axis=0), axis=-1), axis=1)
    slack = np.where(_bent(positions) < RIGID, STIFF, 1.0)
    slid = np.zeros(positions.shape[:2])
    if _is_sheet(positions[0]):
        slid[1:] = SLIDE * np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=-1), axis=0)
    drift = np.zeros(positions.shape[1])
    expected = np.zeros(len(positions))
    for frame, seen in enumerate(weight > 0):
        lately = np.minimum(drift + DRIFT * slack[frame] * motion[frame], UNKNOWN)
        drift = np.where(seen, FORGET * drift, lately)
        expected[frame] = LEAST + STRETCH * max(0.0, misfit[frame] - misfit[0]) + drift.mean()
        expected[frame] += min(float(slid[frame].mean()), UNKNOWN)
    return np.where(unknown, UNKNOWN, expected).astype(np.float32)


def _is_sheet(positions: np.ndarray) -> bool:
    """Whether particles [N, 3] lie in a thin surface that extends two ways."""
    extents = np.linalg.svd(positions - positions.mean(0), compute_uv=False)
    return bool(len(extents) == 3 and extents[2] < SHEET * extents[1])


def _bent(positions: np.ndarray) -> np.ndarray:
    """Mean distance [F] (m) of each frame's particles from those of the first frame, moved rigidly."""
    moving = torch.as_tensor(positions, dtype=torch.float64)
    return (moving - rigid_projection(moving[:1], moving)).norm(dim=-1).mean(1).numpy()
