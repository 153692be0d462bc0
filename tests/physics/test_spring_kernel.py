"""The spring kernel against the reference: the same physics in float32, for any batch, terms and number of cores."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.kernels import lanes
from piegraph_cli.physics import pushing, simulation, spring_kernel
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.pushing import PushParams
from piegraph_cli.physics.springs import build_springs, contour
from tests.physics.objects import particles, turned

REST = particles()
GRAPH = build_springs(REST, 0.05)
FIXED = {"iterations": 200, "tolerance": 0.0}


def scene(batch: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """States, setpoints near moved states, and weights, in float32."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform([-0.05, -0.05, -0.6], [0.05, 0.05, 0.6], (batch, 3))
    start = np.stack([turned(REST, pose) for pose in poses])
    goal = np.stack([turned(REST, pose + rng.uniform(-0.02, 0.02, 3)) for pose in poses])
    goal += rng.normal(0, 0.003, goal.shape)
    weights = rng.uniform(0, 1, start.shape[:2])
    return tuple(torch.as_tensor(a.astype(np.float32)) for a in (start, goal, weights))


@pytest.mark.parametrize(
    "terms",
    [{}, {"tension_only": True}, {"friction": 0.6}, {"integral": 0.001, "integral_limit": 0.02}, {"derivative": 0.1}],
    ids=str,
)
def test_guidance_agrees_with_the_reference(terms):
    start, goal, weights = scene(70)
    goal[:, :, 2] -= 0.01  # some is pressed into the table
    params = GuidanceParams(**FIXED, **terms)
    true = simulation.guide(start.double(), goal.double(), GRAPH, params, weights.double())
    found = spring_kernel.guide(start, goal, GRAPH, params, weights)
    assert found.dtype == torch.float32
    assert float((found - true).abs().max()) < 1e-5
    if terms:
        without = simulation.guide(start.double(), goal.double(), GRAPH, GuidanceParams(**FIXED), weights.double())
        assert float((true - without).abs().max()) > 1e-4, "the term does something here"


@pytest.mark.parametrize("batch", [1, 31, 32, 65])
def test_any_batch(batch):
    start, goal, _ = scene(batch, batch)
    true = simulation.guide(start.double(), goal.double(), GRAPH, GuidanceParams(**FIXED))
    assert float((spring_kernel.guide(start, goal, GRAPH, GuidanceParams(**FIXED)) - true).abs().max()) < 1e-5


def test_many_particles_and_a_graph_of_two_parts():
    rng = np.random.default_rng(3)
    rest = np.concatenate([rng.uniform(0, 0.2, (200, 3)), rng.uniform(0.5, 0.7, (200, 3))])
    graph = build_springs(rest, 0.04)
    params = GuidanceParams(stiffness=0.02, **FIXED)
    start = torch.as_tensor(rest[None].astype(np.float32))
    goal = start + 0.002 * torch.randn(1, 400, 3, generator=torch.Generator().manual_seed(0))
    true = simulation.guide(start.double(), goal.double(), graph, params)
    assert float((spring_kernel.guide(start, goal, graph, params) - true).abs().max()) < 1e-5


def test_a_particle_without_springs_follows_the_controller():
    graph = build_springs(np.zeros((1, 3)), 0.05)
    start, goal = torch.zeros(1, 1, 3), torch.full((1, 1, 3), 0.1)
    assert float((spring_kernel.guide(start, goal, graph, GuidanceParams()) - goal).abs().max()) < 1e-3


def test_a_group_at_rest_stops_whatever_the_others_do():
    start, goal, _ = scene(2 * spring_kernel.LANES)
    goal[: spring_kernel.LANES] = start[: spring_kernel.LANES] + 1e-4
    alone = spring_kernel.guide(start[: spring_kernel.LANES], goal[: spring_kernel.LANES], GRAPH)
    together = spring_kernel.guide(start, goal, GRAPH)
    assert torch.equal(together[: spring_kernel.LANES], alone)
    true = simulation.guide(start[: spring_kernel.LANES].double(), goal[: spring_kernel.LANES].double(), GRAPH)
    assert float((alone - true).abs().max()) < 1e-6, "stops in the same iteration as the reference"
    assert float((alone - simulation.guide(start[:32], goal[:32], GRAPH, GuidanceParams(**FIXED))).abs().max()) > 1e-6


