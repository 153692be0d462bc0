"""Outlines of particles that lie evenly, and what strokes find of an outline that the particles do not show."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.outline import covered_outline, outline_of
from piegraph_cli.dynamics.params import RigidParams
from piegraph_cli.dynamics.rigid_body import RigidBody
from piegraph_cli.dynamics.rigid_contour import Contour, apart
from piegraph_cli.dynamics.rigid_kernel import push
from piegraph_cli.errors import DataError
from tests.dynamics.test_rigid_body import EDGES, SQUARE, pushed, shape, turned

SPACING = 0.02


def square(step: float = SPACING) -> np.ndarray:
    """Particles [N, 2] of a square of 10 cm, on a lattice, its corners among them."""
    side = np.arange(-0.05, 0.0501, step)
    return np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)


def test_the_outline_of_a_square_has_no_notch_where_a_particle_lies_a_little_inside_of_its_side():
    points = square()
    points[np.linalg.norm(points - [0.05, 0.01], axis=1) < 1e-6, 0] -= 0.006
    depth = [np.abs(edges).reshape(-1, 2).max(1).min() for edges in (covered_outline(points), outline_of(points, 1.8))]
    assert depth == pytest.approx([0.05, 0.044])


def test_a_notch_that_is_wider_than_particles_lie_apart_stays_and_a_hole_does_not():
    body = shape()[:, :2]
    edges = covered_outline(body)
    assert apart(edges[None], np.array([[0.09, 0.09]]))[0, 0] > 0.02, "the L is open there"
    pierced = square()[np.linalg.norm(square() - 0.01, axis=1) > 0.021]
    assert len(pierced) < len(square())
    assert np.abs(covered_outline(pierced)).reshape(-1, 2).max(1).min() == pytest.approx(0.05)


def test_points_on_a_line_are_covered_by_nothing():
    with pytest.raises(DataError, match="span no area"):
        covered_outline(np.column_stack([np.arange(9.0), np.zeros(9)]))


def test_distances_are_signed_and_normals_point_outwards():
    edges = EDGES.double().numpy()
    points = np.array([[0.07, 0.0], [0.0, 0.0], [0.05, 0.049], [0.08, 0.09]])
    np.testing.assert_allclose(apart(edges[None], points)[0], [0.02, -0.05, 0.0, 0.05], atol=1e-7)
    contour = Contour(edges, SPACING)
    assert ((contour.corners * contour.normals).sum(1) > 0).all()
    np.testing.assert_allclose(apart(contour.edges(np.zeros((1, len(contour.modes)))), points)[0, 0], 0.02, atol=1e-7)
    assert np.square(contour.modes).sum(0) == pytest.approx((0.2 * SPACING) ** 2, rel=0.05), "as wide everywhere"


def test_candidates_have_the_outline_of_their_set():
    small = EDGES / 2
    poses, numbers = torch.zeros(4, 3), torch.tensor([[0.3, 0.04, 0.01, 0, 0]]).repeat(4, 1)
    strokes = torch.tensor([[-0.1, 0, 0.0, 0], [-0.1, 0.02, 0.0, 0.02]]).repeat(2, 1)
    both = push(torch.stack([EDGES, small]), poses, strokes, numbers)
    assert torch.equal(both[:2], push(EDGES, poses[:2], strokes[:2], numbers[:2]))
    assert torch.equal(both[2:], push(small, poses[2:], strokes[2:], numbers[2:]))


def bulged(count: int, seed: int = 0):
    """Strokes of a square whose side at x > 0 is 6 mm further out in its middle than its particles have it, and the truth."""
    rng, body = np.random.default_rng(seed), np.column_stack([square(), np.full(len(square()), 0.01)])
    corners = np.insert(SQUARE, 2, [[0.056, -0.01], [0.056, 0.01]], axis=0)
    edges = torch.as_tensor(np.hstack([corners, np.roll(corners, -1, 0)]), dtype=torch.float32)
    heading = rng.uniform(-np.pi, np.pi, count)
    along = np.column_stack([np.cos(heading), np.sin(heading)])
    aim = rng.uniform(-0.03, 0.03, (count, 2))
    start, end = aim - 0.15 * along, aim - 0.02 * along
    arrays = (np.zeros((count, 3)), np.hstack([start, end]), np.tile([0.3, 0.032, 0.01, 0, 0], (count, 1)))
    moved = push(edges, *(torch.as_tensor(a, dtype=torch.float32) for a in arrays)).numpy()
    ends = np.array([turned(body, *pose) for pose in moved])
    positions = np.stack([np.broadcast_to(body, ends.shape), ends], 1).reshape(2 * count, -1, 3).astype(np.float32)
    data = pushed([0.3, 0.032, 0.01, 0.0, 0.0], count)
    hand = np.stack([start, end], 1).reshape(-1, 2).astype(np.float32)
    return type(data)(
        positions, hand, data.strokes, data.mode, data.owner, positions[::2], data.pairs, data.pair_stroke
    )


def test_strokes_find_where_the_outline_lies_beyond_the_particles():
    """On the side that bulges and on no other."""
    plain, body = RigidBody(RigidParams(refine=False)), RigidBody(RigidParams())
    data, other = bulged(40), bulged(60, seed=1)
    plain.fit(data)
    body.fit(data)
    sides = np.array([[0.05, 0.0], [-0.05, 0.0], [0.0, 0.05], [0.0, -0.05]])
    deep = apart(body.edges.double().numpy()[None], sides)[0] - body.numbers[2].item() + 0.01
    assert deep[0] < -0.003
    assert np.abs(deep[1:]).max() < 0.0025
    errors = [float(one._errors(one.numbers[None], *one.scene(other)).mean()) for one in (plain, body)]
    assert errors[1] < 0.7 * errors[0]


def test_a_refined_outline_comes_back_with_its_others():
    data = bulged(8)
    body, other = RigidBody(RigidParams()), RigidBody(RigidParams())
    body.fit(data)
    other.load_state_dict(body.state_dict())
    assert body.other_edges.shape == (4, *body.edges.shape)
    assert torch.equal(other.other_edges, body.other_edges)
    strokes, at = data.whole(), torch.as_tensor(data.rest)
    frame = np.zeros(3)
    assert torch.equal(body.spread(at, strokes, at[0], frame), other.spread(at, strokes, at[0], frame))
