"""The spring-mass system in motion: guidance, contact with table and pusher, gradients."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.pushing import PushParams, push
from piegraph_cli.physics.simulation import drive, guide
from piegraph_cli.physics.springs import build_springs, contour, stability_bound
from tests.physics.objects import particles, turned

REST = particles()
GRAPH = build_springs(REST, 0.05)
START = torch.as_tensor(REST)
NOISY = torch.as_tensor(REST + np.array([0.03, 0, 0.01]) + np.random.default_rng(5).normal(0, 0.01, REST.shape))
LONG = GuidanceParams(iterations=2000, tolerance=1e-9)


def test_the_rest_shape_at_rest_stays():
    torch.testing.assert_close(guide(START, START, GRAPH), START, atol=1e-12, rtol=0)
    still = torch.full((1, 30, 2), 5.0).double()
    torch.testing.assert_close(push(START[None], still, GRAPH)[0], START, atol=1e-12, rtol=0)


def test_springs_alone_keep_the_momentum():
    torch.manual_seed(0)
    velocity = 0.001 * torch.randn_like(START)
    free = GuidanceParams(damping=1.0, gain=0.0, iterations=50, tolerance=0)
    raised = START + torch.tensor([0, 0, 1.0]).double()
    _, after = drive(raised, velocity, raised, GRAPH, free, torch.ones(50).double())
    torch.testing.assert_close(after.sum(0), velocity.sum(0), atol=1e-12, rtol=0)
    assert float((after - velocity).abs().max()) > 1e-4


def test_a_rigid_motion_of_the_setpoint_is_reached():
    target = torch.as_tensor(turned(REST, (0.08, -0.03, 0.9)))
    torch.testing.assert_close(guide(START, target, GRAPH, LONG), target, atol=1e-6, rtol=0)
    assert float((guide(START, target, GRAPH) - target).norm(dim=1).max()) < 5e-4


def test_guidance_lies_between_the_setpoint_and_the_shape():
    guided = guide(START, NOISY, GRAPH, LONG)
    first, second = GRAPH.pairs.T

    def strain(x):
        return float(((x[first] - x[second]).norm(dim=1) - torch.as_tensor(GRAPH.rest_length)).abs().mean())

    assert strain(guided) < 0.4 * strain(NOISY)
    torch.testing.assert_close(guided.mean(0), NOISY.mean(0), atol=2e-3, rtol=0)


@settings(max_examples=15, deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-np.pi, np.pi), st.integers(0, 1000))
def test_guidance_commutes_with_planar_motions(x, y, yaw, seed):
    setpoint = REST + np.random.default_rng(seed).normal(0, 0.01, REST.shape)
    moved = [torch.as_tensor(turned(a, (x, y, yaw))) for a in (REST, setpoint)]
    params = GuidanceParams(integral=0.001, derivative=0.05, friction=0.3, iterations=60, tolerance=0)
    before = guide(START, torch.as_tensor(setpoint), GRAPH, params).numpy()
    np.testing.assert_allclose(guide(*moved, GRAPH, params).numpy(), turned(before, (x, y, yaw)), atol=1e-9)


def test_a_batch_is_its_members():
    torch.manual_seed(0)
    setpoints = START + 0.01 * torch.randn(300, 50, 3).double()  # more than one chunk
    fixed = GuidanceParams(iterations=30, tolerance=0)
    together = guide(START.expand(300, 50, 3), setpoints, GRAPH, fixed)
    for k in (0, 127, 128, 299):
        torch.testing.assert_close(together[k], guide(START, setpoints[k], GRAPH, fixed), atol=1e-12, rtol=0)


def test_an_unweighted_particle_follows_its_springs_only():
    weights = torch.ones(50).double()
    weights[7] = 0
    stray = START + 0.05
    stray[7] += 0.5
    torch.testing.assert_close(guide(START, stray, GRAPH, LONG, weights)[7], START[7] + 0.05, atol=1e-4, rtol=0)


def test_an_integral_gain_returns_the_raw_setpoint():
    above = NOISY.clone()
    above[:, 2] = above[:, 2].clamp_min(0)
    soft = GuidanceParams(stiffness=0.01, iterations=4000, tolerance=0)
    assert float((guide(START, above, GRAPH, soft) - above).norm(dim=1).mean()) > 0.004
    integral = soft.model_copy(update={"integral": 0.001, "integral_limit": 100.0})
    assert float((guide(START, above, GRAPH, integral) - above).norm(dim=1).mean()) < 2e-4
    clamped = integral.model_copy(update={"integral_limit": 0.01})
    assert float((guide(START, above, GRAPH, clamped) - above).norm(dim=1).mean()) > 0.004


def test_unstable_parameters_are_refused_with_their_bound():
    bound = stability_bound(GRAPH, 0.8, 0.03)
    with pytest.raises(UsageError, match=re.escape(f"less than {bound:.4g}")):
        guide(START, START, GRAPH, GuidanceParams(stiffness=1.01 * bound))
    with pytest.raises(UsageError, match="less than"):
        guide(START, START, GRAPH, GuidanceParams(stiffness=0.99 * bound), weights=torch.full((50,), 10.0).double())
    with pytest.raises(UsageError, match=r"integral gain 0\.1 is unstable"):
        guide(START, START, GRAPH, GuidanceParams(integral=0.1))
    with pytest.raises(UsageError, match="less than"):
        push(START[None], torch.zeros(1, 5, 2), GRAPH, PushParams(stiffness=2.0))
    for wrong in ({"friction": -1}, {"iterations": 0}, {"damping": 1.1}):
        with pytest.raises(ValidationError, match=next(iter(wrong))):
            GuidanceParams(**wrong)


def test_bad_arrays_are_refused():
    with pytest.raises(DataError, match="setpoint"):
        guide(START, START * np.nan, GRAPH)
    with pytest.raises(DataError, match="50 particles"):
        guide(START[:-1], START[:-1], GRAPH)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_gradient_of_guidance(friction):
    graph = build_springs(REST[:8], 0.2)
    params = GuidanceParams(stiffness=0.5 * stability_bound(graph, 0.8), friction=friction, iterations=15, tolerance=0)
    setpoint = NOISY[:8].clone()
    setpoint[:3, 2] = -0.05  # some particles are pressed onto the table
    assert torch.autograd.gradcheck(
        lambda x, target, weight: guide(x, target, graph, params, weight),
        tuple(a.requires_grad_() for a in (START[:8].clone(), setpoint, torch.rand(8).double())),
    )


def test_gradient_of_a_push_in_stiffness_and_damping():
    graph = build_springs(REST[:8], 0.2)
    path = stroke((-0.2, 0.05), (-0.05, 0.05), 40)

    def run(stiffness, damping):
        return push(START[None, :8], path, graph, PushParams(stiffness, damping, radius=0.02))

    assert torch.autograd.gradcheck(run, (torch.tensor(0.05).double().requires_grad_(), torch.tensor(0.8).double()))


def stroke(start, end, steps) -> torch.Tensor:
    return torch.as_tensor(np.linspace(start, end, steps))[None]


def test_no_particle_sinks_below_the_table():
    sunk = guide(START, START - 0.1, GRAPH)
    assert float(sunk[:, 2].min()) == 0
    assert float(guide(START, START - 0.1, GRAPH, GuidanceParams(friction=0.5))[:, 2].min()) == 0


def test_friction_stops_what_slides():
    one = build_springs(np.zeros((1, 3)), 0.05)
    lies, speed = torch.zeros(1, 3).double(), torch.tensor([[0.01, 0, 0]]).double()
    heavy = torch.tensor([[0, 0, -0.001]]).double()  # pressed down by gain 1 times 1 mm

    def slide(friction):
        setpoint = lies + heavy
        x, v = lies, speed
        for _ in range(200):  # the pull is downwards only
            setpoint = torch.cat([x[:, :2], heavy[:, 2:]], dim=1)
            step = GuidanceParams(gain=1.0, damping=1.0, friction=friction, iterations=1, tolerance=0)
            x, v = drive(x, v, setpoint, one, step, torch.ones(1).double())
        return float(x[0, 0]), float(v.abs().max())

    assert slide(0.0) == pytest.approx((2.0, 0.01))
    distance, rest = slide(0.5)
    assert rest < 1e-12
    assert distance == pytest.approx(0.01 * 20 / 2, abs=0.006)  # v² / 2 μ g, with g = 1 mm per iteration²


def test_the_pusher_is_never_entered_and_pushes():
    path = stroke((-0.2, 0.0), (0.05, 0.0), 600)
    graph = build_springs(REST, 0.08)
    params = PushParams(0.15, friction=1e-5, radius=0.025)  # the disc is wider than the gaps
    for steps in (450, 520, 600):
        state = push(START[None], path[:, :steps], graph, params)[0]
        assert float((state[:, :2] - path[0, steps - 1]).norm(dim=1).min()) >= 0.025 - 1e-9
    # the stem, 2.5 cm left of the middle, makes way for an edge that ends at 7.5 cm, less where it is round
    assert 0.07 < float((state - START)[:, 0].mean()) < 0.11


def test_a_pusher_does_not_slip_through_a_gap_of_the_contour():
    """Two particles 6 cm apart, a disc of 1 cm between them: alone they are not touched, as ends of a segment they go along."""
    pair = np.array([[0, -0.03, 0], [0, 0.03, 0]])
    path, start = stroke((-0.05, 0.0), (0.05, 0.0), 200), torch.as_tensor(pair)[None]
    alone = build_springs(pair, 0.1)
    torch.testing.assert_close(push(start, path, alone), start)
    joined = push(start, path, replace(alone, contour=contour(pair)), PushParams(friction=1e-4))
    torch.testing.assert_close(joined[0, :, 0], torch.full((2,), 0.06).double(), atol=1e-3, rtol=0)


def test_what_is_pushed_stops_where_friction_has_taken_its_speed():
    one = build_springs(np.zeros((1, 3)), 0.05)
    path = stroke((-0.05, 0.0), (0.0, 0.0), 51)  # 1 mm per iteration

    def goes(friction):
        still = torch.cat([path, path[:, -1:].expand(-1, 100, -1)], 1)
        params = PushParams(damping=1.0, friction=friction, radius=0.02)
        return float(push(torch.zeros(1, 1, 3).double(), still, one, params)[0, 0, 0]) - 0.02

    assert goes(5e-5) == pytest.approx(1e-3**2 / 2 / 5e-5, abs=6e-4)  # v² / 2 μ g
    assert goes(2e-3) == pytest.approx(0, abs=1e-9)


def test_a_pusher_that_grips_drags_along_what_it_passes():
    """A disc that passes 1 mm into a particle, to its side: without friction it leaves it almost where it was."""
    one = build_springs(np.zeros((1, 3)), 0.05)
    path = stroke((-0.1, 0.019), (0.1, 0.019), 400)

    def ahead(grip):
        params = PushParams(friction=1e-3, radius=0.02, grip=grip)
        return float(push(torch.zeros(1, 1, 3).double(), path, one, params)[0, 0, 0])

    assert abs(ahead(0.0)) < 0.01
    assert ahead(2.0) > ahead(0.0) + 0.003


def test_a_particle_in_the_middle_of_the_pusher_leaves_it():
    one = build_springs(np.zeros((1, 3)), 0.05)
    out = push(torch.zeros(1, 1, 3).double(), torch.zeros(1, 3, 2).double(), one, PushParams(radius=0.02))
    assert float(out[0, 0, :2].norm()) >= 0.02 - 1e-9


def test_a_pusher_that_would_jump_over_particles_is_refused():
    with pytest.raises(UsageError, match="more iterations"):
        push(START[None], stroke((-0.2, 0), (0.2, 0), 10), GRAPH, PushParams(radius=0.01))


def test_inference_does_not_spoil_later_gradients():
    graph = build_springs(REST, 0.05)
    with torch.inference_mode():
        guide(START, NOISY, graph)
    setpoint = NOISY.clone().requires_grad_()
    guide(START, setpoint, graph).sum().backward()
    assert float(setpoint.grad.abs().sum()) > 0
