"""What goes wrong in a recording on purpose: things that should not be there, cameras that are not where they are said."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from piegraph_cli.environments.hand import Hand
from piegraph_cli.environments.hand_motion import Grip, arm_at, hand_colors
from piegraph_cli.environments.params import TroubleParams
from piegraph_cli.environments.render import OTHER, Part
from piegraph_cli.errors import UsageError
from piegraph_cli.recording.camera import Camera

GAP, HAND_GAP = 0.04, 0.06
"""How far a thing beside, a resting hand, stays from whatever moves, metres."""
LOW, HAND_LOW = 0.12, 0.3
"""What is higher above the table passes over things that lie on it, over a hand and its arm, metres."""
_COVER = 0.008
_HEIGHT_OF_LENGTH = 0.45
_OTHER_COLOR = np.array([[0.05, 0.28, 0.06]])
_TURN = 0.4
_RESTING = Grip(np.pi / 2, 0.0)
_SIDES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_FACES = np.array([triangle for a, b, c, d in _SIDES for triangle in ((a, b, c), (a, c, d))])


def told_cameras(cameras: Sequence[Camera], trouble: TroubleParams) -> list[Camera]:
    """The cameras as cameras.json has them."""
    turn = Rotation.from_rotvec(trouble.turned, degrees=True).as_matrix()

    def told(T: np.ndarray) -> np.ndarray:
        changed = T.copy()
        changed[:3, :3] = turn @ T[:3, :3]
        changed[:3, 3] += trouble.moved
        return changed

    if not any(trouble.turned) and not any(trouble.moved):
        return list(cameras)
    return [replace(c, T_world_camera=told(c.T_world_camera)) if k in trouble.of else c for k, c in enumerate(cameras)]


def depth_cameras(cameras: Sequence[Camera], trouble: TroubleParams) -> dict[int, Camera]:
    """The cameras that see the depth of others from beside them, by the others' numbers."""
    found = {}
    for k in trouble.of if trouble.aside else ():
        T = cameras[k].T_world_camera.copy()
        T[:3, 3] += trouble.aside * T[:3, 0]
        found[k] = replace(cameras[k], T_world_camera=T)
    return found


def lost_frames(trouble: TroubleParams, seed: int, frames: int, cameras: int) -> np.ndarray:
    """Which frames are lost, bool [F, C]; never a camera's first two."""
    lost = np.random.default_rng([seed, 4]).random((frames, cameras)) < trouble.dropped
    lost[:2] = False
    return lost


