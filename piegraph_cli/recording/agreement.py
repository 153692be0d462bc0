"""Whether two cameras see one scene: what one sees standing on the table, the other must not see through."""

from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.recording.camera import Camera

FEWEST = 40
"""Points that are needed to compare two cameras."""
PARTS, FEWEST_IN_PART = 6, 8
"""Images are compared in so many parts across and down, those that have so many points."""
THROUGH = 0.6
"""Of the way from a thing to the table behind it, how much a camera has to see beyond the thing."""
BORDER = 0.008
"""Outlines are this share of the width wide: pixels there say nothing."""


@dataclass(frozen=True)
class Sight:
    """What one camera sees in one frame."""

    camera: Camera
    depth: np.ndarray
    """[H, W] metres, 0 for no reading."""
    nearest: np.ndarray
    """[H, W] metres: the nearest reading beside each pixel, 0 for none."""
    surface: np.ndarray
    """[N, 3] points of everything, in the camera's frame, metres."""
    things: np.ndarray
    """[M, 3] points above the table, in the camera's frame, metres."""

    @classmethod
    def of(cls, camera: Camera, depth: np.ndarray, stands: np.ndarray, surface: np.ndarray, most: int = 400) -> "Sight":
        """From a depth image [H, W] in the camera's units, the mask of what stands on the table, and points in metres."""
        import cv2

        inner = cv2.erode(stands.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        pixels = np.argwhere(inner)[:, ::-1]
        pixels = pixels[:: max(1, len(pixels) // most)]
        metres = depth * np.float32(camera.depth_scale)
        things = camera.rays(pixels) * metres[pixels[:, 1], pixels[:, 0], None]
        size = 2 * max(1, round(BORDER * camera.width)) + 1
        nearest = cv2.erode(np.where(metres > 0, metres, np.float32(np.inf)), np.ones((size, size), np.uint8))
        nearest[~np.isfinite(nearest)] = 0
        return cls(camera, metres, nearest, surface[:: max(1, len(surface) // 1500)], things)


def seen_through(one: Sight, other: Sight, T_one: np.ndarray, T_other: np.ndarray, table: float) -> float:
    """Share of one's things where the other sees what is behind them, for these poses; NaN where they hardly overlap.

    `table` is its height, metres.
    """
    row, column, z, height = _looked_up(one.things, other, other.nearest, T_one, T_other)
    if len(row) < FEWEST:
        return np.nan
    # from a thing to the table behind it, along the other camera's axis
    behind = z * (height - table) / np.maximum(T_other[2, 3] - height, 0.01)
    return float(np.mean(other.nearest[row, column] > z + THROUGH * np.maximum(behind, 0)))


def apart(one: Sight, other: Sight, T_one: np.ndarray, T_other: np.ndarray) -> float:
    """Typical distance (m), along the other's rays, of one's points to what the other sees; NaN where they hardly overlap.

    Of each part of the image the median counts, so that noise, which differs from pixel to pixel, does not.
    """
    row, column, z, _ = _looked_up(one.surface, other, other.depth, T_one, T_other)
    if len(row) < FEWEST:
        return np.nan
    off = other.depth[row, column] - z
    part = row * PARTS // other.camera.height * PARTS + column * PARTS // other.camera.width
    found = [abs(float(np.median(off[part == p]))) for p in np.unique(part) if (part == p).sum() >= FEWEST_IN_PART]
    return float(np.median(found)) if found else np.nan


def _looked_up(
    points: np.ndarray, other: Sight, depth: np.ndarray, T_one: np.ndarray, T_other: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Those points in one's frame where the other's `depth` has a reading: row, column and depth (m) there, height (m)."""
    world = points @ T_one[:3, :3].T + T_one[:3, 3]
    pixels, z = replace(other.camera, T_world_camera=T_other).project(world)
    near = (z > 0.05) & (np.abs(pixels) < 1e6).all(1)
    column, row = np.rint(np.where(near[:, None], pixels, -1)).astype(int).T
    inside = near & (column >= 0) & (column < other.camera.width) & (row >= 0) & (row < other.camera.height)
    chosen = np.flatnonzero(inside)
    chosen = chosen[depth[row[chosen], column[chosen]] > 0]
    return row[chosen], column[chosen], z[chosen], world[chosen, 2]
