"""Thin things: how far along they are decides where their particles belong, from either end."""

import numpy as np
import pytest

from piegraph_cli.planning.thin import line_of, places_along

RADIUS = 0.01


def bow(share, turn: float):
    """Places [N, 2] and headings [N] at shares [N] of a line of 44 cm that turns by `turn` rad on its way."""
    fine = np.linspace(0, 1, 400)
    heading = turn * (fine - 0.5)
    line = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], -1), 0) * 0.44 / 400
    return np.stack([np.interp(share, fine, line[:, k]) for k in range(2)], -1), turn * (share - 0.5)


def rope(count: int, turn: float, seed: int):
    """Points [N, 3] (m) on the upper half of a bent rope, and how far along it they are [N]."""
    rng = np.random.default_rng(seed)
    share, around = rng.uniform(0, 1, count), rng.uniform(0, np.pi, count)
    place, heading = bow(share, turn)
    side = np.stack([-np.sin(heading), np.cos(heading)], -1) * RADIUS * np.cos(around)[:, None]
    return np.column_stack([place + side, RADIUS * (1 + np.sin(around))]), share


@pytest.mark.parametrize("turn", [0.0, 1.5, 3.0])
def test_particles_go_as_far_along_the_goal_as_they_are(turn):
    cloud, _ = rope(900, 0.8, seed=0)
    particles, share = rope(50, 0.8, seed=1)
    goal, _ = rope(1100, turn, seed=2)
    ways = places_along(line_of(goal), cloud, particles.astype(np.float32))
    off = {}
    for name, at in (("one", share), ("other", 1 - share)):
        place = bow(at, turn)[0]
        off[name] = [np.linalg.norm(way[:, :2] - place, axis=1).mean() for way in ways]
    assert min(off["one"]) < 0.012
    assert min(off["other"]) < 0.012
    assert np.argmin(off["one"]) != np.argmin(off["other"])
    np.testing.assert_allclose(ways[0][:, 2].max(), 2 * RADIUS, atol=0.006)


def test_what_is_not_thin_not_whole_or_touches_itself_is_left_to_other_costs():
    rng = np.random.default_rng(0)
    cloth = np.column_stack([rng.uniform(-0.15, 0.15, (900, 2)), np.zeros(900)])
    assert line_of(cloth) is None
    goal, _ = rope(900, 0.8, seed=0)
    assert line_of(np.concatenate([goal, goal + np.array([0, 0.3, 0])])) is None
    ring, _ = rope(900, 2 * np.pi + 0.3, seed=1)
    assert places_along(line_of(goal), ring, ring[:50]) is None
    assert places_along(None, goal, goal[:50]) is None
