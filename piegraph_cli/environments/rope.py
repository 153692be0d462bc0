"""A rope on a table, pushed by a round pusher: a discrete elastic rod that does not stretch, simulated by MuJoCo."""

import math

import mujoco
import numpy as np

from piegraph_cli.environments.base import GoalState
from piegraph_cli.environments.mujoco_base import MujocoEnvironment, scene
from piegraph_cli.environments.params import RopeOptions

_NODES = 24
_SIDES = 12
_POISSON = 0.3
_DAMPING = 0.02
_TWIST_DAMPING = 0.01
"""N m s/rad about the rope's own axis; without it the rope rolls off like a pipe."""
_IMPRATIO = 30
"""So hard is friction that a bent rope at rest creeps by less than 1 mm in 2 s; softly it straightens by 4 mm."""
_TIMESTEP = 0.008
_GOAL_STROKES = 3
_DENSE = 8


class Rope(MujocoEnvironment):
    """A rope of 24 nodes; its particles lie on the centre line at even arc length, from one end to the other.

    Source: paper, section "Simulated Experiments" (stiff and bendy rope); dimensions and friction are this project's.
    """

    stroke_lengths = (0.08, 0.26)
    reach = 0.42
    color = (0.10, 0.05, 0.45)

    def __init__(self, particles: int = 50, options: RopeOptions = RopeOptions()):
        self.options = options
        super().__init__(particles, _mjcf(options))
        twists = [j for j in range(self.model.njnt) if "_twist" in self.model.joint(j).name]
        self.model.dof_damping[self.model.jnt_dofadr[twists]] = _TWIST_DAMPING
        mujoco.mj_setConst(self.model, self.data)
        self.weights = _between(particles)
        self._dense = _between(_DENSE * (_NODES - 1) + 1)
        self._rings, self.triangles = _tube()

    def surface(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """The rope's surface, a tube with round ends, at nodes [..., 24, 3] (m), float32 [..., V, 3] (m)."""
        nodes = self.nodes if shapes is None else np.asarray(shapes)
        ahead = np.gradient(nodes, axis=-2)
        ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
        side = np.cross(ahead, [0.0, 0.0, 1.0])
        side = side / np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9)
        frame = np.stack([ahead, side, np.cross(side, ahead)], axis=-2) * self.options.radius
        node, offset = self._rings
        return (nodes[..., node, :] + np.einsum("rk,...rkd->...rd", offset, frame[..., node, :, :])).astype(np.float32)

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """Goal particles, float32 [N, 3] (m): where three random strokes take the rope."""
        return self.goal_state(rng).particles

    def goal_state(self, rng: np.random.Generator) -> GoalState:
        """The goal with its nodes; nothing tells the rope's ends apart."""
        before = self.get_state()
        try:
            for _ in range(_GOAL_STROKES):
                goal, _, _, _, info = self.step(self.sample_stroke(rng))
        finally:
            self.set_state(before)
        return GoalState(goal, info["shapes"][-1], np.stack([goal, goal[::-1]]))

    def _outline(self) -> tuple[np.ndarray, float]:
        return self._dense @ self.nodes[:, :2], self.options.radius

    def keeps_reach(self, start: np.ndarray, end: np.ndarray, mode: int) -> bool:
        # pushed from its side, a rope turns about a point beyond its middle, and an end moves half as far again as what
        # is pushed; pushed along itself it slides
        nodes, along = self.nodes[:, :2], end - start
        axis = nodes[-1] - nodes[0]
        across = abs(axis[0] * along[1] - axis[1] * along[0]) / max(float(np.linalg.norm(axis)), 1e-9)
        swing = 1 + 0.5 * across / float(np.linalg.norm(along))
        return super().keeps_reach(start, start + swing * along, mode)


def _mjcf(options: RopeOptions) -> str:
    mass = options.density * math.pi * options.radius**2 * options.length
    heading = np.linspace(-0.5, 0.5, _NODES - 1) * options.curl
    edges = np.column_stack([np.cos(heading), np.sin(heading)]) * options.length / (_NODES - 1)
    line = np.concatenate([np.zeros((1, 2)), np.cumsum(edges, axis=0)])
    points = np.column_stack([line - line.mean(0), np.full(_NODES, options.radius)])
    elements = np.column_stack([np.arange(_NODES - 1), np.arange(1, _NODES)])
    # capsules two edges apart must not touch in a straight rope
    selfcollide = "auto" if options.length / (_NODES - 1) > 2 * options.radius else "none"
    rope = f"""<flexcomp name="rope" type="direct" dim="1" radius="{options.radius}" mass="{mass}"
      point="{_text(points)}" element="{_text(elements)}">
      <edge equality="true" solref="0.005 1"/>
      <contact friction="{options.friction}" selfcollide="{selfcollide}"/>
      <elasticity young="{options.young}" poisson="{_POISSON}" damping="{_DAMPING}"/>
    </flexcomp>"""
    return scene(rope, options.friction, timestep=_TIMESTEP, iterations=20, impratio=_IMPRATIO)


def _text(values: np.ndarray) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


def _between(count: int) -> np.ndarray:
    """Weights [count, 24] of the nodes in points at even distances along the rope."""
    at = np.linspace(0, _NODES - 1, count)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(_NODES)))


def _tube() -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """A tube with round ends: per vertex its node [V] and its offset [V, 3] (ahead, side, up; in radii), triangles."""
    cap = np.deg2rad([-60, -30])
    axial = np.concatenate([np.sin(cap), np.zeros(_NODES), -np.sin(cap[::-1])])
    wide = np.concatenate([np.cos(cap), np.ones(_NODES), np.cos(cap[::-1])])
    ring = np.concatenate([[0, 0], np.arange(_NODES), [_NODES - 1] * 2])
    around = np.arange(_SIDES) * 2 * math.pi / _SIDES
    offset = np.stack(
        np.broadcast_arrays(axial[:, None], wide[:, None] * np.cos(around), wide[:, None] * np.sin(around)), axis=-1
    )
    node = np.concatenate([np.repeat(ring, _SIDES), [0, _NODES - 1]])
    offset = np.concatenate([offset.reshape(-1, 3), [[-1, 0, 0], [1, 0, 0]]])
    rows = np.arange(len(ring) * _SIDES).reshape(len(ring), _SIDES)
    after = np.roll(rows, -1, axis=1)
    quads = [(rows[:-1], after[1:], after[:-1]), (rows[:-1], rows[1:], after[1:])]
    first, last = np.full(_SIDES, len(offset) - 2), np.full(_SIDES, len(offset) - 1)
    fans = [(first, rows[0], after[0]), (last, after[-1], rows[-1])]
    return (node, offset), np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in quads + fans])
