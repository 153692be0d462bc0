"""The slips that are made with poses and depth, as changes that undo them: units, inverses, axes, the world's up."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Change:
    """One thing that may be wrong, and how to undo it."""

    name: str
    remedy: str
    pose: Callable[[np.ndarray], np.ndarray] = lambda T: T
    scale: float = 1.0


def _turned(T: np.ndarray, rows: np.ndarray) -> np.ndarray:
    turned = T.copy()
    turned[:3] = rows @ T[:3]
    return turned


def _parts(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def _long(T: np.ndarray, unit: float) -> np.ndarray:
    return _parts(T[:3, :3], T[:3, 3] * unit)


def _vector(T: np.ndarray) -> np.ndarray:
    """The rotation of a pose as a vector [3], radians."""
    return Rotation.from_matrix(T[:3, :3]).as_rotvec()


def _reread(T: np.ndarray, by: int) -> np.ndarray:
    """A pose the numbers of whose quaternion come in another order, `by` places on."""
    return _parts(Rotation.from_quat(np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), by)).as_matrix(), T[:3, 3])


def _shrunk(T: np.ndarray) -> np.ndarray:
    shrunk = T.copy()
    shrunk[:3, 3] /= 1000
    return shrunk


AS_IS = Change("", "")
INVERSES = (
    AS_IS,
    Change(
        "inverting T_world_camera",
        "write the inverse of each matrix: T_world_camera maps points of the camera into the world",
        lambda T: np.linalg.inv(T) if abs(np.linalg.det(T)) > 1e-9 else T,
    ),
)
AXES = (
    AS_IS,
    Change(
        "turning the camera's y and z (these poses have OpenGL's axes)",
        "negate the second and third column of the rotation: the camera looks along +z, y points down",
        lambda T: T @ np.diag([1.0, -1, -1, 1]),
    ),
)
LENGTHS = (
    AS_IS,
    Change(
        "taking the poses as millimetres", "divide the translation of T_world_camera by 1000: it is in metres", _shrunk
    ),
)
UPS = (
    AS_IS,
    Change(
        "turning the world over, since its z points down,",
        "negate the second and third row of T_world_camera: z points up, away from the table",
        lambda T: _turned(T, np.diag([1.0, -1, -1])),
    ),
    Change(
        "turning the world, since its y points up,",
        "turn the world by 90 degrees about x: z points up, away from the table",
        lambda T: _turned(T, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])),
    ),
)
DEPTHS = (AS_IS, *(Change("depth", "", scale=s) for s in (0.001, 0.25, 4.0, 1000.0, 0.1, 10.0, 0.2, 5.0, 1e-6)))
_Y_BACK, _Y_Z = np.diag([1.0, -1, 1, 1]), np.eye(4)[[0, 2, 1, 3]]
_LINK = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""The axes of an image, x right and y down, in those of a body that looks along its x with z up."""
_PLACES = (
    Change(
        "taking the poses as centimetres", "divide the translation by 100: it is in metres", lambda T: _long(T, 0.01)
    ),
    Change(
        "taking the poses as inches", "multiply the translation by 0.0254: it is in metres", lambda T: _long(T, 0.0254)
    ),
    Change(
        "taking the place in T_world_camera as that of the world in the camera (OpenCV's tvec)",
        "give the camera's place in the world, -R tvec, beside camera-to-world rotations R",
        lambda T: _parts(T[:3, :3], -T[:3, :3] @ T[:3, 3]),
    ),
)
RARE = (
    *_PLACES,
    Change(
        "transposing the rotation of T_world_camera",
        "write camera-to-world rotations beside the camera's place in the world",
        lambda T: _parts(T[:3, :3].T, T[:3, 3]),
    ),
    Change(
        "reading the quaternion with w last, where w was taken to be first,",
        "make the rotation of the quaternion x, y, z, w again",
        lambda T: _reread(T, 1),
    ),
    Change(
        "reading the quaternion with w first, where w was taken to be last,",
        "make the rotation of the quaternion w, x, y, z again",
        lambda T: _reread(T, -1),
    ),
    Change(
        "taking the rotation vector as radians, where degrees were made of it,",
        "make the rotation of the vector in radians again",
        lambda T: _parts(Rotation.from_rotvec(np.degrees(_vector(T))).as_matrix(), T[:3, 3]),
    ),
    Change(
        "turning the camera's axes (these are those of a body with x forward and z up, as ROS's camera_link),",
        "give the pose of the optical frame: z forward, x right, y down",
        lambda T: T @ _LINK,
    ),
    Change(
        "turning the camera by 180 degrees about its axis (were images turned over, or are poses left-handed?)",
        "give right-handed poses, and K, of the images as they are recorded",
        lambda T: T @ np.diag([-1.0, -1, 1, 1]),
    ),
    Change(
        "turning the world, since its x points up,",
        "turn the world by -90 degrees about y: z points up, away from the table",
        lambda T: _turned(T, np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])),
    ),
    Change(
        "turning the world, since its x points down,",
        "turn the world by 90 degrees about y: z points up, away from the table",
        lambda T: _turned(T, np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])),
    ),
    Change(
        "turning the world, since its y points down,",
        "turn the world by -90 degrees about x: z points up, away from the table",
        lambda T: _turned(T, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])),
    ),
    Change(
        "taking the world as left-handed with y up (Unity's)", "give right-handed poses", lambda T: _Y_Z @ T @ _Y_BACK
    ),
)
"""Slips that are tried, alone and with one of the usual ones, where these explain nothing and the fault is a large one."""
MOST_CHANGES = 3, 2
"""Slips that may come together; with depth among them: of many combinations one would fit by chance."""


def made(changes: tuple[Change, ...]) -> tuple[Change, ...]:
    return tuple(change for change in changes if change is not AS_IS)


COMBINED = sorted(
    (
        changes
        for changes in product(LENGTHS, INVERSES, AXES, UPS, DEPTHS)
        if 0 < len(made(changes)) <= MOST_CHANGES[changes[-1].scale != 1]
    ),
    key=lambda changes: len(made(changes)),
)
_USUAL = [change for change in (*LENGTHS, *INVERSES, *AXES, *UPS) if change is not AS_IS]
UNCOMMON: list[tuple[Change, ...]] = [*((rare,) for rare in RARE), *product(_USUAL, RARE)]
PLACES: list[tuple[Change, ...]] = [(change,) for change in _PLACES]
"""Slips of the cameras' places alone, which leave the table level: so would a table at another height."""
