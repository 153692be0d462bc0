"""Recordings of a simulated environment: random strokes as 5 Hz tracks, or as images of a hand that makes them."""

import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace

import numpy as np

from piegraph_cli.environments import noise
from piegraph_cli.environments.base import FRAME_RATE, TIP_HEIGHT, Environment
from piegraph_cli.environments.hand import Hand
from piegraph_cli.environments.hand_motion import Grip, choose_grip
from piegraph_cli.environments.params import Texture, TroubleParams
from piegraph_cli.environments.render import HAND, OBJECT, Solid
from piegraph_cli.environments.scene import Moment, Scene
from piegraph_cli.environments.trouble import lost_frames
from piegraph_cli.params import PICK, PUSH, mode_number
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.images import encode_masks

_LIFT = 0.085
_TRAVEL = 0.09
_AWAY = np.array([0.06, -0.38, 0.16])
_EMPTY = 2
_PER_FRAME = ("frames", "pusher", "shapes")
NO_TROUBLE = TroubleParams()
_OPEN, _ABOVE = 0.5, np.array([0.0, 0.0, 0.012])
"""How far a hand closes that is about to pinch, and how far above it waits, metres."""


@dataclass(frozen=True)
class Frame:
    """One recorded frame of all cameras, with what is true."""

    moment: Moment
    color: list[np.ndarray]
    """Per camera RGB uint8 [H, W, 3]."""
    depth: list[np.ndarray]
    """Per camera uint16 [H, W] in the camera's units, 0 for no reading."""
    object_mask: np.ndarray
    """[C, H, W] bool: pixels that show the object."""
    hand_mask: np.ndarray
    """[C, H, W] bool: pixels that show hand or forearm."""
    landmarks: np.ndarray
    """[21, 3] hand joints in MediaPipe's order, metres, NaN while the hand is out of the scene."""
    stamps: np.ndarray
    """[C] time stamps, seconds."""
    lost: np.ndarray
    """[C] bool: frames that the camera did not keep."""


