"""A soft toy on a table, pushed by a round pusher: a sloth lying on its belly, one elastic solid in MuJoCo.

Its surface is a fine mesh, but it deforms with a coarse grid of cells, each of which interpolates between its corners.
"""

import math

import numpy as np
from skimage.measure import marching_cubes

from piegraph_cli.environments.base import REACH, GoalState
from piegraph_cli.environments.mujoco_base import MujocoEnvironment, scene
from piegraph_cli.environments.params import ToyOptions
from piegraph_cli.physics.springs import farthest_point_sample

_CELLS = "5 6 2"
_POISSON = 0.3
_DAMPING = 0.05
_SKIN = 0.002
"""Metres around the mesh within which it is touched."""
_MESH_STEP = 0.05
_BLEND = 0.02
_LIGHT = 1e-3
"""Of the toy's mass: corners with less belong to cells that it hardly reaches."""
_LIGHT_DAMPING = 1e-3
"""N s/m; what it takes from the toy's speed is less than 1 % of what friction takes."""
_IMPRATIO = 10
_TIMESTEP = 0.01
_OUTLINE_RADIUS = 0.004
_UNDERSIDE = -0.2
_GOAL_SHIFT, _GOAL_TURN = 0.15, math.pi / 2

# from x, y, z to x, y, z, radius there and here; lengths in parts of the toy's own, which lies along x, its head at +x
_PARTS = np.array([
    [-0.18, 0.00, 0.135, 0.12, 0.00, 0.125, 0.130, 0.105],
    [0.34, 0.00, 0.125, 0.36, 0.00, 0.125, 0.125, 0.120],
    [0.12, 0.08, 0.090, 0.26, 0.33, 0.060, 0.075, 0.055],
    [0.12, -0.08, 0.090, 0.26, -0.33, 0.060, 0.075, 0.055],
    [-0.22, 0.07, 0.090, -0.42, 0.26, 0.060, 0.080, 0.060],
    [-0.22, -0.07, 0.090, -0.42, -0.26, 0.060, 0.080, 0.060],
])  # fmt: skip


