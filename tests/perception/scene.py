"""A tiny ray caster: a T of two boxes on a striped table, and a hand and forearm of skin-coloured capsules."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.perception.hand_region import BONES
from piegraph_cli.recording.camera import Camera

WORKSPACE = np.array([[-0.3, 0.3], [-0.3, 0.3], [-0.02, 0.2]])
TABLE, BLUE, SKIN = np.array([150, 110, 75]), np.array([40, 90, 190]), np.array([215, 165, 140])
DISTANCE = 0.75
LIGHT = np.array([0.3, 0.2, 0.93])


def ring_camera(azimuth: float, name: str = "cam", width: int = 212, height: int = 159) -> Camera:
    """A camera 45 degrees above the table, looking at its origin."""
    position = DISTANCE * np.array([np.cos(azimuth) * 0.7071, np.sin(azimuth) * 0.7071, 0.7071])
    forward = -position / DISTANCE
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, position])
    K = np.array([[0.95 * width, 0, width / 2 - 0.5], [0, 0.95 * width, height / 2 - 0.5], [0, 0, 1]])
    return Camera(name, width, height, K, np.array([0.05, -0.03, 0.001, -0.001, 0.01]), pose)


@dataclass
class View:
    """What one camera records, and the truth: image [H, W, 3], depth uint16 mm [H, W], object, hand and boxes [H, W] bool."""

    image: np.ndarray
    depth: np.ndarray
    object: np.ndarray
    hand: np.ndarray
    beside: np.ndarray


def hand_pose(tip: np.ndarray) -> np.ndarray:
    """Landmarks [21, 3] (m) of a hand with its index and middle finger tips beside `tip`, reaching in from +x."""
    hand = np.zeros((21, 3))
    hand[0] = [0.16, 0, 0.06]
    hand[1:5] = np.linspace([0.13, -0.035, 0.045], [0.06, -0.055, 0.02], 4)
    for finger, y in enumerate((-0.010, 0.010, 0.030, 0.050)):
        hand[5 + 4 * finger : 9 + 4 * finger] = np.linspace([0.075, y, 0.045], [0.0, y * 0.999, 0.0], 4)
    return hand + tip


@dataclass(frozen=True)
class Box:
    """A box that lies beside the T, sizes in metres."""

    centre: tuple[float, float]
    size: tuple[float, float, float]
    colour: tuple[int, int, int] = (40, 90, 190)


def render(
    camera: Camera,
    centre: tuple,
    yaw: float,
    hand: np.ndarray | None,
    height: float = 0.03,
    seed: int = 0,
    beside: Sequence[Box] = (),
    stick: tuple[np.ndarray, np.ndarray, float] | None = None,
) -> View:
    """One view of the T at `centre` [2] (m), turned by `yaw`, `height` (m) thick, with or without hand, boxes and stick.

    `stick` is a capsule: two ends and a radius (m), which counts as hand.
    """
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2)
    rays = camera.rays(grid) @ camera.T_world_camera[:3, :3].T
    origin = camera.T_world_camera[:3, 3]
    z = -origin[2] / rays[:, 2]
    floor = origin + rays * z[:, None]
    colour = TABLE * (1 + 0.12 * np.sin(60 * floor[:, :1]))
    normal = np.tile([0.0, 0.0, 1.0], (len(rays), 1))
    kind = np.zeros(len(rays), int)
    parts = [_box(origin, rays, centre, yaw, box, height) for box in ((0, 0.05, 0.2, 0.05), (0, -0.03, 0.05, 0.11))]
    if hand is not None:
        elbow = hand[0] + 2.5 * (hand[0] - hand[9])
        bones = [(hand[a], hand[b], 0.009) for a, b in BONES] + [(hand[0], elbow, 0.03), (hand[0], hand[9], 0.02)]
        parts += [_capsule(origin, rays, a, b, radius) for a, b, radius in bones]
    parts += [_capsule(origin, rays, *stick)] if stick else []
    kinds = [1, 1] + [2] * (len(parts) - 2) + [3 + n for n in range(len(beside))]
    parts += [_box(origin, rays, b.centre, 0.0, (0, 0, *b.size[:2]), b.size[2]) for b in beside]
    for one, (reach, facing) in zip(kinds, parts, strict=True):
        nearer = reach < z
        z = np.where(nearer, reach, z)
        normal[nearer], kind[nearer] = facing[nearer], one
    for n, box in enumerate(beside):
        colour[kind == 3 + n] = box.colour
    colour = np.where(kind[:, None] == 1, BLUE, np.where(kind[:, None] == 2, SKIN, colour))
    shade = 0.45 + 0.55 * np.clip(normal @ LIGHT, 0, 1)
    shape = (camera.height, camera.width)
    image = colour * shade[:, None] + rng.normal(0, 3, (len(rays), 3))
    depth = 1000 * (z + rng.normal(0, 0.0015, len(rays)))
    depth[rng.random(len(rays)) < 0.01] = 0
    return View(
        image.clip(0, 255).astype(np.uint8).reshape(*shape, 3),
        depth.clip(0, 65535).round().astype(np.uint16).reshape(shape),
        (kind == 1).reshape(shape),
        (kind == 2).reshape(shape),
        (kind > 2).reshape(shape),
    )


def _box(origin, rays, centre, yaw, box, height):
    x, y, width, depth = box
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    local_origin, local_rays = (origin - [*centre, 0]) @ turn, rays @ turn
    low, high = np.array([x - width / 2, y - depth / 2, 0]), np.array([x + width / 2, y + depth / 2, height])
    with np.errstate(divide="ignore"):
        sides = np.sort([(low - local_origin) / local_rays, (high - local_origin) / local_rays], axis=0)
    enter, leave = sides[0].max(axis=1), sides[1].min(axis=1)
    axis = np.argmax(sides[0], axis=1)
    facing = -np.sign(local_rays[np.arange(len(rays)), axis])[:, None] * np.eye(3)[axis] @ turn.T
    return np.where(enter < leave, enter, np.inf), facing


def _capsule(origin, rays, a, b, radius):
    """Distances along the rays to a row of balls from a to b: a capsule at this image size."""
    best, facing = np.full(len(rays), np.inf), np.zeros_like(rays)
    squared = (rays**2).sum(axis=1)
    for centre in np.linspace(a, b, int(np.linalg.norm(b - a) / radius * 2) + 2):
        along = rays @ (centre - origin) / squared
        gap2 = ((centre - origin) ** 2).sum() - along**2 * squared
        reach = along - np.sqrt(np.maximum(radius**2 - gap2, 0) / squared)
        nearer = (gap2 < radius**2) & (reach < best)
        best[nearer] = reach[nearer]
        facing[nearer] = (origin + rays[nearer] * reach[nearer, None] - centre) / radius
    return best, facing


def pushing_sequence(
    frames: int,
    cameras: list[Camera],
    height: float = 0.03,
    beside: Callable[[int], Sequence[Box]] = lambda frame: (),
) -> tuple[list[list[View]], np.ndarray]:
    """Views [frame][camera] and hands [F, 21, 3] (m): the hand comes closer, then pushes the T along -x, turning it."""
    views, hands = [], []
    for f in range(frames):
        moved = max(0.0, (f - frames * 0.4) / frames)
        centre, yaw = (0.03 - 0.15 * moved, 0.02), 0.5 * moved
        tip = np.array([centre[0] + 0.115 + max(0.0, (frames * 0.4 - f) / frames) * 0.25, 0.02, 0.02])
        hands.append(hand_pose(tip))
        row = [
            render(c, centre, yaw, hands[-1], height, seed=100 * f + n, beside=beside(f)) for n, c in enumerate(cameras)
        ]
        views.append(row)
    return views, np.array(hands)
