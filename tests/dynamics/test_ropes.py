"""Ropes of priors: how they are drawn and move, how springs are fitted to a recording, and what is told no rope."""

from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli.dynamics import own_rope as own_rope_module
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.family import ropes
from piegraph_cli.dynamics.own import is_chain
from piegraph_cli.dynamics.own_rope import ROWS, own_rope, rope_fit
from piegraph_cli.dynamics.spring_fit import numbers_of, springs_of
from piegraph_cli.dynamics.tuning import KINDS, family_of, unseen
from piegraph_cli.errors import DataError
from tests.dynamics.test_prior import NUMBERS as BLOCK
from tests.dynamics.test_prior import bent
from tests.dynamics.test_rigid_body import pushed

PARTICLES, LENGTH = 15, 0.3
TRUE = np.array([[0.3, 0.4, 0.5, 0.0, 0.3, -0.3]])
"""A candidate of the fit: springs as in the middle of the family."""
NUMBERS = numbers_of(TRUE)[0, :5]


def straight(particles: int = PARTICLES) -> np.ndarray:
    x = np.linspace(-LENGTH / 2, LENGTH / 2, particles)
    return np.column_stack([x, np.zeros_like(x), np.full_like(x, 0.01)])


def recorded(numbers: np.ndarray, span: float, count: int, seed: int = 0) -> Sequences:
    """Strokes of two frames of a rope with these numbers [5], each the second one after it lay straight."""
    rest = straight()[None]
    rows = np.repeat(numbers[None], count, 0)
    rng = np.random.default_rng(seed)
    drawn = ropes.simulated(rng, springs_of(rest[0], span), span, rows, rest.repeat(count, 0), 2)
    positions = np.stack([s for d in drawn for s in (d.before[1], d.after[1])]).astype(np.float32)
    hand = np.stack([p for d in drawn for p in (d.start[1], d.end[1])]).astype(np.float32)
    none = np.zeros((0, 2), np.int64)
    strokes, owner = np.arange(2 * count).reshape(-1, 2), np.zeros(count, int)
    return Sequences(positions, hand, strokes, owner.astype(np.uint8), owner, rest, none, none[:, 0])


def far_of(particles: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Least distance (m) between particles [N, 3] and a stroke."""
    way = start + (end - start) * np.linspace(0, 1, 100)[:, None]
    return float(np.linalg.norm(particles[:, None, :2] - way, axis=-1).min())


def test_ropes_are_pushed_as_long_as_they_are_and_what_is_missed_lies_still():
    drawn = ropes.draw_ropes(np.random.default_rng(1), 20)
    assert len(drawn) * ropes.ROWS == 1024
    moved = np.array([np.linalg.norm(d.after[0] - d.before[0], axis=-1).max() for d in drawn])
    apart = np.array([far_of(d.before[0], d.start[0], d.end[0]) for d in drawn])
    assert (apart > 0.06).any()
    assert moved[apart > 0.06].max() < 1e-6  # farther than any pusher reaches
    assert (moved > 0.01).mean() > 0.5
    length, after = (
        np.array([np.linalg.norm(np.diff(s, axis=-2), axis=-1).sum(-1).max() for s in states])
        for states in ([d.rest for d in drawn], [d.after for d in drawn])
    )
    even = after / length < 1.5
    assert even.mean() > 0.95
    traits = np.array([d.traits for d in drawn])
    assert np.abs(traits.mean(0)).max() < 0.7
    assert traits.std(0).min() > 0.5


def test_a_rope_with_longer_springs_bends_less():
    numbers, rest = NUMBERS[None], straight()
    start, end = np.array([[0.0, -0.03]]), np.array([[0.0, 0.08]])

    def deep(span: float) -> float:
        moved = ropes.pushed(springs_of(rest, span), numbers, rest[None], start, end)[0, :, 1]
        return float(np.ptp(moved))

    assert deep(1.0) < 0.5 * deep(0.2)


def test_springs_are_found_again_from_the_strokes_of_a_rope():
    data, others = (recorded(NUMBERS, 0.215, 10, seed) for seed in (0, 1))
    fit = rope_fit(data)
    assert fit.error < 0.003
    graph = springs_of(others.rest[0], fit.span)
    rows = np.repeat(fit.numbers[None, :5], 10, 0)
    found = ropes.pushed(graph, rows, others.positions[::2], others.hand[::2], others.hand[1::2])
    error = np.linalg.norm(found - others.positions[1::2], axis=-1).mean()
    static = np.linalg.norm(others.positions[::2] - others.positions[1::2], axis=-1).mean()
    assert error < 0.15 * static


def test_a_fit_at_a_bound_and_one_that_is_none_are_told(monkeypatch):
    monkeypatch.setattr(own_rope_module, "SIMULATED", 60)
    data = recorded(np.array([0.3, 4.2, 2.5e-5, 0.055, 0.4]), 0.215, 6)
    assert "ends at a bound: reach of the pusher" in own_rope(data, 6, 0).doubts[0]
    wrong = data.positions.copy()
    wrong[1::2] = wrong[1::2, :, [1, 0, 2]] - [0.2, 0, 0]
    with pytest.raises(DataError, match="no rope that was pushed fits"):
        rope_fit(replace(data, positions=wrong))


def test_simulated_strokes_begin_where_the_recording_has_the_rope(monkeypatch):
    monkeypatch.setattr(own_rope_module, "SIMULATED", 600)
    data = recorded(NUMBERS, 0.215, 2)
    own = own_rope(data, 6, 0)
    starts = own.chunk.before[::ROWS].numpy()
    near = np.abs(starts[:, None] - data.positions[None]).max((2, 3)).min(1)
    assert near.max() < 1e-6
    assert own.traits.abs().max() <= 2
    none = own_rope(unseen(data), 6, 0)
    assert none.traits.abs().max() == 0
    assert len(none.chunk) > 500


def test_the_recording_tells_which_family_it_is_for():
    block, rope = pushed(BLOCK, 6), recorded(NUMBERS, 0.215, 4)
    assert family_of(block) == "blocks"
    assert family_of(unseen(block)) == "blocks"
    assert family_of(rope) == "ropes"
    assert family_of(unseen(rope)) == "ropes"
    with pytest.raises(DataError, match="this bends; the prior is for blocks; particles do not lie along a line"):
        family_of(bent(block, 0.05))
    with pytest.raises(DataError, match="hold the object"):
        family_of(replace(rope, mode=np.ones_like(rope.mode)))
    with pytest.raises(DataError, match="the prior is for ropes"):
        KINDS["ropes"].check(block)


def test_a_line_is_told_from_an_area_however_it_is_bent_and_thick():
    rng = np.random.default_rng(0)
    turn = np.linspace(0, 4.5, 40)
    arc = np.column_stack([0.12 * np.cos(turn), 0.12 * np.sin(turn), 0 * turn])
    thick = arc + rng.uniform(-0.006, 0.006, arc.shape)
    for chain in (straight(50), arc, thick):
        assert is_chain(chain)
    square = np.column_stack([rng.uniform(-0.1, 0.1, (50, 2)), np.zeros(50)])
    ruler = square * [1.5, 0.3, 1]
    for area in (square, ruler, pushed(BLOCK, 1).rest[0]):
        assert not is_chain(area)
