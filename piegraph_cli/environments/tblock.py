"""A T-shaped block on a table, pushed by a round pusher: planar physics in Pymunk behind gymnasium's interface.

Friction with the table acts at the level of velocity: the space forgets all velocity between two time steps
(damping 0), so a contact impulse moves the block by the mass matrix diag(m, m, m c^2). That is the ellipsoidal limit
surface of quasi-static pushing; it couples turning and sliding, c being the length that converts one into the other.
"""

import math

import numpy as np
import pymunk

from piegraph_cli.environments.base import (
    CLEARANCE,
    FRAME_RATE,
    PUSHER_RADIUS,
    TIP_HEIGHT,
    Environment,
    GoalState,
    Motion,
    check_state,
    stroke_frames,
)
from piegraph_cli.environments.params import TBlockOptions
from piegraph_cli.environments.shapes import Block, place, t_block
from piegraph_cli.physics.springs import farthest_point_sample

_RATE = 240
_STEPS_PER_FRAME = round(_RATE / FRAME_RATE)
_MASS = 1.0
_MM = 1000.0
_CENTRE_LIMIT = 0.2


class TBlock(Environment):
    """A T-shaped block, rigid; its shape is its pose: x, y (m) and yaw (rad).

    Source: paper, section "Simulated Experiments" (pusher, asymmetric centre of mass); shape, friction and limits are
    this project's.
    """

    def __init__(self, particles: int = 50, options: TBlockOptions = TBlockOptions()):
        super().__init__(particles)
        self.options = options
        self.block: Block = t_block()
        dense = self.block.visible_surface(4000, seed=0)
        self.body_particles = dense[farthest_point_sample(dense, particles)]
        self._vertices, self.triangles = self.block.mesh()
        self._pose = np.zeros(3)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Put the block at a random pose near the origin, or at `options["pose"]` (x, y in m, yaw in rad)."""
        super().reset(seed=seed)
        x, y = self.np_random.uniform(-0.08, 0.08, 2)
        pose = np.array([x, y, self.np_random.uniform(-math.pi, math.pi)])
        self._pose = np.array((options or {}).get("pose", pose), np.float64)
        return self.particles(), {"pose": self._pose.copy()}

    def particles(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """Particles at poses [..., 3] (x, y in m, yaw in rad; by default the current one), float32 [..., N, 3] (m)."""
        return place(self.body_particles, self._pose if shapes is None else shapes).astype(np.float32)

    def surface(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """The block's surface at poses [..., 3], float32 [..., V, 3] (m)."""
        return place(self._vertices, self._pose if shapes is None else shapes).astype(np.float32)

    def get_state(self) -> dict[str, np.ndarray]:
        """The pose."""
        return {"pose": self._pose.copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Return to a pose, bit for bit."""
        check_state(state, ("pose",), "T-block")
        self._pose = np.array(state["pose"], np.float64)

    def _random_push(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        space, _ = self._space(self._pose)
        outline = np.column_stack([self.block.outline, np.zeros(len(self.block.outline))])
        while True:
            heading, length = rng.uniform(-math.pi, math.pi), rng.uniform(*self.stroke_lengths)
            along = np.array([math.cos(heading), math.sin(heading)])
            if (np.abs(self._pose[:2] + along * (length - CLEARANCE)) > _CENTRE_LIMIT).any():
                continue
            across = np.array([-along[1], along[0]])
            silhouette = place(outline, self._pose)[:, :2] @ across
            offset = rng.uniform(silhouette.min(), silhouette.max()) - self._pose[:2] @ across
            start = _first_contact(space, self._pose[:2] + offset * across, along) - CLEARANCE * along
            return start, start + length * along

    def keeps_reach(self, start: np.ndarray, end: np.ndarray, mode: int) -> bool:
        return True  # `_random_push` keeps the centre in its limit, which is stricter

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """Goal particles, float32 [N, 3] (m): the block moved by up to 20 cm in x and in y, turned by up to 90 degrees.

        Goals that the table's reach does not allow are redrawn.
        """
        return self.goal_state(rng).particles

    def goal_state(self, rng: np.random.Generator) -> GoalState:
        """The goal with its pose; the block looks like itself in no other one."""
        while True:
            pose = self._pose + rng.uniform(-1, 1, 3) * [0.2, 0.2, math.pi / 2]
            if (np.abs(pose[:2]) <= _CENTRE_LIMIT).all():
                particles = self.particles(pose)
                return GoalState(particles, pose, particles[None])

    def _space(self, pose: np.ndarray) -> tuple[pymunk.Space, pymunk.Body]:
        """A fresh space with the block at rest: nothing from one stroke leaks into the next."""
        space = pymunk.Space()
        space.gravity, space.damping, space.iterations, space.collision_slop = (0, 0), 0.0, 30, 0.05
        body = pymunk.Body(_MASS, _MASS * (self.options.turning_length * _MM) ** 2)
        body.position, body.angle = (pose[0] * _MM, pose[1] * _MM), pose[2]
        space.add(body)
        for a, b, c, d in (self.block.rectangles * _MM).tolist():
            shape = pymunk.Poly(body, [(a, b), (c, b), (c, d), (a, d)])
            shape.friction = self.options.friction
            space.add(shape)
        space.reindex_shapes_for_body(body)
        return space, body

    def _free_start(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        space, _ = self._space(self._pose)
        back = (start - end) / np.linalg.norm(start - end)
        free, radius = start.copy(), PUSHER_RADIUS * _MM
        while hit := space.point_query_nearest(tuple(free * _MM), radius, pymunk.ShapeFilter()):
            free += back * max((radius - hit.distance) / _MM, 1e-3)
        return free

    def _push(self, start: np.ndarray, end: np.ndarray) -> Motion:
        space, body = self._space(self._pose)
        frames = stroke_frames(float(np.linalg.norm(end - start)))
        pusher = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        pusher.position = tuple(start * _MM)
        pusher.velocity = tuple((end - start) * _MM * FRAME_RATE / frames)
        disc = pymunk.Circle(pusher, PUSHER_RADIUS * _MM)
        disc.friction = self.options.friction
        space.add(pusher, disc)
        poses, step = [self._pose.copy()], space.step
        for _ in range(frames):
            for _ in range(_STEPS_PER_FRAME):
                step(1.0 / _RATE)
            poses.append(np.array([body.position.x / _MM, body.position.y / _MM, body.angle]))
        self._pose = poses[-1].copy()
        path = start + (end - start) * (np.arange(frames + 1) / frames)[:, None]
        return Motion(np.array(poses), np.column_stack([path, np.full(len(path), TIP_HEIGHT)]))


def _first_contact(space: pymunk.Space, through: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Centre [2] (m) of the pusher where it first touches the block on the line `through` in direction `along`."""
    first, last = through - along, through + along
    hit = space.segment_query_first(tuple(first * _MM), tuple(last * _MM), PUSHER_RADIUS * _MM, pymunk.ShapeFilter())
    if hit is None:
        raise ValueError("the line misses the block")
    return first + hit.alpha * (last - first)
