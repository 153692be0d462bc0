"""Where pixels lie in the world: by depth, or on the table; and which of these places lie in the workspace."""

import numpy as np

from piegraph_cli.perception.clouds import flying_pixels, world_map
from piegraph_cli.recording.camera import Camera

EDGE = 0.012
"""Depth steps (m) above this one are edges."""


def table_points(camera: Camera, shape: tuple[int, int]) -> np.ndarray:
    """Where each pixel's ray meets the table plane, [H, W, 3] float32 (m); NaN where it does not."""
    one = np.full(shape, 1 / camera.depth_scale, np.float32)
    centre = camera.T_world_camera[:3, 3].astype(np.float32)
    rays = world_map(one, camera) - centre
    distance = np.where(rays[..., 2] < -1e-3, -centre[2] / rays[..., 2], np.nan)
    return centre + rays * distance[..., None]


def locate(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """The world point [H, W, 3] (m) of each pixel: by depth where it is reliable, else on the table plane."""
    import cv2

    smooth = cv2.medianBlur(depth, 5)
    points = world_map(smooth, camera)
    unsure = (smooth == 0) | flying_pixels(smooth, camera, EDGE)
    points[unsure] = table_points(camera, depth.shape)[unsure]
    return points


def inside(points: np.ndarray, workspace: np.ndarray) -> np.ndarray:
    """Which points [..., 3] lie in the workspace [3, 2] (m); NaN lies outside."""
    low, high = np.asarray(workspace, float).T
    return ((points >= low) & (points <= high)).all(axis=-1)
