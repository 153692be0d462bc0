"""Scenes that are hard to segment, made by ray casting, and how well their object is found in them.

`python -m tests.perception.troubles [NAME ...]` prints the intersection over union of each, and what was said of it.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.hand_region import BONES
from piegraph_cli.perception.hands import end_effector
from piegraph_cli.perception.others import without_others
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.places import inside, locate
from piegraph_cli.perception.prompts import prompted_object
from piegraph_cli.perception.seeds import find_object
from piegraph_cli.perception.segmentation import segment_sequence
from piegraph_cli.recording.camera import Camera
from tests.perception.scene import LIGHT, SKIN, TABLE, WORKSPACE, _box, _capsule, hand_pose, ring_camera

WIDTH, HEIGHT = 272, 204
CAMERAS = [ring_camera(azimuth, f"c{n}", WIDTH, HEIGHT) for n, azimuth in enumerate((0.5, 2.6, 4.4))]
FRAMES = 10
BLUE, WHITE, BLACK, RED = (40, 90, 190), (225, 222, 215), (22, 22, 24), (190, 45, 40)


@dataclass(frozen=True)
class Solid:
    """A box, standing at `at` [3] (m) and turned, or a rope through `rope` [K, 3] (m) of that radius."""

    size: tuple[float, float, float] = (0.12, 0.06, 0.03)
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    colour: tuple[int, int, int] = BLUE
    rope: tuple[tuple[float, float, float], ...] = ()
    radius: float = 0.004
    blind: bool = False
    """Whether depth has no reading on it."""

    def hit(self, origin, rays):
        if self.rope:
            ends = np.asarray(self.rope)
            cast = [_capsule(origin, rays, a, b, self.radius) for a, b in pairwise(ends)]
            reach = np.array([one for one, _ in cast])
            nearest = reach.argmin(axis=0)
            rows = np.arange(len(rays))
            return reach[nearest, rows], np.array([facing for _, facing in cast])[nearest, rows]
        lifted = origin - [0, 0, self.at[2]]
        return _box(lifted, rays, self.at[:2], self.yaw, (0, 0, *self.size[:2]), self.size[2])


@dataclass(frozen=True)
class Moment:
    """What is there in one frame: the object's solids (none where it is away), a hand by its tip, and the rest."""

    object: tuple[Solid, ...] = ()
    tip: tuple[float, float, float] | None = None
    others: tuple[Solid, ...] = ()
    other_tip: tuple[float, float, float] | None = None
    """A second hand's tip: it reaches in from -x."""


@dataclass(frozen=True)
class Trouble:
    """A scene: its moments, how its table looks, and what its depth lacks."""

    moments: Sequence[Moment]
    table: Callable[[np.ndarray], np.ndarray] = lambda floor: TABLE * (1 + 0.12 * np.sin(60 * floor[:, :1]))
    sleeve: tuple[int, int, int] = tuple(SKIN)
    flying: bool = False
    said: str = ""
    """What must be said of it: a piece of a warning or of an error."""
    settings: dict = field(default_factory=dict)


@dataclass
class Recording:
    """What the cameras record `[camera][frame]`, and the truth `object` [C, F, H, W]."""

    images: list
    depths: list
    object: np.ndarray
    hand_px: np.ndarray
    tips: np.ndarray


def record(trouble: Trouble, cameras: Sequence[Camera] = CAMERAS, seed: int = 0) -> Recording:
    """Cast a scene in all cameras; landmarks and end-effector are the true ones of the first hand."""
    hands = [None if m.tip is None else hand_pose(np.array(m.tip)) for m in trouble.moments]
    shown = [
        [
            _cast(trouble, m, h, c, seed + 100 * f + n)
            for f, (m, h) in enumerate(zip(trouble.moments, hands, strict=True))
        ]
        for n, c in enumerate(cameras)
    ]
    nobody = np.full((21, 3), np.nan)
    joints = np.array([nobody if h is None else h for h in hands])
    hand_px = np.array([[np.full((21, 2), np.nan) if h is None else c.project(h)[0] for c in cameras] for h in hands])
    return Recording(
        [[v[0] for v in row] for row in shown],
        [[v[1] for v in row] for row in shown],
        np.array([[v[2] for v in row] for row in shown]),
        hand_px,
        end_effector(joints),
    )


