"""Depth that another camera saw, as the colour camera would have seen it."""

from functools import lru_cache

import numpy as np

from piegraph_cli.recording.camera import Camera, straight_rays


def register_depth(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth uint16 [H, W] of the colour camera, from that [h, w] of its `depth_view`, both in its units; 0 unknown.

    Every depth pixel is cut into parts no larger than a pixel of colour; of what falls on one pixel the nearest counts.
    """
    import cv2

    view = camera.depth_view
    assert view is not None
    rows, columns = np.nonzero(depth)
    parts = max(1, int(np.ceil(1.2 * max(camera.K[0, 0] / view.K[0, 0], camera.K[1, 1] / view.K[1, 1]))))
    rays = _rays(depth.shape, view.K.tobytes(), view.distortion.tobytes(), parts)[rows, columns].reshape(-1, 3)
    metres = np.repeat(depth[rows, columns] * camera.depth_scale, parts**2)
    points = rays * metres[:, None]
    points = points @ view.T_color_depth[:3, :3].T + view.T_color_depth[:3, 3]
    points = points[points[:, 2] > 0]
    farthest = float(np.iinfo(np.uint16).max)
    nearest = np.full((camera.height, camera.width), farthest)
    if len(points):
        seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, camera.distortion)[0].reshape(-1, 2)
        x, y = np.rint(seen.clip(-1e6, 1e6)).astype(int).T
        within = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        units = np.rint(points[:, 2] / camera.depth_scale)
        np.minimum.at(nearest, (y[within], x[within]), units[within])
    return np.where(nearest < farthest, nearest, 0).astype(np.uint16)


@lru_cache(maxsize=8)
def _rays(shape: tuple[int, int], K: bytes, distortion: bytes, parts: int) -> np.ndarray:
    """Viewing rays [h, w, parts * parts, 3] of the parts of every pixel, the same for all images of a camera."""
    offsets = (np.arange(parts) + 0.5) / parts - 0.5
    dx, dy = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    rows, columns = np.indices(shape)
    pixels = np.stack([columns[..., None] + dx, rows[..., None] + dy], -1)
    rays = straight_rays(pixels.reshape(-1, 2), np.frombuffer(K).reshape(3, 3), np.frombuffer(distortion))
    return rays.reshape(*shape, parts**2, 3)
