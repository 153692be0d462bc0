"""Cloth on a table, picked by a gripper or pushed by a round pusher: a square and a T-shirt, thin shells in MuJoCo."""

import math
from typing import Literal

import numpy as np

from piegraph_cli.environments.base import REACH, GoalState, Motion
from piegraph_cli.environments.cloth_mesh import ClothMesh, square_outline, triangulate, tshirt_outline
from piegraph_cli.environments.cloth_print import printed
from piegraph_cli.environments.mujoco_base import MujocoEnvironment, scene, smooth_path
from piegraph_cli.environments.params import ClothOptions
from piegraph_cli.environments.render import Print
from piegraph_cli.environments.shapes import place
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK, PUSH

_OUTLINES = {"square": (square_outline, 18), "tshirt": (tshirt_outline, 20.7)}
"""Curves of each outline, and triangle edges along `size`."""
_RADIUS = 0.003
_POISSON = 0.2
_THICKNESS = 1e-3
_DAMPING = 0.01
_TIMESTEP = 0.01
_ITERATIONS = 60
_IMPRATIO = 20
_GRASP_RADIUS = 0.016
_LIFT = 0.05
_RELEASE = 0.01
_LIFT_TIME = 0.3
_LOWER_TIME = 0.2
_CARRY_SPEED = 0.35
"""Fastest, metres a second."""
_SHORTEST_CARRY = 0.3
_DRAGGED = 0.15
"""What lies this near the grasp comes along with it, metres."""
_GOAL_SHIFT = 0.15
_GOAL_TURN = math.radians(70)
_GOAL_PICKS = 2
_GOAL_TRIES = 1000