def simulate_tracks(env: Environment, seed: int, strokes: int, modes: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Particle tracks of random strokes, straight from the simulation.

    `modes` are drawn from for every stroke; by default the environment's main one. Returns `positions` [F, N, 3] float32
    (m), `time` [F] (s), `end_effector` [F, 3] (m), `contact` [F] bool and `mode` [F]: each stroke's frames at 5 Hz with
    contact true, before each of them one frame with contact false.
    """
    rows = []
    for stroke in _play(env, seed, strokes, modes):
        for frames, touching in ((slice(0, 1), False), (slice(None), True)):
            path = stroke["pusher"][frames]
            rows.append((stroke["frames"][frames], path, [touching] * len(path), [stroke["mode"]] * len(path)))
    positions, pusher, contact, mode = (np.concatenate([row[k] for row in rows]) for k in range(4))
    return {
        "positions": positions,
        "time": np.arange(len(positions)) / FRAME_RATE,
        "end_effector": pusher,
        "contact": contact,
        "mode": mode.astype(np.uint8),
    }


def _play(
    env: Environment, seed: int, strokes: int, modes: tuple[str, ...] = (), bends: tuple[float, ...] = ()
) -> Iterator[dict]:
    """The info of each random stroke, and its `mode`; pushes turn by `bends` (rad) on their way, without lifting."""
    rng = np.random.default_rng([seed, 3])  # apart from the stream that `reset` draws the pose from
    env.reset(seed=seed)
    for _ in range(strokes):
        mode = mode_number(modes[rng.integers(len(modes))]) if modes else env.modes[0]
        stroke = env.sample_stroke(rng, mode)
        if mode == PUSH and bends:
            yield _bent(env, stroke, bends) | {"mode": mode}
        else:
            yield env.step(stroke)[4] | {"mode": mode}


def _bent(env: Environment, stroke: dict, bends: tuple[float, ...]) -> dict:
    """The info of a push of the stroke's length whose heading turns at corners; it ends where the object would leave."""
    along = (stroke["end"] - stroke["start"]) / (len(bends) + 1)
    infos = [env.step(stroke | {"end": stroke["start"] + along})[4]]
    side = 1.0
    for k, bend in enumerate(bends):
        end = infos[-1]["pusher"][-1, :2].astype(float)
        ways = [(sign, _turn2(along, sign * bend)) for sign in ((1.0, -1.0) if k == 0 else (side,))]
        kept = [(sign, way) for sign, way in ways if env.keeps_reach(end, end + way, PUSH)]
        if not kept:
            break
        side, along = kept[0]
        infos.append(env.step({"start": end, "end": end + along, "mode": PUSH})[4])
    whole = {name: np.concatenate([i[name][k > 0 :] for k, i in enumerate(infos)]) for name in _PER_FRAME}
    return infos[0] | whole


def _turn2(vector: np.ndarray, angle: float) -> np.ndarray:
    """A vector [2] turned by an angle (rad)."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin], [sin, cos]]) @ vector


def plan_moments(
    env: Environment,
    seed: int,
    strokes: int,
    hand: Hand,
    modes: tuple[str, ...] = (),
    bends: tuple[float, ...] = (),
) -> list[Moment]:
    """The whole recording frame by frame: no hand, approach, strokes with transits between them, retreat, no hand.

    Before and after a pick the hand is open above the place for one frame. Pushes turn by `bends` (rad).
    """
    path: list[tuple] = []
    for number, stroke in enumerate(_play(env, seed, strokes, modes, bends)):
        shapes, tips = stroke["shapes"], stroke["pusher"]
        grip = _grip_of(env, stroke, hand)
        acting = [(shape, tip, grip, number) for shape, tip in zip(shapes, tips, strict=True)]
        if stroke["mode"] == PICK:
            opened = replace(grip, pinch=_OPEN)
            acting = [(shapes[0], tips[0] + _ABOVE, opened, -1), *acting, (shapes[-1], tips[-1] + _ABOVE, opened, -1)]
        if not path:
            path += [(shapes[0], None, None, -1)] * _EMPTY + [(shapes[0], _AWAY, acting[0][2], -1)]
        path += _transit(path[-1], acting[0]) + acting
    shape, _, grip, _ = path[-1]
    leaves = (shape, _AWAY, grip, -1)
    path += [*_transit(path[-1], leaves), leaves, *[(shape, None, None, -1)] * _EMPTY]
    return [Moment(k / FRAME_RATE, *entry) for k, entry in enumerate(path)]


def _grip_of(env: Environment, stroke: dict, hand: Hand) -> Grip:
    """How the hand is held in a stroke, given its info."""
    tips = stroke["pusher"]
    along = tips[-1] - tips[0]
    solids = [Solid(vertices, env.triangles) for vertices in env.surface(stroke["shapes"])]
    heading, pinch = math.atan2(along[1], along[0]), float(stroke["mode"] == PICK)
    return choose_grip(hand, heading, tips, lambda k, points: solids[k].inside(points), pinch)


def _transit(before: tuple, after: tuple) -> list[tuple]:
    """Frames strictly between two moments: up, over, down, about `_TRAVEL` metres a frame, slower at both ends."""
    shape, start, from_grip, _ = before
    _, end, to_grip, _ = after
    height = max(TIP_HEIGHT + _LIFT, start[2], end[2])
    corners = np.array([start, [*start[:2], height], [*end[:2], height], end])
    reach = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    count = max(3, math.ceil(reach[-1] / _TRAVEL))
    entries = []
    even = np.arange(1, count) / count
    for share in (even**2 * (3 - 2 * even)).tolist():
        tip = np.array([np.interp(share * reach[-1], reach, corners[:, axis]) for axis in range(3)])
        mixed = (1 - share) * np.array(astuple(from_grip)) + share * np.array(astuple(to_grip))
        entries.append((shape, tip, Grip(*mixed.tolist()), -1))
    return entries


def record(
    env: Environment,
    seed: int,
    strokes: int,
    cameras: list[Camera],
    hand: Hand,
    modes: tuple[str, ...] = (),
    trouble: TroubleParams = NO_TROUBLE,
    texture: Texture = "plain",
) -> Iterator[Frame]:
    """Render random strokes made by a hand, frame by frame, with sensor noise; everything follows from `seed`.

    Source: paper, section "Tracking and Data Collection" (RGB-D images of a person's hand at 5 Hz).
    """
    offsets = np.random.default_rng([seed, 1]).uniform(0, 0.004, len(cameras))
    bends = (math.radians(trouble.bend) / trouble.corners,) * trouble.corners if trouble.bend else ()
    print = env.printed(texture, np.random.default_rng([seed, 5])) if texture != "plain" else None
    scene = Scene(env, plan_moments(env, seed, strokes, hand, modes, bends), cameras, hand, trouble, print)
    lost = lost_frames(trouble, seed, len(scene.moments), len(cameras))
    for number, moment in enumerate(scene.moments):
        rng = np.random.default_rng([seed, 2, number])
        views, landmarks = scene.views(number)
        label = np.stack([view.label for view in views])
        yield Frame(
            moment,
            [noise.sensed_color(view.color, rng, trouble.noise) for view in views],
            [
                noise.sensed_depth(*seen, camera.K[0, 0], camera.depth_scale, rng, trouble.noise)
                for seen, camera in zip(scene.depths(number, views), cameras, strict=True)
            ],
            label == OBJECT,
            label == HAND,
            landmarks,
            moment.time + offsets + rng.uniform(0, 0.001, len(cameras)),
            lost[number],
        )


def truth_arrays(environment: Environment, frames: list[Frame]) -> dict[str, np.ndarray]:
    """The truth artifact of rendered frames: particles, surface mesh, masks, hand."""
    moments = [frame.moment for frame in frames]
    shapes = np.array([m.shape for m in moments])
    tips = [np.full(3, np.nan) if m.tip is None else m.tip for m in moments]
    objects, objects_offsets = encode_masks([mask for frame in frames for mask in frame.object_mask])
    hands, hands_offsets = encode_masks([mask for frame in frames for mask in frame.hand_mask])
    return {
        "particles": environment.particles(shapes),
        "vertices": environment.surface(shapes),
        "triangles": environment.triangles,
        "object_mask": objects,
        "object_mask_offsets": objects_offsets,
        "hand_mask": hands,
        "hand_mask_offsets": hands_offsets,
        "hand_keypoints": np.array([frame.landmarks for frame in frames]),
        "end_effector": np.array(tips),
        "stroke": np.array([m.stroke for m in moments]),
        "contact": np.array([m.stroke >= 0 for m in moments]),
        "time": np.array([m.time for m in moments]),
    }
