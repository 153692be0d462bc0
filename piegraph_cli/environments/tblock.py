"""A T-shaped block on a table, pushed by a round pusher: planar physics in Pymunk behind gymnasium's interface.

Friction with the table acts at the level of velocity: the space forgets all velocity between two time steps
(damping 0), so a contact impulse moves the block by the mass matrix diag(m, m, m c^2). That is the ellipsoidal limit
surface of quasi-static pushing; it couples turning and sliding, c being the length that converts one into the other.
"""

import math

import gymnasium
import numpy as np
import pymunk

from piegraph_cli.environments.shapes import Block, place, t_block
from piegraph_cli.errors import UsageError
from piegraph_cli.physics.springs import farthest_point_sample

FRAME_RATE = 5.0
PUSHER_RADIUS = 0.01
CLEARANCE = 0.008
STROKE_LENGTHS = (0.03, 0.14)
REACH = 0.35
_RATE = 240
_STEPS_PER_FRAME = round(_RATE / FRAME_RATE)
_MASS, _TURNING_LENGTH, _FRICTION = 1.0, 0.06, 0.85
_MM = 1000.0
_CENTRE_LIMIT = 0.2


class TBlock(gymnasium.Env):
    """One `step` is one stroke: the pusher goes down at `start`, moves straight to `end` and leaves.

    Observation: the block's particles, float32 [N, 3] (m, world), material points that keep their index. Action:
    `start` [2] and `end` [2] (m, world) of the pusher's centre and `mode` (0, push; this environment has no picks).
    There is no reward: planners judge particles themselves.

    Source: paper, section "Simulated Experiments" (pusher, asymmetric centre of mass); shape, friction and limits are
    this project's.
    """

    def __init__(self, particles: int = 50):
        if particles < 4:
            raise UsageError(f"{particles} particles cannot show a pose", hint="use 4 or more; the paper uses 50")
        self.block: Block = t_block()
        dense = self.block.visible_surface(4000, seed=0)
        self.body_particles = dense[farthest_point_sample(dense, particles)]
        self._pose = np.zeros(3)
        table = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
        self.action_space = gymnasium.spaces.Dict({"start": table, "end": table, "mode": gymnasium.spaces.Discrete(1)})
        self.observation_space = gymnasium.spaces.Box(-10.0, 10.0, (particles, 3), np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Put the block at a random pose near the origin, or at `options["pose"]` (x, y in m, yaw in rad)."""
        super().reset(seed=seed)
        x, y = self.np_random.uniform(-0.08, 0.08, 2)
        pose = np.array([x, y, self.np_random.uniform(-math.pi, math.pi)])
        self._pose = np.array((options or {}).get("pose", pose), np.float64)
        return self.particles(), {"pose": self._pose.copy()}

    def step(self, action: dict) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Run one stroke.

        The info holds what happened on the way at 5 Hz, first and last frame at the stroke's ends: `frames` [F, N, 3]
        float32 (m), `times` [F] (s), `pusher` [F, 2] (m), `poses` [F, 3]; further `blocked` (the start lay on the
        block), `start_used` [2] (m; then moved back along the stroke until it is free) and `grasped`, always false.
        """
        start, end = check_stroke(action)
        space, body = self._space(self._pose)
        used = self._free_start(space, start, end)
        poses, pusher = self._push(space, body, used, end)
        self._pose = poses[-1].copy()
        info = {
            "frames": self.particles(poses),
            "times": np.arange(len(poses)) / FRAME_RATE,
            "pusher": pusher,
            "poses": poses,
            "start_used": used,
            "blocked": bool((used != start).any()),
            "grasped": False,
        }
        return self.particles(), 0.0, False, False, info

    def particles(self, poses: np.ndarray | None = None) -> np.ndarray:
        """Particles at poses [..., 3] (x, y in m, yaw in rad; by default the current one), float32 [..., N, 3] (m)."""
        return place(self.body_particles, self._pose if poses is None else poses).astype(np.float32)

    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """The block's surface in its body frame: vertices [V, 3] (m), triangles [T, 3]."""
        return self.block.mesh()

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything a stroke's outcome depends on."""
        return {"pose": self._pose.copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Return to a state of `get_state`, bit for bit."""
        self._pose = np.array(state["pose"], np.float64)

    def sample_stroke(self, rng: np.random.Generator) -> dict:
        """A random stroke that touches the block: an action for `step`.

        The heading is uniform, the lateral offset uniform over the block's silhouette along it, the length uniform in
        3-14 cm, and the start 8 mm before first contact. Strokes that could carry the block out of reach are redrawn.
        """
        space, _ = self._space(self._pose)
        outline = np.column_stack([self.block.outline, np.zeros(len(self.block.outline))])
        while True:
            heading, length = rng.uniform(-math.pi, math.pi), rng.uniform(*STROKE_LENGTHS)
            along = np.array([math.cos(heading), math.sin(heading)])
            if (np.abs(self._pose[:2] + along * (length - CLEARANCE)) > _CENTRE_LIMIT).any():
                continue
            across = np.array([-along[1], along[0]])
            silhouette = place(outline, self._pose)[:, :2] @ across
            offset = rng.uniform(silhouette.min(), silhouette.max()) - self._pose[:2] @ across
            start = _first_contact(space, self._pose[:2] + offset * across, along) - CLEARANCE * along
            return {"start": start, "end": start + length * along, "mode": 0}

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """Goal particles, float32 [N, 3] (m): the block moved by up to 20 cm in x and in y, turned by up to 90 degrees.

        Goals that the table's reach does not allow are redrawn.
        """
        while True:
            pose = self._pose + rng.uniform(-1, 1, 3) * [0.2, 0.2, math.pi / 2]
            if (np.abs(pose[:2]) <= _CENTRE_LIMIT).all():
                return self.particles(pose)

    def _space(self, pose: np.ndarray) -> tuple[pymunk.Space, pymunk.Body]:
        """A fresh space with the block at rest: nothing from one stroke leaks into the next."""
        space = pymunk.Space()
        space.gravity, space.damping, space.iterations, space.collision_slop = (0, 0), 0.0, 30, 0.05
        body = pymunk.Body(_MASS, _MASS * (_TURNING_LENGTH * _MM) ** 2)
        body.position, body.angle = (pose[0] * _MM, pose[1] * _MM), pose[2]
        space.add(body)
        for a, b, c, d in (self.block.rectangles * _MM).tolist():
            shape = pymunk.Poly(body, [(a, b), (c, b), (c, d), (a, d)])
            shape.friction = _FRICTION
            space.add(shape)
        space.reindex_shapes_for_body(body)
        return space, body

    def _free_start(self, space: pymunk.Space, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        back = (start - end) / np.linalg.norm(start - end)
        free, radius = start.copy(), PUSHER_RADIUS * _MM
        while hit := space.point_query_nearest(tuple(free * _MM), radius, pymunk.ShapeFilter()):
            free += back * max((radius - hit.distance) / _MM, 1e-3)
        return free

    def _push(
        self, space: pymunk.Space, body: pymunk.Body, start: np.ndarray, end: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses [F, 3] and pusher centres [F, 2] at 5 Hz of a straight push that takes a whole number of frames."""
        frames = stroke_frames(float(np.linalg.norm(end - start)))
        pusher = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        pusher.position = tuple(start * _MM)
        pusher.velocity = tuple((end - start) * _MM * FRAME_RATE / frames)
        disc = pymunk.Circle(pusher, PUSHER_RADIUS * _MM)
        disc.friction = _FRICTION
        space.add(pusher, disc)
        poses, step = [self._pose.copy()], space.step
        for _ in range(frames):
            for _ in range(_STEPS_PER_FRAME):
                step(1.0 / _RATE)
            poses.append(np.array([body.position.x / _MM, body.position.y / _MM, body.angle]))
        return np.array(poses), start + (end - start) * (np.arange(frames + 1) / frames)[:, None]


def stroke_frames(length: float) -> int:
    """5 Hz frames that a stroke of that length (m) takes: 0.8 s for 3 cm, 2 s for 14 cm."""
    return math.ceil((0.5 + 10.0 * length) * FRAME_RATE - 1e-9)


def check_stroke(action: dict) -> tuple[np.ndarray, np.ndarray]:
    """Start [2] and end [2] (m) of a push; UsageError if it is no push or has no heading."""
    start, end = (np.array(action[key], np.float64) for key in ("start", "end"))
    if int(action["mode"]) != 0:
        raise UsageError("the T-block cannot be picked up", hint="use push strokes (mode 0) in this environment")
    if start.shape != (2,) or end.shape != (2,) or not np.isfinite([start, end]).all():
        raise UsageError(f"a stroke needs two finite planar points, got start {start}, end {end}")
    if np.linalg.norm(end - start) < 1e-3:
        raise UsageError(
            "the stroke is shorter than 1 mm and so has no heading", hint="move its end away from its start"
        )
    return start, end


def _first_contact(space: pymunk.Space, through: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Centre [2] (m) of the pusher where it first touches the block on the line `through` in direction `along`."""
    first, last = through - along, through + along
    hit = space.segment_query_first(tuple(first * _MM), tuple(last * _MM), PUSHER_RADIUS * _MM, pymunk.ShapeFilter())
    if hit is None:
        raise ValueError("the line misses the block")
    return first + hit.alpha * (last - first)
