"""Where pixels lie in the world: by depth, or on the table; and which of these places lie in the workspace."""

import numpy as np

from piegraph_cli.perception.clouds import flying_pixels, kept_per_camera, world_map, world_rays
from piegraph_cli.perception.windows import WHOLE, Window
from piegraph_cli.recording.camera import Camera

EDGE = 0.012
"""Depth steps (m) above this one are edges."""


@kept_per_camera
def table_points(camera: Camera) -> np.ndarray:
    """Where each pixel's ray meets the table plane, [3, H, W] float32 (m); NaN where it does not."""
    rays, centre = world_rays(camera), camera.T_world_camera[:3, 3].astype(np.float32)
    distance = np.where(rays[2] < -1e-3, -centre[2] / rays[2], np.float32(np.nan))
    return centre[:, None, None] + rays * distance


def locate(depth: np.ndarray, camera: Camera, window: Window = WHOLE) -> np.ndarray:
    """The world point [H, W, 3] (m) of each pixel: by depth where it is reliable, else on the table plane.

    `window` as in `clouds.world_map`.
    """
    import cv2

    smooth = cv2.medianBlur(depth, 5)
    points = world_map(smooth, camera, window)
    unsure = (smooth == 0) | flying_pixels(smooth, camera, EDGE)
    table = np.moveaxis(table_points(camera)[(slice(None), *window)], 0, -1)
    np.copyto(points, table, where=unsure[..., None])
    return points


def inside(points: np.ndarray, workspace: np.ndarray) -> np.ndarray:
    """Which points [..., 3] lie in the workspace [3, 2] (m); NaN lies outside."""
    within = np.ones(points.shape[:-1], bool)
    for axis, (low, high) in enumerate(np.asarray(workspace, float)):
        within &= (points[..., axis] >= low) & (points[..., axis] <= high)
    return within
