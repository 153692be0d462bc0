"""A picture to look at after calibration: the world's axes, and the corners of the board, drawn into each camera's image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.recording.camera import Camera

LENGTH = 0.1
"""Metres of each axis."""
WIDTH = 640
"""Pixels of one camera's part of the picture."""
STEPS = 24
"""Pieces of an axis: lenses bend it, and what is behind the camera is left out."""
COLORS = {"x": (230, 40, 40), "y": (40, 170, 40), "z": (50, 90, 240)}


@dataclass(frozen=True)
class Shown:
    """One camera's part of the picture."""

    camera: Camera
    image: np.ndarray
    """RGB uint8 [H, W, 3]."""
    text: str
    corners: np.ndarray | None = None
    """[N, 2] px, what was found of the board; NaN where nothing was."""
    points: np.ndarray | None = None
    """[N, 3] m, the same in the world."""


def draw_axes(shown: Sequence[Shown]) -> np.ndarray:
    """The picture, RGB uint8: cameras side by side, two in a row.

    Red x, green y, blue z, each 10 cm long, at the world's origin. Corners found are white rings, and where the
    calibration puts them a dot.
    """
    import cv2

    tiles = []
    for one in shown:
        scale = WIDTH / one.camera.width
        height = round(one.camera.height * scale)
        tile = np.ascontiguousarray(cv2.resize(one.image, (WIDTH, height), interpolation=cv2.INTER_AREA))
        if one.corners is not None and one.points is not None:
            for found, placed in zip(one.corners * scale, one.camera.project(one.points)[0] * scale, strict=True):
                if np.isfinite(found).all():
                    cv2.circle(tile, _pixel(found), 4, (255, 255, 255), 1, cv2.LINE_AA)
                    cv2.circle(tile, _pixel(placed), 1, (255, 200, 0), -1, cv2.LINE_AA)
        for axis, (name, color) in enumerate(COLORS.items()):
            _draw_axis(tile, one.camera, axis, name, color, scale)
        cv2.rectangle(tile, (0, 0), (WIDTH, 24), (0, 0, 0), -1)
        cv2.putText(tile, one.text, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    tall = max(len(tile) for tile in tiles)
    tiles = [cv2.copyMakeBorder(t, 0, tall - len(t), 0, 0, cv2.BORDER_CONSTANT) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (len(tiles) % 2 if len(tiles) > 1 else 0)
    across = min(2, len(tiles))
    return np.concatenate([np.concatenate(tiles[k : k + across], 1) for k in range(0, len(tiles), across)])


def _draw_axis(
    tile: np.ndarray, camera: Camera, axis: int, name: str, color: tuple[int, int, int], scale: float
) -> None:
    import cv2

    points = np.zeros((STEPS + 1, 3))
    points[:, axis] = np.linspace(0, LENGTH, STEPS + 1)
    pixels, depth = camera.project(points)
    inside = (depth > 0.01) & (np.abs(pixels) < 4 * camera.width).all(1)
    for k in range(STEPS):
        if inside[k] and inside[k + 1]:
            cv2.line(tile, _pixel(pixels[k] * scale), _pixel(pixels[k + 1] * scale), color, 2, cv2.LINE_AA)
    if inside[-1]:
        cv2.putText(tile, name, _pixel(pixels[-1] * scale + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, 1, cv2.LINE_AA)


def origin_in_view(camera: Camera) -> bool:
    """Whether a camera's image shows the world's origin."""
    pixels, depth = camera.project(np.zeros((1, 3)))
    return bool(depth[0] > 0 and ((pixels[0] >= 0) & (pixels[0] < [camera.width, camera.height])).all())


def _pixel(xy: np.ndarray) -> tuple[int, int]:
    return round(float(xy[0])), round(float(xy[1]))
