"""Benchmarks of the two kernels, on random objects, beside the references in PyTorch."""

import copy
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.bench.measure import Row, check, core_counts, median_seconds, on_cores, peak
from piegraph_cli.dynamics.action import FEATURES
from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.dynamics.params import EGNNParams
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PUSH
from piegraph_cli.physics import spring_kernel
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.simulation import guide
from piegraph_cli.physics.springs import SpringGraph, build_springs, stability_bound

BATCHES = (64, 128, 256, 1024, 4096)
PARTICLES = (100, 200, 400)
SPRINGS = (120, 500, 900)
CHECKED = 64
"""Candidates compared with the reference in float64."""

ALLOWED = 1e-5
"""Metres."""

REFERENCE_CHUNK = 25
"""Candidates that the network in PyTorch predicts together: the fastest of the sizes tried."""


def spring_rows() -> Iterator[Row]:
    """512 x 50 particles x 260 springs x 200 iterations, then one of these changed at a time."""
    for cores in core_counts():
        yield _springs(512, 50, 260, cores, reference=cores == 1)
    yield from (_springs(batch, 50, 260) for batch in BATCHES)
    yield from (_springs(512, particles, 260 * particles // 50) for particles in PARTICLES)
    yield from (_springs(512, 50, count) for count in SPRINGS)


def network_rows() -> Iterator[Row]:
    """512 x 50 particles, 12 neighbours, 32 channels, 4 layers, then one of these changed at a time."""
    for cores in core_counts():
        yield _network(512, 50, cores, reference=cores == 1)
    yield from (_network(batch, 50) for batch in BATCHES)
    yield from (_network(512, particles) for particles in PARTICLES)


def random_object(particles: int, rng: np.random.Generator) -> np.ndarray:
    """Particles [N, 3] (m) of a flat object, as dense as 50 on 20 by 20 cm."""
    side = 0.2 * (particles / 50) ** 0.5
    return rng.uniform([0, 0, 0.01], [side, side, 0.04], (particles, 3))


def random_strokes(batch: int, rng: np.random.Generator) -> Strokes:
    """Pushes [B] of 5 to 20 cm."""
    start, heading = rng.uniform(0, 0.2, (batch, 2)), rng.uniform(0, 2 * np.pi, batch)
    end = start + rng.uniform(0.05, 0.2, (batch, 1)) * np.stack([np.cos(heading), np.sin(heading)], 1)
    return Strokes.of(start.astype(np.float32), end.astype(np.float32), PUSH)


def graph_of(rest: np.ndarray, count: int) -> SpringGraph:
    """The springs of an object [N, 3], their reach chosen for about `count` of them."""
    distance = np.sort(np.linalg.norm(rest[:, None] - rest[None], axis=-1)[np.triu_indices(len(rest), 1)])
    return build_springs(rest, float(distance[count - 1]) + 1e-9)


def spring_case(batch: int, particles: int, count: int) -> tuple[Tensor, Tensor, SpringGraph, GuidanceParams]:
    """A random object in B scenes and where it shall go [B, N, 3] (m), its springs, and 200 iterations without an end."""
    rng = np.random.default_rng([batch, particles, count])
    rest = random_object(particles, rng)
    graph = graph_of(rest, count)
    params = GuidanceParams(stiffness=min(0.15, 0.5 * stability_bound(graph, 0.8, 0.03)), iterations=200, tolerance=0)
    state = torch.as_tensor(rest.astype(np.float32)).expand(batch, -1, -1)
    moved = rest + rng.normal(0, 0.02, (batch, 1, 3)) + rng.normal(0, 0.002, (batch, particles, 3))
    return state, torch.as_tensor(moved.astype(np.float32)), graph, params


def spring_flop(graph: SpringGraph, params: GuidanceParams) -> float:
    """Operations of the guidance of one candidate."""
    return params.iterations * (21.0 * len(graph.pairs) + 25.0 * graph.particles)


def _springs(batch: int, particles: int, count: int, cores: int = 1, reference: bool = False) -> Row:
    state, setpoint, graph, params = spring_case(batch, particles, count)
    few = slice(min(batch, CHECKED))
    true = guide(state[few].double(), setpoint[few].double(), graph, params)
    error = float((spring_kernel.guide(state[few], setpoint[few], graph, params) - true).abs().max())
    with on_cores(cores):
        seconds = median_seconds(lambda: spring_kernel.guide(state, setpoint, graph, params))
    joined = len(graph.pairs)
    case = f"{batch} x {particles} x {joined} springs"
    flop = batch * spring_flop(graph, params)
    moved_bytes = 4.0 * batch * params.iterations * (9 * joined + 22 * particles)
    slow = median_seconds(lambda: _gather(state, setpoint, graph, params), 1) if reference else None
    share = flop / seconds / peak(cores)
    return Row("sms", case, seconds, cores, check("sms", error, ALLOWED), flop, moved_bytes, slow, share)


def _gather(state: Tensor, setpoint: Tensor, graph: SpringGraph, params: GuidanceParams) -> Tensor:
    """Guidance as one writes it first in PyTorch: the ends of all springs gathered, their forces added by index."""
    first, second = (torch.as_tensor(i) for i in graph.pairs.T)
    rest = torch.as_tensor(graph.rest_length.astype(np.float32))
    x, v = state.clone(), torch.zeros_like(state)
    for _ in range(params.iterations):
        span = x[:, second] - x[:, first]
        pull = params.stiffness * (1 - rest / span.norm(dim=-1))[..., None] * span
        force = (params.gain * (setpoint - x)).index_add(1, first, pull).index_add(1, second, -pull)
        free = x + params.damping * (v + force)
        moved = torch.cat([free[..., :2], free[..., 2:].clamp_min(0)], -1)
        x, v = moved, moved - x
    return x


def network_flop(particles: int, params: EGNNParams) -> float:
    """Operations of one prediction; SiLU counts 15: a power of two, a sum, a quotient and a product."""
    hidden, edges = params.hidden, particles * min(params.neighbors, particles - 1)
    silu, per_edge = 15, 26
    layer = (
        2 * hidden**2
        + particles * (10 * hidden**2 + (silu + 8) * hidden)
        + edges * (per_edge + hidden * (5 + silu + 1 + 2))
    )
    ends = particles * (2 * FEATURES * hidden + 2 * hidden**2 + hidden * (silu + 6) + 40)
    return float(params.layers * layer + ends)


def network_case(batch: int, particles: int) -> tuple[EGNN, Rest, Tensor, Strokes]:
    """A fresh network, a random object at rest, B states of it [B, N, 3] (m), and a stroke for each."""
    rng = np.random.default_rng([batch, particles])
    params = EGNNParams()
    torch.manual_seed(batch + particles)
    network = EGNN(params.neighbors, params.hidden, params.layers, True)
    rest = random_object(particles, rng)
    state = torch.as_tensor((rest + rng.normal(0, 0.003, (batch, particles, 3))).astype(np.float32))
    strokes = random_strokes(batch, rng)
    return network, Rest.of(torch.as_tensor(rest[None].astype(np.float32)), params.neighbors), state, strokes


def _network(batch: int, particles: int, cores: int = 1, reference: bool = False) -> Row:
    params = EGNNParams()
    network, known, state, strokes = network_case(batch, particles)
    kernel = NetworkKernel(network, known)

    def predict() -> Tensor:
        kernel.look_at(Rest.of(known.positions, params.neighbors))
        return kernel(state, strokes)

    few = slice(min(batch, CHECKED))
    exact = Rest(known.positions.double(), known.neighbors)
    with torch.no_grad():
        true = _in_chunks(copy.deepcopy(network).double(), state[few].double(), strokes[few].to(torch.float64), exact)
    error = check("egnn", float((predict()[few] - true).abs().max()), ALLOWED)
    with on_cores(cores):
        seconds = median_seconds(predict)
    flop = batch * network_flop(particles, params)
    hidden, edges = params.hidden, particles * min(params.neighbors, particles - 1)
    traffic = (
        batch * 4.0 * params.layers * (edges * (hidden + 3 * hidden / 2) + particles * (5 * hidden**2 / 4 + 8 * hidden))
    )
    slow = None
    if reference:
        with torch.no_grad():
            slow = median_seconds(lambda: _in_chunks(network, state, strokes, known), 3)
    share = flop / seconds / peak(cores)
    return Row("egnn", f"{batch} x {particles}", seconds, cores, error, flop, traffic, slow, share)


def _in_chunks(network: EGNN, state: Tensor, strokes: Strokes, rest: Rest) -> Tensor:
    pairs = zip(state.split(REFERENCE_CHUNK), strokes.split(REFERENCE_CHUNK), strict=True)
    return torch.cat([network(x, s, rest.expand(len(x))) for x, s in pairs])
