"""Intrinsics that belong to images of another size or lens: one factor that brings the tables of several cameras to z = 0."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piegraph_cli.recording.causes import Cause, Limits, fault_of
from piegraph_cli.recording.planes import Plane

FACTORS = np.geomspace(0.3, 3.0, 231)
"""Factors of K that are tried, 1 % apart."""
UNCHANGED = 0.03
"""What is off by less is no such slip."""
CLOSE = 0.5
"""A factor is found if it brings each table within this share of what would be bad."""


def find_lens(
    planes: Sequence[Sequence[Plane]],
    poses: Sequence[np.ndarray],
    intrinsics: Sequence[np.ndarray],
    bad: Sequence[int],
    table: float,
    limits: Limits,
) -> Cause | None:
    """The factor of K, or of its focal lengths alone, that explains the faults of two cameras or more, `bad`.

    `planes` per camera in its frame (m), `poses` [4, 4] and `intrinsics` [3, 3] as they are given.
    """
    if len(bad) < 2:
        return None

    def worst(rows: list[list[float]]) -> float:
        return max(
            min(limits(fault_of(_seen_by(p, intrinsics[c], intrinsics[c] * rows), poses[c], table)) for p in planes[c])
            for c in bad
        )

    tried = [float(f) for f in FACTORS if abs(f - 1) > UNCHANGED]
    found = [(worst([[f] * 3, [f] * 3, [1] * 3]), f, True) for f in tried]
    found += [(worst([[f, 1, 1], [1, f, 1], [1, 1, 1]]), f, False) for f in tried]
    score, factor, resized = min(found)
    if score > CLOSE:
        return None
    if resized:
        text = f"K of images about {factor:.2f} times as large puts the table at z = {table:g}: were they resized?"
        return Cause(
            text, "give K of the images as they are: its first two rows, times what the images were", tuple(bad)
        )
    text = f"focal lengths {factor:.2f} times as long put the table at z = {table:g}: K is that of other images or another lens"
    return Cause(text, "give K of these images: piegraph calibrate --intrinsics", tuple(bad))


def _seen_by(plane: Plane, given: np.ndarray, K: np.ndarray) -> Plane:
    """A plane found with one K [3, 3], as it would have been with another; the lens's distortion is left alone."""
    M = np.linalg.inv(K) @ given
    M[2] = [0, 0, 1]
    normal = plane.normal @ np.linalg.inv(M)
    length = float(np.linalg.norm(normal))
    return replace(plane, normal=normal / length, distance=plane.distance / length, centre=M @ plane.centre)
