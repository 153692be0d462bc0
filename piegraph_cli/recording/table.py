"""Poses put right by the table that depth shows, without a board: all cameras moved as one so that it is z = 0."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording import layout
from piegraph_cli.recording.axes import Shown
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import listed
from piegraph_cli.recording.given import is_world
from piegraph_cli.recording.ground import rest_on
from piegraph_cli.recording.locate import write_cameras
from piegraph_cli.recording.planes import TOLERANCE, Plane, Rays, find_planes
from piegraph_cli.recording.shots import Shots, read_shots

LOOKS = 4
"""Images of each camera."""
APART, APART_SHARE, ASKEW = 0.007, 0.01, 2.0
"""Metres (or share of the distance) and degrees that one camera's table may be from that of all."""
STEEPEST = 30.0
"""Degrees: poses whose table is tilted by more are wrong in another way."""
MOST_CAMERAS = 6
"""Of more, each shows its largest plane as the table: not every combination is tried."""


@dataclass(frozen=True)
class Leveled:
    """What levelling did."""

    cameras: list[Camera]
    """Where they stand now."""
    height: float
    """Metres by which the table lay above z = 0, under the middle of what is seen of it."""
    tilt: float
    """Degrees by which it was tilted."""
    off: dict[str, tuple[float, float]]
    """By camera how far (m, deg) its own table is from that of all."""
    posed: bool
    """Whether there were poses before."""
    shown: list[Shown]
    file: Path
    notes: list[str]


def level_by_table(recording: Path, sequences: Sequence[str]) -> Leveled:
    """Move all cameras of a recording as one so that the table in depth is z = 0; write cameras.json.

    x and y stay as near as can be to what they were, but where the world is a camera's own frame: it begins on the table in
    the middle of that one's view, with y away from it. A camera that is alone may have no pose: its world begins on the
    table in the middle of its view, with y away from it. Raises `DataError` where no table is found, or cameras disagree.
    """
    shots = read_shots(recording, sequences, LOOKS)
    path = layout.cameras_file(shots.sequences[0])
    entries = layout.read_cameras_file(path).cameras
    unposed = [name for name in sorted(entries) if entries[name].T_world_camera is None]
    where = str(shots.sequences[0])
    if unposed and len(entries) > 1:
        raise DataError(
            f"{listed(unposed)} have no T_world_camera", str(path), "several cameras need a board to be placed"
        )
    planes, clouds = _planes(shots, where)
    cameras = shots.cameras
    if unposed:
        M, height, tilt, off = np.eye(4), 0.0, 0.0, {cameras[0].name: (0.0, 0.0)}
        cameras = [replace(cameras[0], T_world_camera=pose_over(planes[0][0], cameras[0], where))]
    else:
        first = _out_of_lens(cameras, planes, where)
        cameras = [replace(camera, T_world_camera=first @ camera.T_world_camera) for camera in cameras]
        M, height, tilt, off = move_to_table(cameras, planes, clouds, where)
        cameras = [replace(camera, T_world_camera=M @ camera.T_world_camera) for camera in cameras]
        M = M @ first
    noted: dict[str, Any] = {}
    notes = list(shots.notes)
    robot = layout.read_cameras_file(path).T_world_robot
    if robot is not None:
        noted["T_world_robot"] = None if unposed else (M @ np.array(robot)).tolist()
        notes.append("T_world_robot is taken out" if unposed else "T_world_robot is moved along")
    write_cameras(path, cameras, **noted)
    shown = [Shown(camera, shots.image(c, 0), f"{camera.name}  {shots.name(c, 0)}") for c, camera in enumerate(cameras)]
    return Leveled(cameras, height, tilt, off, not unposed, shown, path, notes)


def _planes(shots: Shots, where: str) -> tuple[list[list[Plane]], list[np.ndarray]]:
    """Of each camera the large planes, and the points [N, 3] (m) in its own frame they were found in."""
    planes, clouds = [], []
    for c, camera in enumerate(shots.cameras):
        clouds.append(_points(camera, [shots.depth(c, k) for k in range(len(shots.sequence))]))
        planes.append(find_planes(clouds[-1]))
        if not planes[-1]:
            hint = "is there depth, and a table in view?"
            raise DataError(f"camera {camera.name}: no table is found in depth", where, hint)
    return planes, clouds


def _points(camera: Camera, depths: Sequence[np.ndarray | None]) -> np.ndarray:
    """What a camera's depth images show, points [N, 3] (m) in its own frame."""
    rays = Rays.over(camera)
    clouds = [rays.points(depth) * camera.depth_scale for depth in depths if depth is not None]
    return np.concatenate([np.zeros((0, 3)), *clouds])


