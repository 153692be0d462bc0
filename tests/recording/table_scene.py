"""Depth and colour of boxes on a table, cast analytically: quick recordings whose geometry is known and can be spoilt."""

import glob
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.geometry import View
from piegraph_cli.recording.layout import read_cameras
from tests.cli import SAMPLE

WORKSPACE = np.array([[-0.45, 0.45], [-0.45, 0.45], [-0.02, 0.35]])


@dataclass(frozen=True)
class Box:
    """On the table: middle (x, y), size (x, y, z) in metres, colour."""

    middle: tuple[float, float]
    size: tuple[float, float, float]
    color: tuple[int, int, int] = (60, 90, 200)


BLOCK = (Box((0.0, 0.02), (0.16, 0.045, 0.03)), Box((0.0, -0.06), (0.045, 0.115, 0.03)))
ARM = Box((0.25, 0.1), (0.3, 0.08, 0.12), (200, 150, 120))
TABLE, FLOOR = 0.62, -0.74


def seen(camera: Camera, boxes: Sequence[Box]) -> tuple[np.ndarray, np.ndarray]:
    """True depth [H, W] (m) and colour [H, W, 3] of a table of 1.24 m with boxes on it, and the floor."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.rays(np.column_stack([columns.ravel(), rows.ravel()])) @ camera.T_world_camera[:3, :3].T
    start = camera.T_world_camera[:3, 3]
    grain = np.random.default_rng(5).uniform(0.8, 1.2, (64, 64, 1))
    depth = (FLOOR - start[2]) / rays[:, 2]
    color = np.full((len(rays), 3), 90.0)
    table = -start[2] / rays[:, 2]
    hit = start[:2] + rays[:, :2] * table[:, None]
    on = (np.abs(hit) < TABLE).all(1)
    depth = np.where(on, table, depth)
    wood = grain[tuple(((hit[on] + TABLE) * 51).astype(int).T)] * [170, 130, 90]
    color[on] = wood
    for box in boxes:
        low = np.array([*(np.array(box.middle) - np.array(box.size[:2]) / 2), 0])
        with np.errstate(divide="ignore"):
            to = np.sort((np.stack([low, low + box.size])[:, None] - start) / rays, axis=0)
        near, far = to[0].max(1), to[1].min(1)
        nearer = (near < far) & (near > 0) & (near < depth)
        depth = np.where(nearer, near, depth)
        side = to[0].argmax(1)[nearer]
        color[nearer] = np.array(box.color) * np.array([0.7, 0.85, 1.0])[side, None]
    shape = camera.height, camera.width
    return depth.reshape(shape), color.reshape(*shape, 3)


def sensed(depth: np.ndarray, color: np.ndarray, camera: Camera, noise: float, rng) -> tuple[np.ndarray, np.ndarray]:
    """Noise that grows with depth squared (m at 1 m), holes, and grain."""
    noisy = depth + noise * depth**2 * rng.standard_normal(depth.shape)
    holes = cv2.resize(rng.random((24, 32)), depth.shape[::-1], interpolation=cv2.INTER_CUBIC) > 0.93
    noisy[holes | (depth > 1.6) | (depth < 0.2)] = 0
    units = np.rint(noisy / camera.depth_scale).clip(0, 65535).astype(np.uint16)
    return units, (color + 4 * rng.standard_normal(color.shape)).clip(0, 255).astype(np.uint8)


def make_views(
    cameras: Sequence[Camera], noise: float = 0.003, boxes: Sequence[Sequence[Box]] = (BLOCK, BLOCK), seed: int = 0
) -> list[View]:
    """What cameras see, a frame for each entry of `boxes`."""
    views = []
    for k, camera in enumerate(cameras):
        rng = np.random.default_rng([seed, k])
        scenes = {of_frame: seen(camera, of_frame) for of_frame in set(map(tuple, boxes))}
        frames = [sensed(*scenes[tuple(of_frame)], camera, noise, rng) for of_frame in boxes]
        views.append(View(camera, [depth for depth, _ in frames], [color for _, color in frames]))
    return views


@cache
def boxes_on_a_table() -> list[View]:
    """Four small cameras; the second frame shows an arm."""
    return make_views(camera_rig(320, 240), boxes=(BLOCK, (*BLOCK, ARM), BLOCK))


@cache
def sample(sequence: int = 0, frames: Sequence[int] = ()) -> list[View]:
    """A few frames of the sample recording, or those that are named."""
    folder = SAMPLE / f"sequence_{sequence:04d}"
    views = []
    for camera in read_cameras(folder):
        depth, color = (sorted(glob.glob(str(folder / camera.name / kind / "*"))) for kind in ("depth", "color"))
        chosen = frames or [0, len(depth) // 3, 2 * len(depth) // 3, len(depth) - 1]
        views.append(
            View(
                camera,
                [cv2.imread(depth[k], cv2.IMREAD_UNCHANGED) for k in chosen],
                [cv2.cvtColor(cv2.imread(color[k]), cv2.COLOR_BGR2RGB) for k in chosen],
            )
        )
    return views


def with_poses(views: Sequence[View], change: Callable[[int, np.ndarray], np.ndarray]) -> list[View]:
    """The same images with other poses: `change(camera, T_world_camera)`."""
    return [
        replace(view, camera=replace(view.camera, T_world_camera=change(k, view.camera.T_world_camera)))
        for k, view in enumerate(views)
    ]


def with_depth(views: Sequence[View], change: Callable[[int, np.ndarray], np.ndarray]) -> list[View]:
    """The same cameras with other depth images: `change(camera, depth)`."""
    return [
        replace(view, depth=[np.clip(change(k, image), 0, 65535).astype(np.uint16) for image in view.depth])
        for k, view in enumerate(views)
    ]


def write_views(folder: Path, views: Sequence[View]) -> Path:
    """A recording of one sequence."""
    from piegraph_cli.recording.layout import write_cameras, write_frame, write_times

    write_cameras(folder, [view.camera for view in views])
    for view in views:
        for frame, (color, depth) in enumerate(zip(view.color, view.depth, strict=True)):
            write_frame(folder / "take", view.camera, frame, color, depth, 90)
        write_times(folder / "take", view.camera, np.arange(len(view.depth)) / 5)
    return folder