class Cloth(MujocoEnvironment):
    """A cloth that lies flat at reset; its particles are material points of the sheet, its shape the sheet's vertices.

    Source: paper, section "Simulated Experiments" (T-shirt, picker); sizes, material and outlines are this project's.
    """

    modes = (PICK, PUSH)
    color = (0.32, 0.03, 0.22)
    settle_speed = 0.03
    settle_time = 0.6
    outline_radius = 2 * _RADIUS
    """With the pusher's radius added, the vertices' discs cover the cloth."""

    def __init__(
        self,
        particles: int = 50,
        options: ClothOptions = ClothOptions(),
        outline: Literal["square", "tshirt"] = "square",
    ):
        self.options = options
        curves, edges = _OUTLINES[outline]
        self.mesh = triangulate(curves(), options.size, options.size / edges)
        super().__init__(particles, _mjcf(self.mesh, options))
        self._gripper = self.model.body("gripper").mocapid[0]
        self.weights = self.mesh.material_points(particles)
        turns = (1, 2, 3) if outline == "square" else ()
        self._turned = [self.mesh.weights_at(_quarter(self.weights @ self.mesh.points, k)) for k in turns]
        """Weights of the points where the particles lie on a square that is turned by quarters."""
        self.triangles = self.mesh.shell_triangles()

    def surface(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """The sheet's closed surface at vertices [..., V, 3] (m; by default the current ones), float32 [..., 2 V, 3] (m)."""
        return self.mesh.shell(self.nodes if shapes is None else np.asarray(shapes), _RADIUS).astype(np.float32)

    def printed(self, texture: Literal["faint", "print"], rng: np.random.Generator) -> Print:
        """The pattern of its surface in recordings."""
        return printed(texture, np.array(self.color), self.mesh.points, rng)

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """Goal particles, float32 [N, 3] (m), as the option `goal` says.

        "moved": the flat cloth, up to 15 cm and up to 70 degrees from where the cloth is now, each uniform in size and
        the shift in direction; goals out of reach are redrawn. "crumpled": what two random picks make of the cloth.
        Raises DataError when there is no such goal in reach.
        """
        return self.goal_state(rng).particles

    def goal_state(self, rng: np.random.Generator) -> GoalState:
        """The goal with its vertices; nothing tells the corners of a square apart."""
        particles, shape = self._moved_goal(rng) if self.options.goal == "moved" else self._crumpled_goal(rng)
        turned = [(weights @ shape).astype(np.float32) for weights in self._turned]
        return GoalState(particles, shape, np.stack([particles, *turned]))

    def _moved_goal(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        flat, now = self.weights @ self._rest, self.particles().astype(np.float64)
        x, y, turn = _planar_pose(flat, now)
        for _ in range(_GOAL_TRIES):
            distance, heading = rng.uniform(0, _GOAL_SHIFT), rng.uniform(-math.pi, math.pi)
            turned = turn + rng.uniform(-_GOAL_TURN, _GOAL_TURN)
            pose = [x + distance * math.cos(heading), y + distance * math.sin(heading), turned]
            goal = place(flat, np.array(pose))
            if (np.abs(goal[:, :2]) <= REACH).all():
                return goal.astype(np.float32), place(self._rest, np.array(pose))
        raise DataError("no goal near the cloth is in reach", type(self).__name__, "reset the environment")

    def _crumpled_goal(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        before = self.get_state()
        try:
            for _ in range(_GOAL_PICKS):
                goal, _, _, _, info = self.step(self.sample_stroke(rng, PICK))
        finally:
            self.set_state(before)
        return goal, info["shapes"][-1]

    def keeps_reach(self, start: np.ndarray, end: np.ndarray, mode: int) -> bool:
        if mode == PUSH:
            return super().keeps_reach(start, end, mode)
        nodes = self.nodes[:, :2]
        dragged = nodes[np.linalg.norm(nodes - start, axis=1) < _DRAGGED]
        return bool((np.abs(dragged + (end - start)) <= REACH).all())

    def _pick(self, start: np.ndarray, end: np.ndarray) -> Motion:
        before = self.nodes
        held = np.flatnonzero(np.linalg.norm(before[:, :2] - start, axis=1) < _GRASP_RADIUS)
        low = before[held, 2].min() if len(held) else _RADIUS
        grip = np.array([*start, before[held, 2].mean() if len(held) else _RADIUS])
        path = self._pick_path(grip, end, grip[2] - low + _RELEASE)
        pusher = np.concatenate([grip[None], path[self._steps_per_frame - 1 :: self._steps_per_frame], path[-1:]])
        if not len(held):
            return Motion(np.repeat(before[None], len(pusher), axis=0), pusher)
        shapes = [before]
        with self._watch() as sane:
            self._steer_gripper(grip)
            self.model.eq_data[held, 3:6] = before[held] - grip
            self.data.eq_active[held] = True
            shapes += self._follow(path, self._steer_gripper)
            self.data.eq_active[held] = False
            self._settle()
        shapes.append(self.nodes)
        return Motion(self._checked(shapes, sane()), pusher, grasped=True)

    def _steer_gripper(self, position: np.ndarray) -> None:
        self.data.mocap_pos[self._gripper] = position

    def _pick_path(self, grip: np.ndarray, end: np.ndarray, height: float) -> np.ndarray:
        """The gripper [steps, 3] (m), a point a time step, whole frames long: up, straight to the end [2], to a height."""
        high, above = (np.array([*xy, grip[2] + _LIFT]) for xy in (grip[:2], end))
        # a smooth path's top speed is 1.5 times its mean
        carry = max(_SHORTEST_CARRY, 1.5 * float(np.linalg.norm(above - high)) / _CARRY_SPEED)
        lift, lower = (round(seconds / _TIMESTEP) for seconds in (_LIFT_TIME, _LOWER_TIME))
        whole = math.ceil((lift + lower + carry / _TIMESTEP) / self._steps_per_frame) * self._steps_per_frame
        down = np.array([*end, height])
        return np.concatenate(
            [
                smooth_path(grip, high, lift),
                smooth_path(high, above, whole - lift - lower),
                smooth_path(above, down, lower),
            ]
        )


def _mjcf(mesh: ClothMesh, options: ClothOptions) -> str:
    points = np.column_stack([mesh.points, np.full(len(mesh.points), _RADIUS)])
    cloth = f"""<flexcomp name="cloth" type="direct" dim="2" radius="{_RADIUS}" mass="{options.density * mesh.areas.sum()}"
      point="{_text(points)}" element="{_text(mesh.triangles)}">
      <elasticity young="{options.young}" poisson="{_POISSON}" thickness="{_THICKNESS}" damping="{_DAMPING}"
        elastic2d="both"/>
      <contact friction="{options.friction}" solref="0.01 1" solimp="0.95 0.99 0.001" priority="1"/>
    </flexcomp>
    <body name="gripper" mocap="true"/>"""
    grasps = "".join(
        f'<connect body1="cloth_{k}" body2="gripper" anchor="0 0 0" active="false" solref="0.01 1"/>'
        for k in range(len(points))
    )
    # a soft contact creeps under load: pure friction is made 20 times harder than the normal force
    return scene(
        cloth,
        options.friction,
        timestep=_TIMESTEP,
        solver="CG",
        iterations=_ITERATIONS,
        impratio=_IMPRATIO,
        more=f"<equality>{grasps}</equality>",
    )


def _quarter(points: np.ndarray, turns: int) -> np.ndarray:
    """Points [N, 2] turned about the origin by so many right angles."""
    for _ in range(turns):
        points = np.column_stack([-points[:, 1], points[:, 0]])
    return points


def _text(values: np.ndarray) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


def _planar_pose(flat: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Pose [3] (x, y in m, yaw in rad) that brings flat points [N, 3] around the origin closest to points [N, 3]."""
    a, b = (points[:, :2] - points[:, :2].mean(0) for points in (flat, now))
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    return np.array([*(now - place(flat, np.array([0, 0, yaw]))).mean(0)[:2], yaw])
