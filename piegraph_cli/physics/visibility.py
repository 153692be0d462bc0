"""Which points of an object the cameras see, which something hides, and where they see through to what is behind."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.recording.camera import Camera

MARGIN = 0.015
"""Metres that a surface must be in front of a point to hide it, or behind it to be seen through it: depth is noisy."""

EDGE = 2
"""Pixels around a point in which a mask may show the object: masks end at other pixels than depth does."""

AROUND = 24
"""Points that tell how the surface lies at one of them."""

FAINT = 1e-3
"""Weight of that guess beside a camera's."""


@dataclass(frozen=True)
class View:
    """What one camera sees in one frame."""

    camera: Camera
    depth: np.ndarray
    """[H, W] in the camera's units, 0 for no reading."""
    mask: np.ndarray
    """[H, W] bool: the object."""
    image: Callable[[], np.ndarray] | None = None
    """Gives its colours, RGB uint8 [H, W, 3], decoded when they are asked for; None where there are none."""

    @cached_property
    def near_mask(self) -> np.ndarray:
        """[H, W] bool: the object, or `EDGE` pixels beside it."""
        import cv2

        taps = np.zeros((2 * EDGE + 1, 2 * EDGE + 1), np.uint8)
        taps[::EDGE, ::EDGE] = 1
        return cv2.dilate(self.mask.astype(np.uint8), taps, borderType=cv2.BORDER_REPLICATE) > 0


@dataclass(frozen=True)
class Sight:
    """What all cameras of a frame make of P points."""

    seen: np.ndarray
    """[P] bool: a camera sees the object there."""
    empty: np.ndarray
    """[P] bool: no camera sees it there, and one sees what is behind."""

    @property
    def hidden(self) -> np.ndarray:
        """[P] bool: out of the pictures, or behind something, be it a hand or the object itself."""
        return ~(self.seen | self.empty)


def look(points: np.ndarray, views: Sequence[View]) -> Sight:
    """What the cameras see of points [P, 3] (m) on an object's surface. Without views all points count as seen."""
    if not views:
        return Sight(np.full(len(points), True), np.full(len(points), False))
    sights = [look_from(points, view) for view in views]
    seen = np.any([s.seen for s in sights], axis=0)
    return Sight(seen, np.any([s.empty for s in sights], axis=0) & ~seen)


def look_from(points: np.ndarray, view: View) -> Sight:
    """What one camera sees of points [P, 3] (m)."""
    pixels, distance = view.camera.project(points)
    height, width = view.mask.shape
    column, row = np.rint(pixels).T
    inside = (distance > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row, distance = column[inside].astype(np.int64), row[inside].astype(np.int64), distance[inside]
    reading = view.depth[row, column] * view.camera.depth_scale
    near_mask = view.near_mask[row, column]
    seen, empty = np.full((2, len(points)), False)
    seen[inside] = near_mask & ((reading == 0) | (reading >= distance - MARGIN))
    empty[inside] = ~near_mask & (reading > distance + MARGIN)
    return Sight(seen, empty)


def normals(cloud: np.ndarray, points: np.ndarray, views: Sequence[View]) -> np.ndarray:
    """Unit normals [P, 3] float32 of a cloud [Q, 3] (m) at some of its points [P, 3], towards the cameras that see them.

    Without views they point up and away from the middle. Source: Hoppe et al. (1992), the plane of the nearest points.
    """
    near = cloud[cKDTree(cloud).query(points, k=min(AROUND, len(cloud)))[1]]
    about = near - near.mean(1, keepdims=True)
    normal = np.linalg.eigh(np.einsum("pki,pkj->pij", about, about))[1][:, :, 0]
    outward = points - cloud.mean(0)
    towards = FAINT * (np.array([0.0, 0.0, 1.0]) + outward / np.linalg.norm(outward, axis=1, keepdims=True).clip(1e-9))
    for view in views:
        to_camera = view.camera.T_world_camera[:3, 3] - points
        shown = look_from(points, view).seen[:, None]
        towards += shown * to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
    return np.where((normal * towards).sum(1) < 0, -1.0, 1.0)[:, None] * normal