class Toy(MujocoEnvironment):
    """A soft toy with a head, a body and four limbs; its nodes are the vertices of its surface.

    Source: paper, section "Real-world Experiments" (a sloth); shape and stiffness are this project's.
    """

    stroke_lengths = (0.06, 0.2)
    color = (0.02, 0.22, 0.24)

    def __init__(self, particles: int = 50, options: ToyOptions = ToyOptions()):
        self.options = options
        vertices, self.triangles = toy_mesh(options.size)
        super().__init__(particles, _mjcf(options, vertices, self.triangles))
        model = self.model
        bodies = np.setdiff1d(model.flex_nodebodyid, [0])
        light = model.body_mass[bodies] < _LIGHT * options.mass
        # their cells can neither bear nor calm these corners: they would drop by metres and shake the rest for ever
        model.body_gravcomp[bodies[light]] = 1
        model.dof_damping[self._qvel[light]] = _LIGHT_DAMPING
        self._qvel = self._qvel[~light]
        self.weights = _visible_points(vertices, self.triangles, particles)
        edges = np.sort(
            np.concatenate([self.triangles[:, [0, 1]], self.triangles[:, [1, 2]], self.triangles[:, [2, 0]]])
        )
        self._edges = np.unique(edges, axis=0)

    def surface(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """The toy's surface at nodes [..., V, 3] (m): the nodes themselves, float32 [..., V, 3] (m)."""
        return np.asarray(self.nodes if shapes is None else shapes, np.float32)

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """Goal particles, float32 [N, 3] (m): moved by up to 15 cm in x and in y and turned by up to 90 degrees as a whole.

        Goals that the table's reach does not allow are redrawn.
        """
        return self.goal_state(rng).particles

    def goal_state(self, rng: np.random.Generator) -> GoalState:
        """The goal with its nodes; the toy looks like itself in no other one."""
        particles = self.particles().astype(np.float64)
        centre = particles.mean(0)
        while True:
            dx, dy, turn = rng.uniform(-1, 1, 3) * [_GOAL_SHIFT, _GOAL_SHIFT, _GOAL_TURN]
            cos, sin = math.cos(turn), math.sin(turn)
            rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
            goal = (particles - centre) @ rotation.T + centre + [dx, dy, 0]
            if np.abs(goal[:, :2]).max() <= REACH:
                found = goal.astype(np.float32)
                return GoalState(found, (self.nodes - centre) @ rotation.T + centre + [dx, dy, 0], found[None])

    def _outline(self) -> tuple[np.ndarray, float]:
        nodes = self.nodes[:, :2]
        points = np.concatenate([nodes, nodes[self._edges].mean(1), nodes[self.triangles].mean(1)])
        return points, _OUTLINE_RADIUS


def toy_mesh(size: float) -> tuple[np.ndarray, np.ndarray]:
    """The toy's surface, `size` metres long: vertices [V, 3] (m), on z = 0 and around the origin; triangles [T, 3]."""
    low, high = np.array([-0.6, -0.5, -0.1]), np.array([0.6, 0.5, 0.4])
    axes = [np.arange(a, b, _MESH_STEP) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    vertices, triangles, _, _ = marching_cubes(_distance(points), 0.0, spacing=(_MESH_STEP,) * 3)
    vertices = vertices.astype(np.float64) * size / np.ptp(vertices[:, 0])
    middle = (vertices.min(0) + vertices.max(0)) / 2
    return vertices - [middle[0], middle[1], vertices[:, 2].min()], triangles


def _distance(points: np.ndarray) -> np.ndarray:
    """Roughly how far outside the toy points [..., 3] lie: rounded cones, their distances blended where they meet."""
    start, axis = _PARTS[:, :3], _PARTS[:, 3:6] - _PARTS[:, :3]
    relative = points[..., None, :] - start
    share = np.clip((relative * axis).sum(-1) / (axis**2).sum(-1), 0, 1)
    radius = _PARTS[:, 6] + (_PARTS[:, 7] - _PARTS[:, 6]) * share
    apart = np.linalg.norm(relative - share[..., None] * axis, axis=-1) - radius
    return -_BLEND * np.log(np.exp(-apart / _BLEND).sum(-1))


def _visible_points(vertices: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """Weights [count, V] of the vertices in points spread evenly over the surface, its underside left out."""
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    area[normal[:, 2] < _UNDERSIDE * area] = 0
    rng = np.random.default_rng(0)
    many = max(4000, 10 * count)
    chosen = rng.choice(len(triangles), many, p=area / area.sum())
    u, v = np.sqrt(rng.random(many)), rng.random(many)
    shares = np.column_stack([1 - u, u * (1 - v), u * v])
    kept = farthest_point_sample(np.einsum("nk,nkd->nd", shares, corners[chosen]), count)
    weights = np.zeros((count, len(vertices)))
    weights[np.arange(count)[:, None], triangles[chosen[kept]]] = shares[kept]
    return weights


def _mjcf(options: ToyOptions, vertices: np.ndarray, triangles: np.ndarray) -> str:
    raised = vertices + np.array([0, 0, _SKIN])
    point, element = (" ".join(map(repr, values.ravel().tolist())) for values in (raised, triangles))
    toy = f"""<flexcomp name="toy" type="direct" dim="2" dof="trilinear" cellcount="{_CELLS}" radius="{_SKIN}"
      mass="{options.mass}" point="{point}" element="{element}">
      <contact friction="{options.friction}" selfcollide="auto"/>
      <elasticity young="{options.young}" poisson="{_POISSON}" damping="{_DAMPING}" elastic2d="none"/>
    </flexcomp>"""
    return scene(toy, options.friction, timestep=_TIMESTEP, solver="CG", iterations=60, impratio=_IMPRATIO)
