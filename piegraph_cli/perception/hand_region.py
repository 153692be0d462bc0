"""Where in an image the hand and the forearm are, from the hand's landmarks."""

import numpy as np

from piegraph_cli.recording.camera import Camera

BONES = (
    *((0, 1), (1, 2), (2, 3), (3, 4)),
    *((0, 5), (5, 6), (6, 7), (7, 8)),
    *((9, 10), (10, 11), (11, 12)),
    *((13, 14), (14, 15), (15, 16)),
    *((0, 17), (17, 18), (18, 19), (19, 20)),
    *((5, 9), (9, 13), (13, 17)),
)
"""Landmark pairs joined by a bone or by the palm's edge."""
PALM = (0, 1, 5, 9, 13, 17)
FINGER_WIDTH, FOREARM_WIDTH, FOREARM_LENGTH = 0.020, 0.085, 0.40
"""Metres."""
WRIST_TO_KNUCKLE = 0.095
"""Metres from the wrist to the middle knuckle: the scale of the hand in the image where depth is unknown."""


def hand_region(pixels: np.ndarray, depth: np.ndarray, camera: Camera, growth: float = 1.0) -> np.ndarray:
    """Pixels [H, W] bool that the hand and forearm with landmarks [21, 2] (px) cover; none where any landmark is NaN.

    `depth` [H, W] in the camera's units gives the distance and with it the width; `growth` scales every width.
    """
    import cv2

    region = np.zeros(depth.shape, np.uint8)
    if not np.isfinite(pixels).all():
        return region.astype(bool)
    scale = _pixels_per_metre(pixels, depth, camera) * growth
    corners = np.round(pixels.clip(-1e4, 1e4)).astype(np.int32)
    finger = max(1, round(FINGER_WIDTH * scale))
    for a, b in BONES:
        cv2.line(region, corners[a].tolist(), corners[b].tolist(), 1, finger)
    cv2.fillConvexPoly(region, cv2.convexHull(corners[list(PALM)]), 1)
    away = pixels[0] - pixels[9]
    away = away / max(float(np.linalg.norm(away)), 1e-6)
    elbow = np.round(pixels[0] + away * FOREARM_LENGTH * scale / growth).clip(-1e4, 1e4).astype(int)
    cv2.line(region, corners[0].tolist(), elbow.tolist(), 1, max(1, round(FOREARM_WIDTH * scale)))
    return region.astype(bool)


def _pixels_per_metre(pixels: np.ndarray, depth: np.ndarray, camera: Camera) -> float:
    columns, rows = np.round(pixels[list(PALM)]).astype(int).T
    inside = (columns >= 0) & (columns < depth.shape[1]) & (rows >= 0) & (rows < depth.shape[0])
    readings = depth[rows[inside], columns[inside]]
    readings = readings[readings > 0]
    if len(readings):
        return float(camera.K[0, 0] / (np.median(readings) * camera.depth_scale))
    return float(np.linalg.norm(pixels[9] - pixels[0]) / WRIST_TO_KNUCKLE)