def _cast(trouble: Trouble, moment: Moment, hand, camera: Camera, seed: int):
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2)
    rays = camera.rays(grid) @ camera.T_world_camera[:3, :3].T
    origin = camera.T_world_camera[:3, 3]
    z = -origin[2] / rays[:, 2]
    colour = np.broadcast_to(trouble.table(origin + rays * z[:, None]), rays.shape).copy()
    normal, kind, blind = np.tile([0.0, 0.0, 1.0], (len(rays), 1)), np.zeros(len(rays), int), np.zeros(len(rays), bool)
    solids = [(1, s.hit(origin, rays), s.colour, s.blind) for s in moment.object]
    solids += [(2, s.hit(origin, rays), s.colour, s.blind) for s in moment.others]
    solids += [(2, cast, c, False) for cast, c in _arm(origin, rays, hand, trouble.sleeve)]
    if moment.other_tip is not None:
        mirrored = hand_pose(np.array(moment.other_tip) * [-1, 1, 1]) * [-1, 1, 1]
        solids += [(2, cast, c, False) for cast, c in _arm(origin, rays, mirrored, trouble.sleeve)]
    for one, (reach, facing), paint, unseen in solids:
        nearer = reach < z
        z = np.where(nearer, reach, z)
        normal[nearer], kind[nearer], colour[nearer], blind[nearer] = facing[nearer], one, paint, unseen
    shape = camera.height, camera.width
    shade = 0.45 + 0.55 * np.clip(normal @ LIGHT, 0, 1)
    image = (colour * shade[:, None] + rng.normal(0, 3, rays.shape)).clip(0, 255).astype(np.uint8).reshape(*shape, 3)
    if trouble.flying:
        z = _between(z.reshape(shape), rng).ravel()
    depth = 1000 * (z + rng.normal(0, 0.0015, len(rays)))
    depth[(rng.random(len(rays)) < 0.01) | blind] = 0
    return image, depth.clip(0, 65535).round().astype(np.uint16).reshape(shape), (kind == 1).reshape(shape)


def _arm(origin, rays, hand, sleeve):
    if hand is None:
        return []
    elbow = hand[0] + 2.5 * (hand[0] - hand[9])
    bones = [(_capsule(origin, rays, hand[a], hand[b], 0.009), SKIN) for a, b in BONES]
    arm = [
        (_capsule(origin, rays, hand[0], elbow, 0.03), sleeve),
        (_capsule(origin, rays, hand[0], hand[9], 0.02), SKIN),
    ]
    return bones + arm


def _between(z, rng):
    """Depth whose steps are smeared over two pixels, as cameras do."""
    import cv2

    low, high = cv2.erode(z, np.ones((5, 5))), cv2.dilate(z, np.ones((5, 5)))
    return np.where(high - low > 0.02, low + (high - low) * rng.random(z.shape), z)


def pushed(step=0.02, **solid) -> list[Moment]:
    """The hand comes from +x, pushes a box along -x from the fourth frame on, and lifts off."""
    box = Solid(**solid)
    moments = []
    for f in range(FRAMES):
        way = step * min(max(f - 3, 0), 5)
        edge = 0.01 + box.size[0] / 2 - way
        tip = (edge + 0.05 * max(3 - f, 0), 0.0, 0.02) if f < FRAMES - 1 else (edge + 0.22, 0.0, 0.06)
        moments.append(Moment((replace(box, at=(box.at[0] - way, box.at[1], box.at[2])),), tip))
    return moments


def beside(moments, *others):
    return [replace(m, others=m.others + others) for m in moments]