def pose_over(plane: Plane, camera: Camera, where: str) -> np.ndarray:
    """`T_world_camera` [4, 4] of a camera alone: z up from its table, the origin in the middle of its view, y away."""
    ray = camera.rays(np.array([[camera.width / 2, camera.height / 2]]))[0]
    toward = float(ray @ plane.normal)
    if toward <= np.sin(np.radians(5)) * np.linalg.norm(ray):
        hint = "point the camera at the table, so that its middle is in the middle of the image"
        raise DataError(f"camera {camera.name} does not look at the table", where, hint)
    up = -plane.normal
    away = np.array([0.0, 0, 1]) if toward < 0.99 * np.linalg.norm(ray) else np.array([0.0, -1, 0])
    y = away - (away @ up) * up
    y /= np.linalg.norm(y)
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3] = np.column_stack([np.cross(y, up), y, up])
    T_camera_world[:3, 3] = ray * plane.distance / toward
    return np.linalg.inv(T_camera_world)


def _out_of_lens(cameras: Sequence[Camera], planes: Sequence[Sequence[Plane]], where: str) -> np.ndarray:
    """The motion [4, 4] of a world that is one camera's own frame to one on its table; of others none."""
    lens = next((k for k, camera in enumerate(cameras) if is_world(camera)), None)
    return np.eye(4) if lens is None else pose_over(planes[lens][0], cameras[lens], where)


def move_to_table(
    cameras: Sequence[Camera], planes: Sequence[Sequence[Plane]], clouds: Sequence[np.ndarray], where: str
) -> tuple[np.ndarray, float, float, dict[str, tuple[float, float]]]:
    """The motion [4, 4] of the world that brings the table to z = 0, the table's height (m) and tilt (deg) before it,
    and how far (m, deg) each camera's table is from that of all.

    Of the planes that each camera sees those are the table that agree best and are seen most.
    """
    choices = [of if len(cameras) <= MOST_CAMERAS else of[:1] for of in planes]
    best: tuple[tuple, np.ndarray, np.ndarray, dict[str, tuple[float, float]]] | None = None
    for chosen in product(*choices):
        normal, point = _joint(cameras, chosen, clouds)
        off = {camera.name: _apart(camera, plane, normal, point) for camera, plane in zip(cameras, chosen, strict=True)}
        wrong = max(_share(o, plane) for o, plane in zip(off.values(), chosen, strict=True))
        rank = (wrong > 1, wrong if wrong > 1 else -sum(plane.share for plane in chosen))
        if best is None or rank < best[0]:
            best = rank, normal, point, off
    assert best is not None
    (wrong, _), normal, point, off = best
    if wrong:
        told = ", ".join(f"{name} {1000 * m:.0f} mm and {deg:.1f} deg" for name, (m, deg) in off.items())
        hint = "one motion cannot put them right: calibrate with a board on the table"
        raise DataError(f"the cameras do not see the same table: {told} from that of all", where, hint)
    tilt = float(np.degrees(np.arccos(np.clip(normal[2], -1, 1))))
    if tilt > STEEPEST:
        hint = "inverted poses, another camera convention, z down? `piegraph ingest` tries these (docs/checks.md)"
        raise DataError(f"the table is tilted by {tilt:.0f} deg: that is no slip of a calibration", where, hint)
    M = rest_on(normal, point)
    M[:2, 3] += point[:2]  # what is seen of the table stays where it is
    return M, float(point[2]), tilt, off


def _joint(
    cameras: Sequence[Camera], chosen: Sequence[Plane], clouds: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The plane that fits what all cameras see of theirs: upward normal [3] and middle [3] (m) in the world."""
    middles, spreads = [], []
    for camera, plane, points in zip(cameras, chosen, clouds, strict=True):
        on = points[np.abs(points @ plane.normal - plane.distance) < TOLERANCE * points[:, 2]]
        # flattened to the camera's own plane: its noise was averaged there with care
        on = on - np.outer(on @ plane.normal - plane.distance, plane.normal)
        T = camera.T_world_camera
        world = on @ T[:3, :3].T + T[:3, 3]
        middles.append(world.mean(0))
        spreads.append(np.cov(world.T, bias=True) + np.outer(middles[-1], middles[-1]))
    middle = np.mean(middles, 0)
    normal = np.linalg.eigh(np.mean(spreads, 0) - np.outer(middle, middle))[1][:, 0]
    above = np.mean([camera.T_world_camera[:3, 3] for camera in cameras], 0) - middle
    return normal * np.sign(normal @ above), middle


def _apart(camera: Camera, plane: Plane, normal: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """How far (m, deg) a camera's own table is from a plane."""
    T = camera.T_world_camera
    centre, own = T[:3, :3] @ plane.centre + T[:3, 3], -T[:3, :3] @ plane.normal
    return float(abs((centre - point) @ normal)), float(np.degrees(np.arccos(np.clip(own @ normal, -1, 1))))


def _share(off: tuple[float, float], plane: Plane) -> float:
    return max(off[0] / max(APART, APART_SHARE * plane.distance), off[1] / ASKEW)
