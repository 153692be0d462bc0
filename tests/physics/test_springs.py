"""The spring graph: which springs there are, how stiff they may be, which particles are chosen."""

import numpy as np
import pytest
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.simulation import drive
from piegraph_cli.physics.springs import SpringGraph, build_springs, contour, farthest_point_sample, stability_bound
from tests.physics.objects import particles


def parts(graph: SpringGraph) -> int:
    first, second = graph.pairs.T
    return connected_components(coo_array((np.ones(len(first)), (first, second)), (graph.particles,) * 2))[0]


def test_springs_are_the_pairs_within_the_radius():
    positions = particles()
    graph = build_springs(positions, 0.05)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    expected = np.argwhere(np.triu(distance <= 0.05, 1))
    np.testing.assert_array_equal(graph.pairs, expected)
    np.testing.assert_allclose(graph.rest_length, distance[tuple(expected.T)])


def test_a_contour_joins_neighbours_and_closes_no_notch():
    """A row of particles is a chain; the two ends of an L are not joined over its corner, and heights do not count."""
    row = np.array([[0.01 * k, 0, 0.02 * (k % 2)] for k in range(5)])
    chain = {(k, k + 1) for k in range(4)}
    assert set(map(tuple, contour(row).tolist())) == chain
    bend = np.concatenate([row, [[0.04, 0.01 * k, 0] for k in range(1, 5)]])
    assert set(map(tuple, contour(bend).tolist())) == chain | {(4, 5), (5, 6), (6, 7), (7, 8)}
    np.testing.assert_array_equal(contour(row[:1]), [[0, 0]])


def test_spanning_tree_joins_two_parts_by_their_shortest_gap():
    left = np.c_[np.linspace(0, 0.1, 6), np.zeros(6), np.zeros(6)]
    right = left[::-1] + np.array([0.18, 0.01, 0])  # index 11 is the nearest to index 5
    graph = build_springs(np.concatenate([left, right]), 0.025)
    assert parts(graph) == 1
    assert len(graph.pairs) == 5 + 5 + 1
    assert [5, 11] in graph.pairs.tolist()


def test_one_particle_and_coincident_particles():
    assert build_springs(np.zeros((1, 3)), 0.05).pairs.shape == (0, 2)
    assert stability_bound(build_springs(np.zeros((1, 3)), 0.05), 0.8) == float("inf")
    assert parts(build_springs(np.array([[0, 0, 0], [0, 0, 0], [1.0, 0, 0]]), 0.05)) == 1


@pytest.mark.parametrize(("share", "stable"), [(0.99, True), (1.01, False)])
@pytest.mark.parametrize("gain", [0.0, 0.03])
def test_the_bound_parts_convergence_from_divergence(share, stable, gain):
    graph = build_springs(particles(), 0.05)
    linear = SpringGraph(graph.pairs, np.zeros(len(graph.pairs)), graph.particles)  # without rest lengths: exact
    params = GuidanceParams(
        stiffness=share * stability_bound(linear, 0.8, gain), gain=gain, iterations=1500, tolerance=0
    )
    setpoint = torch.full((50, 3), 0.5, dtype=torch.float64)
    start = setpoint + 0.01 * torch.randn((50, 3), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    end, _ = drive(start, torch.zeros_like(start), setpoint, linear, params, torch.ones(50, dtype=torch.float64))
    spread = float((end - end.mean(0)).abs().max())
    assert spread < 1e-3 if stable else not spread < 1


def test_rest_lengths_only_make_springs_softer():
    positions = particles()
    graph = build_springs(positions, 0.05)
    params = GuidanceParams(stiffness=0.999 * stability_bound(graph, 0.8, 0.03), iterations=1500, tolerance=0)
    start = torch.as_tensor(positions + np.random.default_rng(0).normal(0, 0.005, positions.shape))
    end, velocity = drive(start, 0 * start, torch.as_tensor(positions), graph, params, torch.ones(50).double())
    assert float(velocity.abs().max()) < 1e-6
    assert float((end - torch.as_tensor(positions)).abs().max()) < 1e-4


def test_bad_springs_are_refused():
    with pytest.raises(DataError, match="particle 2"):
        build_springs(np.array([[0, 0, 0], [0, 0, 1], [0, np.nan, 0]]), 0.05)
    with pytest.raises(DataError, match="at least 1"):
        build_springs(np.zeros((0, 3)), 0.05)
    with pytest.raises(UsageError, match="radius"):
        build_springs(np.zeros((2, 3)), 0.0)
    with pytest.raises(UsageError, match="damping"):
        stability_bound(build_springs(np.zeros((1, 3)), 0.05), 0.0)


def test_farthest_points_by_the_definition():
    points = np.random.default_rng(3).random((300, 3))
    chosen = farthest_point_sample(points, 20, start=7)
    assert chosen[0] == 7
    for k in range(1, 20):
        distance = np.linalg.norm(points[:, None] - points[chosen[:k]], axis=2).min(1)
        assert chosen[k] == distance.argmax()
    np.testing.assert_array_equal(farthest_point_sample(points, 9, start=7), chosen[:9])


def test_too_few_points_to_sample():
    with pytest.raises(DataError, match="4 points, but 5"):
        farthest_point_sample(np.random.default_rng(0).random((4, 3)), 5)
    with pytest.raises(DataError, match="only 1 distinct"):
        farthest_point_sample(np.ones((10, 3)), 3)