def rope_pushed(colour, radius=0.004, blind=False):
    moments = []
    for m in pushed(size=(0.008, 0.2, 0.008)):
        x = m.object[0].at[0]
        path = tuple((x + 0.02 * np.sin(y * 20), y, radius) for y in np.linspace(-0.12, 0.12, 13))
        moments.append(replace(m, object=(Solid(rope=path, radius=radius, colour=colour, blind=blind),)))
    return moments


def carried(lift, start=0):
    """The hand takes the box, lifts it, moves it along -x and lays it down; from frame `start` on."""
    moments = []
    for f in range(FRAMES):
        g = f + start
        way = 0.03 * min(max(g - 3, 0), 5)
        z = lift * np.interp(g, [2, 4, 7, 9], [0, 1, 1, 0])
        tip = (0.05 - way + 0.06 * max(2 - g, 0), 0.0, 0.035 + z)
        moments.append(Moment((Solid(at=(-way, 0.0, z)),), tip))
    return moments


def checks(one, other, side=0.04):
    def table(floor):
        odd = (np.floor(floor[:, :1] / side) + np.floor(floor[:, 1:2] / side)) % 2
        return np.where(odd > 0, one, other)

    return table


def plain(*colour):
    return lambda floor: np.broadcast_to(np.array(colour, float), (len(floor), 3))


def bright_patch(floor):
    """A window's reflection on the table."""
    near = np.exp(-(((floor[:, :2] - [-0.15, 0.15]) / 0.06) ** 4).sum(axis=1))[:, None]
    return TABLE * (1 - near) + 250.0 * near


def neighbour(gap, colour=BLUE, size=(0.12, 0.08, 0.03)):
    """A box beside the pushed one, `gap` (m) apart along y."""
    return Solid(size, (0.0, -(0.03 + size[1] / 2 + gap), 0.0), 0.0, colour)


def away(moments, frames):
    return [replace(m, object=()) if f in frames else m for f, m in enumerate(moments)]


def out_and_in():
    """The hand carries the box out of the workspace and back."""
    moments = []
    for f in range(16):
        x = np.interp(f, [2, 8, 9, 15], [0, 0.42, 0.42, 0.05])
        z = 0.06 * np.interp(f, [1, 3, 13, 15], [0, 1, 1, 0])
        hold = (x + 0.05 + 0.06 * max(2 - f, 0), 0.0, 0.035 + z)
        moments.append(Moment((Solid(at=(x, 0.0, z)),), hold))
    return moments


