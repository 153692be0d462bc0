"""The virtual camera rig: D455-like cameras, four or up to eight, that look down on a table from around it."""

import math

import numpy as np

from piegraph_cli.recording.camera import Camera

_FIELD_OF_VIEW = math.radians(79.5)
_PLACES = (
    *((40.0, 45.0, 0.76), (139.0, 44.0, 0.74), (207.0, 46.0, 0.77), (334.0, 44.5, 0.75)),
    *((88.0, 58.0, 0.80), (173.0, 36.0, 0.78), (7.0, 37.0, 0.76), (292.0, 62.0, 0.82)),
)
"""Azimuth and elevation (deg) and distance (m); the person stands at 270 degrees."""
_DISTORTION = (
    (-0.045, 0.052, 0.0006, -0.0004, -0.016),
    (-0.041, 0.047, -0.0003, 0.0005, -0.014),
    (-0.048, 0.055, 0.0002, 0.0007, -0.018),
    (-0.043, 0.050, -0.0005, -0.0006, -0.015),
    (-0.046, 0.053, 0.0004, 0.0003, -0.017),
    (-0.042, 0.048, 0.0003, -0.0005, -0.014),
    (-0.044, 0.051, -0.0006, 0.0002, -0.016),
    (-0.047, 0.054, -0.0002, -0.0003, -0.017),
)


def camera_rig(width: int = 424, height: int = 318, count: int = 4) -> list[Camera]:
    """Cameras 0.75 m from the middle of the table and about 45 degrees above it: one per quarter turn, then between.

    Focal length, principal point, distortion and the small differences between the cameras are those of a calibrated
    D455 colour stream: 79.5 degrees wide at any resolution.

    Source: paper, section "Real-World Experiments" (four RealSense D455); placement and calibration are this project's.
    """
    focal = width / 2 / math.tan(_FIELD_OF_VIEW / 2)
    cameras = []
    for k, (azimuth, elevation, distance) in enumerate(_PLACES[:count]):
        K = np.array(
            [
                [focal, 0, width * (0.5 + 0.004 * (k - 1.5))],
                [0, focal * 0.999, height * (0.5 - 0.005 * (k - 1.5))],
                [0, 0, 1],
            ]
        )
        pose = look_at(math.radians(azimuth), math.radians(elevation), distance)
        cameras.append(Camera(f"cam{k}", width, height, K, np.array(_DISTORTION[k]), pose))
    return cameras


def look_at(azimuth: float, elevation: float, distance: float) -> np.ndarray:
    """T_world_camera [4, 4] of a camera at these angles (rad) and distance (m) that looks at the world's origin."""
    back = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = np.column_stack([right, np.cross(-back, right), -back])
    T_world_camera[:3, 3] = back * distance
    return T_world_camera
