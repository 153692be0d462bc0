"""Random blocks: rigid, pushed clear of the pusher, the same for one seed, of all outlines."""

import numpy as np
import pytest

from piegraph_cli.dynamics.family.blocks import REACH, STRIDE, draw_block
from piegraph_cli.dynamics.family.outlines import KINDS, filled, inside, random_outline
from piegraph_cli.dynamics.rigid_body import planar_residuals

BLOCKS = [draw_block(np.random.default_rng(seed), 20 + seed, 12) for seed in range(25)]


@pytest.mark.parametrize("block", BLOCKS[::4])
def test_a_block_moves_rigidly_and_stays_on_the_table(block):
    assert planar_residuals(block.before[..., :2], block.after[..., :2]).max() < 1e-5
    assert np.array_equal(block.before[..., 2], block.after[..., 2])
    assert (block.before == block.rest).all()


def test_no_particle_ends_inside_the_pusher():
    for block in BLOCKS:
        radius = REACH[0] * np.exp(REACH[1] * block.traits[2])
        for points, at in ((block.before, block.start), (block.after, block.end)):
            apart = np.linalg.norm(points[..., :2] - at[:, None], axis=-1).min(1)
            assert (apart > radius - 2 * STRIDE).all()


def test_strokes_move_blocks_and_some_miss():
    moved = np.concatenate([np.linalg.norm(b.after - b.before, axis=-1).mean(1) for b in BLOCKS])
    assert 0 < (moved < 1e-6).mean() < 0.3
    assert np.median(moved) > 0.003


def test_one_seed_one_block_and_another_seed_another():
    first, second, other = (draw_block(np.random.default_rng(seed), 20, 4) for seed in (3, 3, 4))
    assert all(np.array_equal(getattr(first, name), getattr(second, name)) for name in vars(first))
    assert not np.array_equal(first.after, other.after)


@pytest.mark.parametrize("kind", KINDS)
def test_outlines_hold_their_points(kind, monkeypatch):
    monkeypatch.setattr("piegraph_cli.dynamics.family.outlines.KINDS", {kind: KINDS[kind]})
    rng = np.random.default_rng(0)
    for _ in range(5):
        corners = random_outline(rng)
        points = filled(rng, corners, 50)
        assert inside(corners, points).all()
        assert not inside(corners, points + 10).any()
        size = np.sqrt(abs(np.linalg.det(np.stack([corners, np.roll(corners, -1, 0)], 1)).sum()) / 2)
        assert 0.049 < size < 0.201
