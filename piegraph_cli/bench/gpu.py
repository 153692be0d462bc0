"""Benchmarks on a GPU; plans and training steps beside the same on the CPU: all cores, and one thread of PyTorch."""

import copy
import functools
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from piegraph_cli.bench.kernels import ALLOWED, CHECKED, network_case, network_flop, spring_case, spring_flop
from piegraph_cli.bench.measure import IN_MEMORY, Row, check, median_seconds
from piegraph_cli.bench.pipeline import carried_sequences, learned_block, make_trainer
from piegraph_cli.dynamics.egnn import Rest
from piegraph_cli.dynamics.models import Trained, make_foresee
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.dynamics.params import EGNNParams
from piegraph_cli.params import PUSH
from piegraph_cli.physics import spring_kernel
from piegraph_cli.physics.simulation import guide
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import stroke_space
from piegraph_cli.planning.search import Search

MATRIX = 8192
"""Rows of the matrices that are multiplied for the peak."""

SIZES = ((100, 50), (512, 50), (4096, 50), (65536, 50), (512, 400))
"""Candidates and particles."""

AS_GOOD = 2e-3
"""Metres by which the cost of a plan may differ from one of the CPU, which draws other candidates."""


def seconds_of(work: Callable[[], Any], repeats: int = 9) -> float:
    """Median time until the GPU has done the work."""

    def done() -> None:
        work()
        torch.cuda.synchronize()

    return median_seconds(done, repeats)


@functools.cache
def peak() -> float:
    """Operations a second of a large product of float32 matrices."""
    a, b = torch.randn(2, MATRIX, MATRIX, device="cuda")
    return 2.0 * MATRIX**3 / seconds_of(lambda: a @ b)


def machine_rows() -> Iterator[Row]:
    """What the GPU can do at most."""
    name = torch.cuda.get_device_name()
    yield Row("machine", f"{name}, 1 TFlop in matrices", 1e12 / peak(), flop=1e12, share=1.0, device="cuda")
    source = torch.ones(8 * IN_MEMORY, device="cuda")
    target = torch.empty_like(source)
    rate = 8.0 * len(source) / seconds_of(lambda: target.copy_(source))
    yield Row("machine", f"copy in its memory, {rate / 1e9:.0f} GB/s", 1e9 / rate, bytes=1e9, device="cuda")


def spring_rows() -> Iterator[Row]:
    """200 iterations of guidance."""
    for batch, particles in SIZES:
        state, setpoint, graph, params = spring_case(batch, particles, 260 * particles // 50)
        few = slice(min(batch, CHECKED))
        true = guide(state[few].double(), setpoint[few].double(), graph, params)
        state, setpoint = state.cuda(), setpoint.cuda()
        found = spring_kernel.guide(state, setpoint, graph, params)[few].cpu()
        error = check("sms", float((found - true).abs().max()), ALLOWED)
        seconds = seconds_of(functools.partial(spring_kernel.guide, state, setpoint, graph, params))
        flop = batch * spring_flop(graph, params)
        case = f"{batch} x {particles} x {len(graph.pairs)} springs"
        yield Row("sms", case, seconds, error=error, flop=flop, share=flop / seconds / peak(), device="cuda")


def network_rows() -> Iterator[Row]:
    """Predictions of the network."""
    for batch, particles in SIZES:
        network, known, state, strokes = network_case(batch, particles)
        few = slice(min(batch, CHECKED))
        exact = Rest(known.positions.double(), known.neighbors).expand(len(state[few]))
        with torch.no_grad():
            true = copy.deepcopy(network).double()(state[few].double(), strokes[few].to(torch.float64), exact)
        kernel = NetworkKernel(network, Rest(known.positions.cuda(), known.neighbors.cuda()))
        state, strokes = state.cuda(), strokes.to("cuda")
        error = check("egnn", float((kernel(state, strokes)[few].cpu() - true).abs().max()), ALLOWED)
        seconds = seconds_of(functools.partial(kernel, state, strokes))
        flop = batch * network_flop(particles, EGNNParams())
        share = flop / seconds / peak()
        yield Row("egnn", f"{batch} x {particles}", seconds, error=error, flop=flop, share=share, device="cuda")


def plan_rows() -> Iterator[Row]:
    """Plans for the T-block, the loop around the models on the GPU too; beside the same on all cores."""
    state, trained = learned_block()
    for samples, iterations in ((100, 5), (500, 30)):
        for model, converged in (("piegraph", 0.0), ("piegraph-ng", 0.0), ("piegraph", 2e-4)):
            params = PlanParams(samples=samples, cem_iterations=iterations, model=model, converged=converged)
            here, there = (_search(state, trained, params, device) for device in ("cpu", "cuda"))
            costs = [found.cost for search in (here, there) if (found := search(state)) is not None]
            for _ in range(2):  # the second is recorded
                there(state)
            seconds = seconds_of(functools.partial(there, state))
            slow = median_seconds(functools.partial(here, state), 3)
            name = f"{samples} x {iterations}, {'guided' if model == 'piegraph' else 'not guided'}"
            name += ", may end early" if converged else ""
            error = check("plan", abs(costs[0] - costs[1]), AS_GOOD)
            yield Row("plan", name, seconds, error=error, reference_seconds=slow, device="cuda")


def _search(state: Tensor, trained: Trained, params: PlanParams, device: str) -> Search:
    rest = state.to(device)
    cost = make_cost("distance", rest + torch.tensor([0.1, 0.05, 0.0]).to(rest), len(rest))
    space = stroke_space(rest, params, (PUSH,), params.pusher_radius)
    generator = torch.Generator(device).manual_seed(0)
    return Search(make_foresee(params.model, trained, rest, params), cost, space, params, generator, rest.is_cuda)


def train_rows() -> Iterator[Row]:
    """A training step of piegraph, beside one on the CPU."""
    data = carried_sequences()
    for batch in (8, 32, 256):
        params = EGNNParams(batch=batch)
        seconds = seconds_of(make_trainer("piegraph", data, params, "cuda").step)
        slow = median_seconds(make_trainer("piegraph", data, params).step, 3)
        flop = 3 * batch * network_flop(50, params)
        yield Row("train", f"a step, batch {batch}", seconds, flop=flop, reference_seconds=slow, device="cuda")


ROWS: dict[str, Callable[[], Iterator[Row]]] = {
    "sms": spring_rows,
    "egnn": network_rows,
    "plan": plan_rows,
    "train": train_rows,
}
"""By subject; the others have nothing on a GPU."""
