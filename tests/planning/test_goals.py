"""Goals that are clouds: a thing in place is reached, a turned one never, and what is symmetric may lie either way."""

import functools

import numpy as np
import pytest
import torch

from piegraph_cli import environments
from piegraph_cli.physics.tracking import choose_particles
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.goals import Goal, move_in_plane
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Tool, make_planner, metric

OBJECTS = ("tblock", "rope-stiff", "rope-bendy", "toy", "tshirt")
REACHED = 0.02
"""Metres."""


def sampled(vertices: np.ndarray, triangles: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Points [count, 3] (m) spread over what of a surface looks up."""
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1) * (normal[:, 2] > 0)
    chosen = rng.choice(len(triangles), count, p=area / area.sum())
    u, v = np.sort(rng.random((2, count)), axis=0)
    at = u[:, None] * a[chosen] + (v - u)[:, None] * b[chosen] + (1 - v)[:, None] * c[chosen]
    return at.astype(np.float32)


@functools.cache
def clouds(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Two looks at an object that was pushed once, points of their own each."""
    env = environments.make(name)
    env.reset(seed=3)
    env.step(env.sample_stroke(np.random.default_rng(0), env.modes[0]))
    return tuple(sampled(env.surface(), env.triangles, 4000, seed) for seed in (0, 1))  # type: ignore[return-value]


def distance(state: np.ndarray, goal: np.ndarray, **settings) -> float:
    """From the goal (m), of an object that is seen as a cloud."""
    particles = choose_particles(state, 50).astype(np.float32)
    wanted = Goal.of_cloud(goal, state, particles)
    params = PlanParams(model="static", **settings)
    cost, _ = make_planner(None, particles, wanted, params, Tool(), [0])
    return float(cost(torch.as_tensor(particles)[None])[0])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["tblock", "toy"])
def test_what_has_one_pose_has_one_place_in_a_goal(name, seed):
    """However sparsely it is seen: what lies beside the best place by a centimetre is that place, laid less well."""
    rng = np.random.default_rng(seed)
    state, goal = (rng.permutation(cloud)[: int(rng.integers(60, 400))] for cloud in clouds(name))
    wanted = Goal.of_cloud(move_in_plane(goal, (0.1, -0.05, seed)), state, choose_particles(state, 50))
    assert wanted.particles is not None
    assert len(wanted.particles) == 1


@pytest.mark.parametrize("turn", range(12))
@pytest.mark.parametrize("name", OBJECTS)
def test_a_turned_thing_is_not_in_place(name, turn):
    """A rope turned by half lies on its own place but for its bend, so that is left out."""
    state, goal = clouds(name)
    right = move_in_plane(state, (0.1, -0.05, turn * np.pi / 6))
    assert distance(right, move_in_plane(goal, (0.1, -0.05, turn * np.pi / 6))) < REACHED / 2
    if turn and not (name.startswith("rope") and turn == 6):
        assert distance(right, move_in_plane(goal, (0.1, -0.05, 0.0))) > 1.25 * REACHED


def test_a_symmetric_thing_may_lie_either_way():
    side = np.linspace(-0.05, 0.05, 40)
    square = np.column_stack([np.stack(np.meshgrid(side, side), -1).reshape(-1, 2), np.full(1600, 0.01)])
    particles = choose_particles(square, 50).astype(np.float32)
    found = Goal.of_cloud(square, square, particles).particles
    assert found is not None
    assert len(found) > 1
    quarter = move_in_plane(square, (0.0, 0.0, np.pi / 2))
    assert distance(quarter, square) < REACHED / 4


def test_a_goal_bent_otherwise_is_measured_by_transport():
    rng = np.random.default_rng(0)
    along = np.linspace(-0.2, 0.2, 2000)
    rope = np.column_stack([along, rng.normal(0, 0.003, 2000), np.full(2000, 0.01)])
    bent = np.column_stack([0.12 * np.sin(along * 8), 0.12 * np.cos(along * 8), np.full(2000, 0.01)])
    goal = Goal.of_cloud(bent, rope, choose_particles(rope, 50).astype(np.float32))
    assert goal.particles is None
    assert metric(PlanParams(), goal) == "emd"
    assert metric(PlanParams(), Goal.of_particles(rope)) == "distance"
    assert metric(PlanParams(cost="chamfer"), goal) == "chamfer"


def test_chamfer_distance_is_the_metrics_own():
    from piegraph_cli.evaluation.metrics import chamfer_distance

    one, other = (torch.as_tensor(cloud[:50]) for cloud in clouds("toy"))
    asked = float(make_cost("chamfer", other, 50)(one[None])[0])
    assert asked * 100 == pytest.approx(chamfer_distance(one.numpy(), other.numpy()), rel=1e-5)


def test_cost_is_to_the_nearest_of_several_poses():
    state = torch.zeros(1, 4, 3)
    poses = torch.stack([torch.full((4, 3), 0.3), torch.full((4, 3), 0.1)])
    assert float(make_cost("distance", poses, 4)(state)[0]) == pytest.approx(0.1 * 3**0.5)