TROUBLES: dict[str, Callable[[], Trouble]] = {
    "nothing": lambda: Trouble(pushed()),
    "neighbour of the same colour, 12 mm": lambda: Trouble(beside(pushed(0.032), neighbour(0.012))),
    "neighbour of the same colour, 5 mm": lambda: Trouble(beside(pushed(0.032), neighbour(0.005))),
    "neighbour of the same colour, touching": lambda: Trouble(beside(pushed(0.032), neighbour(0.0))),
    "neighbour of another colour, touching": lambda: Trouble(beside(pushed(0.032), neighbour(0.0, RED))),
    "neighbour that it slides along": lambda: Trouble(beside(pushed(), neighbour(0.004))),
    "small neighbour, touching": lambda: Trouble(beside(pushed(0.032), neighbour(0.0, size=(0.04, 0.04, 0.03)))),
    "two that touch, never moved": lambda: Trouble(
        [replace(m, tip=None) for m in beside(pushed()[:1] * 4, neighbour(0.004))], said="things"
    ),
    "dark rope of 8 mm": lambda: Trouble(rope_pushed((50, 45, 40))),
    "white rope of 8 mm": lambda: Trouble(rope_pushed(WHITE)),
    "rope of 8 mm without depth": lambda: Trouble(rope_pushed((50, 45, 40), blind=True)),
    "black table": lambda: Trouble(pushed(colour=(70, 70, 72)), plain(*BLACK)),
    "black object, black table": lambda: Trouble(pushed(colour=(24, 24, 24)), plain(*BLACK)),
    "white object, white table": lambda: Trouble(pushed(colour=WHITE), plain(*WHITE)),
    "object of the table's colour": lambda: Trouble(pushed(colour=tuple(TABLE))),
    "flat object of the table's colour": lambda: Trouble(pushed(size=(0.12, 0.06, 0.01), colour=tuple(TABLE))),
    "checked table cloth": lambda: Trouble(pushed(), checks((200, 200, 200), (170, 60, 50))),
    "checked cloth, one check the object's": lambda: Trouble(pushed(), checks((200, 200, 200), BLUE)),
    "object without depth": lambda: Trouble(pushed(blind=True)),
    "dark object without depth": lambda: Trouble(pushed(blind=True, colour=(35, 33, 32))),
    "reflection on the table": lambda: Trouble(pushed(), bright_patch),
    "flying pixels": lambda: Trouble(pushed(), flying=True),
    "lifted by 6 cm": lambda: Trouble(carried(0.06)),
    "lifted by 12 cm": lambda: Trouble(carried(0.12)),
    "held from the first frame on": lambda: Trouble(carried(0.06, 4)),
    "not there in the first 3 frames": lambda: Trouble(away(carried(0.08, 1), range(3))),
    "carried out and in again": lambda: Trouble(out_and_in()),
    "resting hand": lambda: Trouble([replace(m, other_tip=(-0.2, -0.12, 0.01)) for m in pushed()]),
    "hand resting on it": lambda: Trouble(
        [replace(m, other_tip=(m.object[0].at[0] - 0.05, -0.01, 0.035)) for m in pushed()]
    ),
    "second hand comes later": lambda: Trouble(
        [replace(m, other_tip=(-0.2, 0.1, 0.01)) if f > 5 else m for f, m in enumerate(pushed())]
    ),
    "sleeve of the object's colour": lambda: Trouble(pushed(), sleeve=BLUE),
    "skin-coloured object": lambda: Trouble(pushed(colour=tuple(SKIN))),
    "box that reaches out of the workspace": lambda: Trouble(
        [
            replace(
                m,
                object=tuple(replace(s, size=(0.12, 0.1, 0.03), at=(s.at[0], 0.29, 0.0)) for s in m.object),
                tip=m.tip and (m.tip[0], 0.27, m.tip[2]),
            )
            for m in pushed()
        ],
        said="workspace",
    ),
}


def judge(trouble: Trouble, cameras: Sequence[Camera] = CAMERAS, workspace=WORKSPACE, **settings):
    """IoU [F, C] (NaN where neither has anything), and what was said: warnings, or the error."""
    recording = record(trouble, cameras)
    params = SegmentParams(**(trouble.settings | settings))
    find = prompted_object if params.prompts or params.points else find_object
    try:
        seed = find(recording.images, recording.depths, cameras, recording.hand_px, workspace, params, recording.tips)
        images, depths = without_others(recording.images, recording.depths, cameras, seed)
        masks = np.array(
            [
                segment_sequence(
                    images[c],
                    depths[c],
                    cameras[c],
                    recording.hand_px[:, c],
                    workspace,
                    seed.frame,
                    seed.masks[c],
                    params,
                    recording.tips,
                )
                for c in range(len(cameras))
            ]
        )
    except DataError as error:
        return None, [str(error)]
    truth = np.array(
        [
            [mask & inside(locate(depth, camera), workspace) for mask, depth in zip(m, d, strict=True)]
            for m, d, camera in zip(recording.object, recording.depths, cameras, strict=True)
        ]
    )
    union = (masks | truth).sum(axis=(2, 3))
    with np.errstate(invalid="ignore"):
        scores = (masks & truth).sum(axis=(2, 3)) / np.where(union > 0, union, np.nan)
    return scores.T, seed.warnings


def main() -> None:
    for name in sys.argv[1:] or TROUBLES:
        scores, said = judge(TROUBLES[name]())
        told = "; ".join(line.splitlines()[0] for line in said) or "nothing"
        if scores is None:
            print(f"{name:42} refused      {told}", flush=True)
        else:
            print(f"{name:42} {np.nanmean(scores):.3f} {np.nanmin(scores):.3f}  {told}", flush=True)


if __name__ == "__main__":
    main()
