"""What is next to the object: whether its outline ends there, or only what the cameras can see of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.perception.parts import CELL, cells
from piegraph_cli.recording.camera import Camera

RING = (1, 3)
"""Cells around the cloud's footprint that are looked at: beyond the first, up to the last."""
NEARER, NEARER_SHARE = 0.02, 0.01
"""Depth (m, and as a share of the distance) by which something is nearer than a place that it hides."""
RIM = 0.008
"""Share of an image's width by which the object's mask is widened: there the object hides what is behind itself."""
BORDER = 0.01
"""Share of an image's width from its border within which a thing counts as cut."""
PATCH = 2
"""Pixels to each side whose median depth is taken."""


@dataclass(frozen=True)
class Unseen:
    """How much (m) of the outline of an object borders on places that no camera sees."""

    hidden: float
    """Behind something else."""
    cut: float
    """Outside every image, or outside the workspace."""


def unseen_outline(
    cloud: np.ndarray,
    masks: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    workspace: np.ndarray,
) -> Unseen:
    """Where the object of a cloud [P, 3] (m) may go on unseen, by its masks [H, W] and the depths [H, W] of all cameras.

    A place beside it is seen where a camera looks at it or through it, at half the object's height; the object's own
    shadow is no place that it could go on in. Where a camera has no depth nothing is known, and nothing said.
    """
    places, outside = _ring(cloud, np.asarray(workspace, float))
    seen = np.zeros(len(places), bool)
    away = np.ones(len(places), bool)
    for mask, depth, camera in zip(masks, depths, cameras, strict=True):
        views, inside = _look_at(places, mask, depth, camera)
        seen |= views
        away &= ~inside
    cut = outside | (away & ~seen)
    per_cell = CELL / (RING[1] - RING[0])
    ends = np.unique(np.floor(cloud[_at_border(cloud, cameras, workspace)] / CELL), axis=0)
    return Unseen(float((~seen & ~cut).sum() * per_cell), float((cut.sum() + len(ends)) * per_cell))


def _at_border(cloud: np.ndarray, cameras: Sequence[Camera], workspace: np.ndarray) -> np.ndarray:
    """Which points [P] lie at the border of every image that shows them, or at the workspace's ceiling: an arm does."""
    border = np.ones(len(cloud), bool)
    for camera in cameras:
        pixels, distance = camera.project(cloud)
        size, margin = np.array([camera.width, camera.height]), BORDER * camera.width
        border &= (distance <= 0) | (pixels < margin).any(1) | (pixels > size - 1 - margin).any(1)
    return border | (cloud[:, 2] > workspace[2, 1] - CELL)


def _ring(cloud: np.ndarray, workspace: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [K, 3] (m) around the object at half its height, and which of them [K] lie outside the workspace."""
    import cv2

    margin = (RING[1] + 2) * CELL
    low = cloud[:, :2].min(0) - margin
    shape = tuple(np.ceil((cloud[:, :2].max(0) + margin - low) / CELL).astype(int) + 1)
    footprint = cv2.morphologyEx(cells(cloud, low, shape).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    inner, outer = (cv2.dilate(footprint, np.ones((2 * n + 1,) * 2, np.uint8)) > 0 for n in RING)
    flat = np.argwhere(outer & ~inner) * CELL + low + CELL / 2
    height = max(float(np.percentile(cloud[:, 2], 95)) / 2, 0.0)
    outside = ((flat < workspace[:2, 0]) | (flat > workspace[:2, 1])).any(1)
    return np.column_stack([flat, np.full(len(flat), height)]), outside


def _look_at(places: np.ndarray, mask: np.ndarray, depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Which places [K] a camera sees, and which lie in its image."""
    import cv2

    pixels, distance = camera.project(places)
    columns, rows = np.round(pixels.clip(-1e6, 1e6)).astype(int).T
    inside = (distance > 0) & (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    columns, rows, distance = columns[inside], rows[inside], distance[inside]
    width = 2 * round(RIM * camera.width) + 1
    own = cv2.dilate(mask.astype(np.uint8), np.ones((width, width), np.uint8))[rows, columns] > 0
    steps = np.arange(-PATCH, PATCH + 1)
    patch_rows = (rows[:, None, None] + steps[:, None]).clip(0, camera.height - 1)
    patch_columns = (columns[:, None, None] + steps).clip(0, camera.width - 1)
    readings = depth[patch_rows, patch_columns].reshape(len(rows), len(steps) ** 2) * np.float64(camera.depth_scale)
    readings[readings == 0] = np.inf
    middle = np.median(readings, axis=1)
    views = np.zeros(len(places), bool)
    views[inside] = own | (middle > distance - NEARER - NEARER_SHARE * distance)
    return views, inside
