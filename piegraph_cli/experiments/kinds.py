"""Kinds of trouble with a recording's cameras, depth and clocks: how each is made of a good one, and what has to be said."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from piegraph_cli.environments.params import TroubleParams
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.geometry import View

Change = Callable[[list[View]], list[View]]


@dataclass(frozen=True)
class Kind:
    """One kind of trouble at one strength."""

    name: str
    strength: str
    cause: str
    """What has to be said of it: a regular expression."""
    change: Change | None = None
    """What is changed in what cameras recorded; or"""
    trouble: TroubleParams | None = None
    """what goes wrong while it is rendered; or"""
    times: Callable[[np.ndarray], np.ndarray] | None = None
    """what becomes of time stamps [frame] (s)."""


def _posed(change: Callable[[np.ndarray], np.ndarray], only: Sequence[int] = ()) -> Change:
    return lambda views: _with_poses(
        views,
        [
            change(v.camera.T_world_camera) if not only or k in only else v.camera.T_world_camera
            for k, v in enumerate(views)
        ],
    )


def _exchanged(order: dict[int, int]) -> Change:
    return lambda views: _with_poses(views, [views[order.get(k, k)].camera.T_world_camera for k in range(len(views))])


def _with_poses(views: Sequence[View], poses: Sequence[np.ndarray]) -> list[View]:
    return [View(_at(v.camera, T), v.depth, v.color) for v, T in zip(views, poses, strict=True)]


def _at(camera: Camera, T: np.ndarray) -> Camera:
    return Camera(camera.name, camera.width, camera.height, camera.K, camera.distortion, T, camera.depth_scale)


def _deep(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def changed(image: np.ndarray) -> np.ndarray:
        return np.clip(change(image), 0, 65535).astype(np.uint16)

    return lambda views: [View(v.camera, [changed(d) for d in v.depth], v.color) for v in views]


def _turned(axis: int, degrees: float, own: bool) -> Callable[[np.ndarray], np.ndarray]:
    """About an axis of the camera (`own`), or at its place about one of the world."""
    turn = cv2.Rodrigues(np.radians(degrees) * np.eye(3)[axis])[0]

    def change(T: np.ndarray) -> np.ndarray:
        changed = T.copy()
        changed[:3, :3] = T[:3, :3] @ turn if own else turn @ T[:3, :3]
        return changed

    return change


def _moved(*by: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(T: np.ndarray) -> np.ndarray:
        changed = T.copy()
        changed[:3, 3] += by
        return changed

    return change


def _stretched(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(T: np.ndarray) -> np.ndarray:
        changed = T.copy()
        changed[:3, 3] *= factor
        return changed

    return change


_OPENGL = np.diag([1.0, -1, -1, 1])
_OFF = "the pose of cam1 is off|cam1 alone disagrees|the pose of cam1$"


def kinds() -> list[Kind]:
    """All of them, two strengths each."""
    poses = [
        ("poses inverted", "all cameras", "inverting T_world_camera", _posed(np.linalg.inv)),
        ("poses inverted", "one camera", "^cam1: .*inverting T_world_camera", _posed(np.linalg.inv, [1])),
        ("poses exchanged", "two cameras", "cam0 and cam2 swapped", _exchanged({0: 2, 2: 0})),
        ("poses exchanged", "three cameras", "poses exchanged: cam0", _exchanged({0: 1, 1: 2, 2: 0})),
        ("depth too long or short", "+5 %", r"size off by \+(4.9|5.0)", _deep(lambda d: d * 1.05)),
        ("depth too long or short", "-2 %", r"size off by -(1.9|2.0|2.1)", _deep(lambda d: d * 0.98)),
        ("table off", "10 mm high", "the table lies 10 mm above", _posed(_moved(0, 0, 0.01))),
        ("table off", "30 mm low", "the table lies 30 mm below", _posed(_moved(0, 0, -0.03))),
        ("units of depth", "quarter mm", "depth_scale 0.00025", _deep(lambda d: d * 4.0)),
        ("units of depth", "whole m", "no reading above [1-3] units; metres", _deep(lambda d: np.rint(d / 1000))),
        ("units of poses", "mm", "taking the poses as millimetres", _posed(_stretched(1000))),
        (
            "units of poses",
            "mm, inverted",
            "as millimetres and inverting",
            _posed(lambda T: _stretched(1000)(np.linalg.inv(T))),
        ),
        ("OpenGL's axes", "all cameras", "OpenGL's axes", _posed(lambda T: T @ _OPENGL)),
        ("OpenGL's axes", "and inverted", "inverting .*OpenGL's axes", _posed(lambda T: np.linalg.inv(T @ _OPENGL))),
        ("z down", "all cameras", "its z points down", _posed(lambda T: _OPENGL @ T)),
        ("z down", "and inverted", "inverting .*its z points down", _posed(lambda T: np.linalg.inv(_OPENGL @ T))),
        ("one camera pitched", "1.5 deg", _OFF, _posed(_turned(0, 1.5, own=True), [1])),
        ("one camera pitched", "3 deg", _OFF, _posed(_turned(0, 3, own=True), [1])),
        ("one camera turned about the vertical", "1.5 deg", _OFF, _posed(_turned(2, 1.5, own=False), [1])),
        ("one camera turned about the vertical", "3 deg", _OFF, _posed(_turned(2, 3, own=False), [1])),
        ("one camera shifted along the table", "15 mm", _OFF, _posed(_moved(0.009, 0.012, 0), [1])),
        ("one camera shifted along the table", "25 mm", _OFF, _posed(_moved(0.015, -0.02, 0), [1])),
        ("depth beside colour", "9 px", r"moving depth by -([89]|10), ", _deep(lambda d: np.roll(d, 9, 1))),
        ("depth beside colour", "15 px", r"moving depth by -1[456], ", _deep(lambda d: np.roll(d, 15, 1))),
    ]
    found = [Kind(name, strength, cause, change) for name, strength, cause, change in poses]
    every = (0, 1, 2, 3)
    for aside in (0.03, 0.059):
        rendered = TroubleParams(aside=aside, of=every)
        found.append(
            Kind(
                "depth seen from beside",
                f"{1000 * aside:.0f} mm",
                "depth is not registered to colour",
                trouble=rendered,
            )
        )
    for late in (0.1, 0.4):
        cause = rf"clock of cam1 is {'0.(0[6-9]|1[0-4])' if late < 0.2 else '0.(3[4-9]|4[0-6])'} s late"
        found.append(Kind("one camera's clock", f"{late:g} s late", cause, trouble=TroubleParams(late=late, of=(1,))))
    found.append(Kind("units of time", "ms", "are these milliseconds", times=lambda t: 1e3 * t))
    found.append(Kind("units of time", "ns", "are these nanoseconds", times=lambda t: 1e9 * t))
    return found
