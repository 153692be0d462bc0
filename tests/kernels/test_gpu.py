"""On a GPU: kernels against the references in float64 and against those of the CPU, streams, recorded plans, training."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.bench.kernels import graph_of, random_object
from piegraph_cli.bench.pipeline import carried_sequences
from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.models import MODELS, Trained, make_foresee, make_network, recordable
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.dynamics.params import BY_GRADIENT, EGNNParams
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.params import PUSH
from piegraph_cli.physics import pushing, simulation, spring_kernel
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.springs import contour, stability_bound
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import stroke_space
from piegraph_cli.planning.search import Search
from tests.dynamics.test_network_kernel import case
from tests.physics.test_spring_kernel import FIXED, GRAPH, scene

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")

ENDS = 40
"""Candidates at each end of a batch that are compared."""


def ends(batch: int) -> torch.Tensor:
    return torch.unique(torch.cat([torch.arange(min(batch, ENDS)), torch.arange(max(0, batch - ENDS), batch)]))


@pytest.mark.parametrize("particles", [50, 100, 400])
@pytest.mark.parametrize("batch", [1, 64, 500, 4099, 65536])
def test_guidance_for_any_number_of_candidates_and_particles(batch, particles):
    rng = np.random.default_rng(batch + particles)
    rest = random_object(particles, rng)
    graph = graph_of(rest, 260 * particles // 50)
    params = GuidanceParams(stiffness=min(0.15, 0.5 * stability_bound(graph, 0.8, 0.03)), iterations=60, tolerance=0)
    start = torch.as_tensor(rest.astype(np.float32)).expand(batch, -1, -1)
    goal = (
        start.cuda() + 0.02 * torch.randn(batch, 1, 3, device="cuda") + 0.002 * torch.randn(start.shape, device="cuda")
    )
    found = spring_kernel.guide(start.cuda(), goal, graph, params)
    assert torch.isfinite(found).all()
    some = ends(batch)
    at, wanted = start[some], goal[some.cuda()].cpu()
    true = simulation.guide(at.double().cuda(), wanted.double().cuda(), graph, params)
    assert float((found[some.cuda()] - true).abs().max()) < 1e-5
    assert float((found[some.cuda()].cpu() - spring_kernel.guide(at, wanted, graph, params)).abs().max()) < 1e-5


@pytest.mark.parametrize(
    "terms",
    [
        {"tension_only": True},
        {"friction": 0.6},
        {"integral": 0.001, "integral_limit": 0.02},
        {"derivative": 0.1},
        {"tolerance": 1e-5},
    ],
    ids=str,
)
def test_terms_of_guidance(terms):
    start, goal, weights = scene(70)
    goal[:, :, 2] -= 0.01
    params = GuidanceParams(**FIXED | terms)
    found = spring_kernel.guide(start.cuda(), goal.cuda(), GRAPH, params, weights.cuda()).cpu()
    for k in range(len(start)):  # alone, since each stops by itself
        one = (start[k : k + 1].double(), goal[k : k + 1].double())
        true = simulation.guide(*one, GRAPH, params, weights[k : k + 1].double())
        assert float((found[k] - true).abs().max()) < 1e-5


@pytest.mark.parametrize("held", [False, True])
def test_a_pusher(held):
    start, _, _ = scene(40, 7)
    grip = torch.zeros(40, 50, dtype=torch.bool)
    grip[::2, [3, 17]] = held
    angle = torch.linspace(0, 2 * np.pi, 40)
    travel = torch.linspace(-0.25, 0.1, 400)[None, :, None]
    path = start.mean(1, keepdim=True)[..., :2] + travel * torch.stack([angle.cos(), angle.sin()], -1)[:, None]
    params = pushing.PushParams(friction=2e-5, grip=0.4, radius=0.025)
    graph = replace(GRAPH, contour=contour(start[0].numpy()))
    true = pushing.push(start.double(), path.double(), graph, params, grip if held else None)
    found = spring_kernel.push(start.cuda(), path.cuda(), graph, params, grip.cuda() if held else None)
    assert float((found.cpu() - true).abs().max()) < 1e-5


@pytest.mark.parametrize(("picks", "mirror"), [(False, False), (True, True)])
@pytest.mark.parametrize(("batch", "particles"), [(1, 50), (64, 100), (500, 50), (500, 400), (4099, 100), (65536, 50)])
def test_the_network_for_any_number_of_candidates_and_particles(batch, particles, picks, mirror):
    network = EGNN(12, 32, 4, True, picks, mirror=mirror)
    rest, states, strokes = case(batch, batch, particles, network)
    known = Rest.of(rest[None], 12)
    on_gpu = Rest(known.positions.cuda(), known.neighbors.cuda())
    found = NetworkKernel(network, on_gpu)(states.cuda(), strokes.to("cuda")).cpu()
    assert torch.isfinite(found).all()
    some = ends(batch)
    exact = Rest(known.positions.double(), known.neighbors)
    with torch.no_grad():
        true = copy.deepcopy(network).double()(
            states[some].double(), strokes[some].to(torch.float64), exact.expand(len(some))
        )
    assert float((found[some] - true).abs().max()) < 1e-5
    assert float((found[some] - NetworkKernel(network, known)(states[some], strokes[some])).abs().max()) < 1e-5


def test_two_streams_do_not_share_memory():
    start, goal, _ = (part.cuda() for part in scene(500))
    network = EGNN(12, 32, 4, True)
    rest, states, strokes = (part.to("cuda") for part in case(0, 500, 50, network))
    kernel = NetworkKernel(network, Rest.of(rest[None], 12))
    params = GuidanceParams(**FIXED)
    guided, predicted = spring_kernel.guide(start, goal, GRAPH, params), kernel(states, strokes)
    torch.cuda.synchronize()
    streams = torch.cuda.Stream(), torch.cuda.Stream()
    for _ in range(20):
        with torch.cuda.stream(streams[0]):
            first = spring_kernel.guide(start, goal, GRAPH, params)
        with torch.cuda.stream(streams[1]):
            second = kernel(states, strokes)
        torch.cuda.synchronize()
        assert torch.equal(first, guided)
        assert torch.equal(second, predicted)


def make_search(device: str, record: bool) -> tuple[Search, torch.Tensor]:
    rest = torch.as_tensor(random_object(50, np.random.default_rng(0)).astype(np.float32)) - torch.tensor(
        [0.1, 0.1, 0.0]
    )
    params = PlanParams(samples=64, cem_iterations=6, converged=0)
    trained = Trained(make_network("piegraph", EGNNParams(), False, 0), EGNNParams(), 0.0, (PUSH,), 50)
    state = rest.to(device)
    cost = make_cost("distance", state + torch.tensor([0.05, 0.02, 0.0], device=device), 50)
    space = stroke_space(state, params, (PUSH,), params.pusher_radius)
    foresee = make_foresee("piegraph", trained, state, params)
    return Search(foresee, cost, space, params, torch.Generator(device).manual_seed(0), record), state


def test_a_recorded_plan_is_that_of_the_same_search_step_by_step():
    searches = [make_search("cuda", record)[0] for record in (True, False)]
    state = make_search("cuda", False)[1]
    for k in range(3):
        recorded, plain = (search(state + 0.01 * k) for search in searches)
        assert torch.equal(recorded.candidates.strokes.ends, plain.candidates.strokes.ends)
        assert torch.equal(recorded.strokes.ends, plain.strokes.ends)
        assert recorded.cost == plain.cost
        assert recorded.predicted.device.type == "cpu"


def test_a_plan_is_as_good_as_one_of_the_cpu():
    (search, state), (other, there) = make_search("cuda", True), make_search("cpu", False)
    costs = [[s(at).cost for _ in range(4)] for s, at in ((search, state), (other, there))]
    assert abs(min(costs[0]) - min(costs[1])) < 2e-3


def test_what_is_recorded_is_what_runs_in_kernels():
    assert [name for name in MODELS if recordable(name)] == ["piegraph", "piegraph-ng"]


@pytest.mark.parametrize("name", sorted(BY_GRADIENT))
def test_training_follows_the_curve_of_the_cpu(name):
    data, losses = carried_sequences(), {}
    steps = 200 if name == "piegraph" else 3
    params = BY_GRADIENT[name](steps=200)
    learner = MODELS[name].learner
    for device in ("cpu", "cuda"):
        network = make_network(name, params, False, 0)
        trainer = Trainer(network, learner.examples(data, params, device), None, params, 0, device)
        losses[device] = []
        for _ in range(steps):
            before = trainer.recent[0]
            trainer.step()
            losses[device].append(trainer.recent[0] - before)
    np.testing.assert_allclose(losses["cuda"], losses["cpu"], rtol=2e-2)