def hidden_frames(trouble: TroubleParams, frames: int) -> range:
    """The frames in which half of the object is hidden."""
    first = trouble.hidden_from if trouble.hidden_from >= 0 else max(0, (frames - trouble.hidden) // 2)
    return range(first, min(first + trouble.hidden, frames))


def trouble_arrays(trouble: TroubleParams, cameras: Sequence[Camera], kept: np.ndarray) -> dict[str, np.ndarray]:
    """What was done, for the truth: true poses of colour and depth; frames [F, C] kept, with a cover, without the object."""
    number = np.arange(len(kept))
    gone = (number >= trouble.gone_from) & (trouble.gone_from >= 0)
    aside = depth_cameras(cameras, trouble)

    def of_all(frames: np.ndarray) -> np.ndarray:
        return np.repeat(frames[:, None], len(cameras), axis=1)

    return {
        "pose/color": np.array([c.T_world_camera for c in cameras]),
        "pose/depth": np.array([aside.get(k, c).T_world_camera for k, c in enumerate(cameras)]),
        "done/kept": kept,
        "done/hidden": of_all(np.isin(number, hidden_frames(trouble, len(kept)))),
        "done/gone": of_all(gone),
    }


@dataclass(frozen=True)
class Cover:
    """An opaque box over half of the object."""

    half: np.ndarray
    """Vertices of the surface that are in the half it hides."""

    @classmethod
    def of(cls, surface: np.ndarray) -> "Cover":
        """Over one half along the longest axis of a surface [V, 3] (m)."""
        along = _axes(surface)[:, 0] @ surface[:, :2].T
        return cls(np.flatnonzero(along > (along.min() + along.max()) / 2))

    def part(self, surface: np.ndarray) -> Part:
        """The box where the surface [V, 3] (m) is now: over the half of its rectangle in which these vertices are."""
        axes = _axes(surface)
        flat = surface[:, :2] @ axes
        low, high = flat.min(0) - _COVER, flat.max(0) + _COVER
        middle = (low[0] + high[0]) / 2
        low[0], high[0] = (middle, high[0]) if flat[self.half, 0].mean() > middle else (low[0], middle)
        size = np.append(high - low, surface[:, 2].max() + _COVER)
        return _box(axes @ (low + high) / 2, size, np.arctan2(axes[1, 0], axes[0, 0]), _OTHER_COLOR)


def _axes(surface: np.ndarray) -> np.ndarray:
    """The longest axis of a surface [V, 3] seen from above, and the one across it, as columns [2, 2] of a rotation."""
    flat = surface[:, :2].astype(float) - surface[:, :2].mean(0)
    x, y = np.linalg.eigh(flat.T @ flat)[1][:, -1]
    return np.array([[x, -y], [y, x]])


def still_parts(
    trouble: TroubleParams, moving: np.ndarray, surface: np.ndarray, color: Sequence[float], hand: Hand
) -> list[Part]:
    """What lies beside the object all the time.

    `moving` [P, 3] (m) is where the object and the hand pass, `surface` [V, 3] the object at first, `color` its own.
    Raises `UsageError` where there is no room.
    """
    parts = []
    if trouble.beside != "none":
        length = trouble.beside_size
        size = np.array([length, 0.6 * length, min(_HEIGHT_OF_LENGTH * length, 0.06)])
        tint = np.array([color]) if trouble.beside == "same" else _OTHER_COLOR
        thing = _box(np.zeros(2), size, _TURN, tint)
        grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 5)] * 2), -1).reshape(-1, 2) * size[:2]
        place = _free_place(grid @ _turn(_TURN).T, moving[moving[:, 2] < LOW, :2], surface[:, :2].mean(0), 0.38, GAP)
        parts.append(replace(thing, vertices=thing.vertices + np.append(place, 0)))
        moving = np.concatenate([moving, parts[-1].vertices])
    if trouble.resting_hand:
        parts += _resting_hand(hand, moving[moving[:, 2] < HAND_LOW, :2])
    return parts


def _resting_hand(hand: Hand, taken: np.ndarray) -> list[Part]:
    """A left hand on the table, with its arm, away from places [P, 2] (m) that are taken."""
    mirror, low = np.array([-1.0, 1, 1]), arm_at(hand, _RESTING, np.zeros(3)).hand * [-1, 1, 1]
    place = _free_place(low[::7, :2], taken, np.array([-0.24, -0.16]), 0.34, HAND_GAP)
    arm = arm_at(hand, _RESTING, np.array([-place[0], place[1], 0.002 - low[:, 2].min()]))
    forearm, faces, colors = arm.forearm
    return [
        Part(arm.hand * mirror, hand.triangles[:, ::-1], OTHER, hand_colors(hand), smooth=True),
        Part(forearm * mirror, faces[:, ::-1], OTHER, colors, smooth=True),
    ]


def _free_place(thing: np.ndarray, taken: np.ndarray, near: np.ndarray, reach: float, gap: float) -> np.ndarray:
    """Where [2] (m) a thing [Q, 2] stays clear of places [P, 2] (m), as near to `near` [2] as can be."""
    line = np.arange(-reach, reach + 1e-9, 0.02)
    places = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    tree = cKDTree(taken)
    for place in places[np.argsort(np.linalg.norm(places - near, axis=1))]:
        if tree.query(thing + place)[0].min() > gap:
            return place
    raise UsageError(
        "there is no room on the table for a thing beside the object",
        "simulate.trouble",
        "a smaller beside_size, fewer strokes, or another seed",
    )


def _turn(yaw: float) -> np.ndarray:
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


def _box(middle: np.ndarray, size: np.ndarray, yaw: float, color: np.ndarray) -> Part:
    """A box on the table: middle [2], size [3] (m), turned by yaw (rad), linear RGB [1, 3]."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]])
    flat = corners * size / 2
    vertices = np.column_stack([flat[:, :2] @ _turn(yaw).T + middle, flat[:, 2]])
    return Part(vertices, _FACES, OTHER, color)
