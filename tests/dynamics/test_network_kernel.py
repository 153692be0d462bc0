"""The network kernel against the network itself in float64, on fresh random weights and inputs."""

import copy

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.dynamics.stroke import Strokes


def case(seed: int, batch: int, particles: int, network: EGNN):
    """A network with weights a little larger than at the start of training, an object at rest, states and strokes."""
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    with torch.no_grad():
        for parameter in network.parameters():
            bound = parameter.shape[-1] ** -0.5
            parameter.copy_(1.3 * bound * (2 * random(*parameter.shape) - 1))
    rest = random(particles, 3) * torch.tensor([0.3, 0.2, 0.05])
    states = rest + 0.01 * (random(batch, particles, 3) - 0.5) + torch.tensor([0.4, -0.2, 0.0])
    start = 0.3 * random(batch, 2)
    heading = 6.28 * random(batch)
    end = start + (0.02 + 0.2 * random(batch, 1)) * torch.stack([heading.cos(), heading.sin()], -1)
    mode = (random(batch) < 0.5).float() * network.picks
    return rest, states, Strokes.of(start, end, mode, random(batch, 2) < 0.5)


def difference(rest, states, strokes, network) -> tuple[float, float]:
    """Largest deviation of the kernel, and the largest motion (m)."""
    known = Rest.of(rest[None], network.neighbors)
    exact = Rest(known.positions.double(), known.neighbors)
    with torch.no_grad():
        true = copy.deepcopy(network).double()(states.double(), strokes.to(torch.float64), exact.expand(len(states)))
    found = NetworkKernel(network, known)(states, strokes)
    assert found.dtype == torch.float32
    return float((found - true).abs().max()), float((true - states).abs().max())


@pytest.mark.parametrize("head", [True, False])
@pytest.mark.parametrize("picks", [True, False])
@pytest.mark.parametrize(("pool", "mirror"), [(True, True), (True, False), (False, False)])
def test_agrees_with_the_network(head, picks, pool, mirror):
    network = EGNN(12, 32, 4, head, picks, pool, mirror)
    deviation, motion = difference(*case(0, 100, 50, network), network)
    assert motion > 0.01
    assert deviation < 1e-5


@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 1000),
    st.integers(1, 70),
    st.integers(2, 40),
    st.integers(1, 15),
    st.integers(1, 20),
    st.integers(1, 3),
)
def test_any_size(seed, batch, particles, neighbors, hidden, layers):
    network = EGNN(neighbors, hidden, layers, True, True, mirror=seed % 2 == 0)
    assert difference(*case(seed, batch, particles, network), network)[0] < 1e-5


def test_many_particles():
    network = EGNN(12, 32, 4, True)
    assert difference(*case(1, 3, 400, network), network)[0] < 1e-5


def test_saturated_units_are_finite():
    network = EGNN(12, 16, 2, True)
    rest, states, strokes = case(2, 5, 20, network)
    with torch.no_grad():
        for layer in network.layers:
            layer.receive.bias.copy_(torch.linspace(-500, 500, 16))
    deviation, motion = difference(rest, states, strokes, network)
    assert deviation < 1e-4 * max(motion, 1)


def test_order_of_candidates_and_of_particles_does_not_matter():
    network = EGNN(6, 16, 2, True)
    rest, states, strokes = case(3, 130, 30, network)
    kernel = NetworkKernel(network, Rest.of(rest[None], 6))
    found = kernel(states, strokes)
    torch.testing.assert_close(
        kernel(states.flip(0), strokes[torch.arange(len(strokes)).flip(0)]).flip(0), found, atol=1e-7, rtol=0
    )
    mixed = torch.randperm(30, generator=torch.Generator().manual_seed(0))
    other = NetworkKernel(network, Rest.of(rest[None, mixed], 6))
    torch.testing.assert_close(other(states[:, mixed], strokes), found[:, mixed], atol=1e-6, rtol=0)


def test_weights_that_change_in_place_are_read_again():
    network = EGNN(6, 8, 2, True)
    for seed in (0, 1):  # each with weights of its own, copied into the same network
        assert difference(*case(seed, 3, 20, network), network)[0] < 1e-5
        assert difference(*case(seed, 3, 20, network), network)[0] < 1e-5
