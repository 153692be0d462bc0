"""The table as the ground: the rigid motion that brings it to z = 0, and the plane that several cameras see together."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piegraph_cli.recording.camera import Camera


def level(table: Sequence[float]) -> np.ndarray:
    """`T_table_world` [4, 4]: the smallest rigid motion that brings the plane z = height + ax + by to z = 0.

    `table` is height (m) and the slopes a, b; what is on the plane at x = y = 0 becomes the origin.
    """
    height, a, b = table
    return rest_on(np.array([-a, -b, 1.0]), np.array([0, 0, height]))


def rest_on(normal: np.ndarray, point: np.ndarray) -> np.ndarray:
    """[4, 4]: turns a plane's upward normal [3] onto z by the shortest way; its `point` [3] becomes the origin."""
    x, y, z = normal / np.linalg.norm(normal)
    # the turn about the axis (y, -x, 0), written without dividing by the sine of its angle
    turn = np.array(
        [[1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y], [x, y, z]]
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn, -turn @ point
    return T


def moved(points: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Points [..., 3] by a transform [4, 4]; of their own type, and untouched where the transform is none."""
    if (np.eye(4) == T).all():
        return points
    return (points @ T[:3, :3].T + T[:3, 3]).astype(points.dtype)


def on_table(camera: Camera, table: Sequence[float]) -> Camera:
    """The camera in the world whose z = 0 is the table."""
    return replace(camera, T_world_camera=level(table) @ camera.T_world_camera) if any(table) else camera


def upright(camera: Camera, table: Sequence[float]) -> Camera:
    """The camera in its own world but for the table's tilt: causes such as inverted poses are tried on what was given."""
    if not any(table[1:]):
        return camera
    T = level(table)
    T[2, 3] += table[0]
    return replace(camera, T_world_camera=T @ camera.T_world_camera)