def test_driving_takes_up_and_returns_the_velocity():
    start, goal, weights = (part[0] for part in scene(1, 4))
    velocity = 1e-3 * torch.randn(50, 3, generator=torch.Generator().manual_seed(1))
    given = velocity.clone()
    params = GuidanceParams(iterations=10)
    true = simulation.drive(*(a.double() for a in (start, velocity, goal)), GRAPH, params, weights.double())
    found = spring_kernel.drive(start, velocity, goal, GRAPH, params, weights)
    assert torch.equal(velocity, given)
    for a, b in zip(found, true, strict=True):
        assert float((a - b).abs().max()) < 1e-6


def test_driving_again_leaves_what_was_returned_before():
    start, goal, weights = (part[0] for part in scene(1, 4))
    params = GuidanceParams(iterations=10)
    first = spring_kernel.drive(start, 0 * start, goal, GRAPH, params, weights)
    kept = [part.clone() for part in first]
    with torch.inference_mode():
        spring_kernel.drive(goal, 0 * start, start, GRAPH, params, weights)
    assert all(torch.equal(a, b) for a, b in zip(first, kept, strict=True))
    again = spring_kernel.drive(start, 0 * start, goal, GRAPH, params, weights)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("tension_only", [False, True])
@pytest.mark.parametrize("friction", [0.0, 2e-5])
def test_a_pusher_agrees_with_the_reference(friction, tension_only, held):
    """Also beside scenes in which a hand holds two particles, and with numbers of each scene's own."""
    start, _, _ = scene(40, 7)
    grip = torch.zeros(40, 50, dtype=torch.bool)
    grip[::2, [3, 17]] = held
    angle = torch.linspace(0, 2 * np.pi, 40)
    travel = torch.linspace(-0.25, 0.1, 400)[None, :, None]
    path = start.mean(1, keepdim=True)[..., :2] + travel * torch.stack([angle.cos(), angle.sin()], -1)[:, None]
    graph = replace(GRAPH, contour=contour(REST))
    damping, drag = torch.linspace(0.6, 0.95, 40), torch.linspace(0.0, 1.0, 40)
    params = PushParams(0.1, damping=damping, friction=friction, radius=0.025, grip=drag, tension_only=tension_only)
    path[::3, 300:] = path[::3, 300:301]  # some stop before others, and settle for fewer iterations than are left
    params = replace(params, settle=40)
    true = pushing.push(start.double(), path.double(), graph, params, grip if held else None)
    found = spring_kernel.push(start, path, graph, params, grip if held else None)
    assert float((true - start).norm(dim=-1).mean()) > 0.01, "the pusher met the object"
    assert float((found - true).abs().max()) < 1e-5
    inside = (found[:, :, :2] - path[:, -1:]).norm(dim=-1) < params.radius - 1e-5
    assert not inside[~grip.any(1)].any()
    carried = (found - start)[..., :2][grip]
    whole = (path[:, -1] - path[:, 0])[:, None].expand(-1, 50, -1)[grip]
    torch.testing.assert_close(carried, whole, atol=1e-5, rtol=0)


def test_the_number_of_cores_changes_nothing(monkeypatch):
    start, goal, _ = scene(200)
    one, two = (_guide_on(monkeypatch, cores, start, goal) for cores in (1, 2))
    assert torch.equal(one, two)


def _guide_on(monkeypatch, cores, start, goal):
    monkeypatch.setattr(lanes, "cores", lambda: cores)
    return spring_kernel.guide(start, goal, GRAPH)


def test_bad_input_is_refused_as_by_the_reference():
    start, goal, _ = scene(2)
    with pytest.raises(DataError, match="not finite"):
        spring_kernel.guide(start, goal * np.nan, GRAPH)
    with pytest.raises(DataError, match="for 50 particles"):
        spring_kernel.guide(start[:, :-1], goal[:, :-1], GRAPH)
    with pytest.raises(UsageError, match="unstable"):
        spring_kernel.guide(start, goal, GRAPH, GuidanceParams(stiffness=1.0))
    with pytest.raises(UsageError, match="further than its radius"):
        spring_kernel.push(start, torch.tensor([[[0.0, 0.0], [0.5, 0.0]]]).expand(2, -1, -1), GRAPH)
