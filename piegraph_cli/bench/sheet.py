"""Benchmark of tracking a sheet: a printed cloth that slides and turns on a table, seen by the rig's four cameras."""

from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np

from piegraph_cli.bench.measure import Row, check, median_seconds
from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.physics.tracking import track
from piegraph_cli.physics.visibility import View
from piegraph_cli.recording.camera import Camera

SIDE, THICK, STEP = 0.3, 0.006, 0.004
"""Metres: a square sheet, and how densely it is measured."""
WAY, TURN = 0.006, 0.03
"""Metres and radians a frame."""
FRAMES = 8
TRACKED = 5e-3
"""Metres of mean error allowed."""
CELLS, TABLE = 24, 70.0
"""Patches of the print along a side; grey of the table."""


def sheet_rows() -> Iterator[Row]:
    """A frame of tracking a sheet, four images of 424 × 318 decoded before."""
    cameras, time = camera_rig(), np.arange(FRAMES) / 5
    poses = [(WAY * k, TURN * k) for k in range(FRAMES)]
    views = [[_view(camera, pose) for camera in cameras] for pose in poses]
    line = np.arange(-SIDE / 2 + STEP / 2, SIDE / 2, STEP)
    flat = np.stack([*np.meshgrid(line, line), np.full((len(line), len(line)), THICK)], -1).reshape(-1, 3)
    clouds = [(flat @ _turned(angle).T + [way, 0, 0]).astype(np.float32) for way, angle in poses]
    found = track(clouds, views=views, time=time)
    true = np.stack([found.positions[0] @ _turned(angle).T + [way, 0, 0] for way, angle in poses])
    error = float(np.linalg.norm(found.positions - true, axis=-1).mean())
    seconds = median_seconds(lambda: track(clouds, views=views, time=time), 3) / FRAMES
    yield Row("track", "a frame of a sheet, four views", seconds, error=check("track", error, TRACKED))


def _turned(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _view(camera: Camera, pose: tuple[float, float]) -> View:
    """What a camera sees of the sheet that was moved along x (m) and turned (rad)."""
    column, row = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.rays(np.column_stack([column.ravel(), row.ravel()])) @ camera.T_world_camera[:3, :3].T
    origin = camera.T_world_camera[:3, 3]
    far = (THICK - origin[2]) / rays[:, 2]
    flat = (origin + rays * far[:, None] - [pose[0], 0, 0]) @ _turned(pose[1])
    mask = (np.abs(flat[:, :2]) < SIDE / 2).all(1)
    rng = np.random.default_rng(0)
    print_ = rng.uniform(40, 200, (CELLS, CELLS, 3)).astype(np.float32)
    at = ((flat[:, :2] / SIDE + 0.5) * (CELLS - 1)).astype(np.float32)
    shape = camera.height, camera.width
    colours = cv2.remap(print_, at[:, 0].reshape(shape), at[:, 1].reshape(shape), cv2.INTER_CUBIC)
    image = np.where(mask[:, None], colours.reshape(-1, 3), TABLE) + rng.normal(0, 1, (len(mask), 3))
    depth = np.where(mask, far, -origin[2] / rays[:, 2]) / camera.depth_scale
    made = image.clip(0, 255).astype(np.uint8).reshape(*shape, 3)
    return View(camera, np.rint(depth).astype(np.uint16).reshape(shape), mask.reshape(shape), partial(np.copy, made))
