"""Invariance of the canonical action and equivariance of the network, for any scene, stroke, turn and shift."""

import math
from dataclasses import replace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from piegraph_cli.dynamics.action import NEAR, canonical_action
from piegraph_cli.dynamics.egnn import EGNN, nearest_neighbors
from piegraph_cli.dynamics.stroke import Strokes

angles = st.floats(-math.pi, math.pi)
shifts = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


def scene(seed: int, batch: int = 2, particles: int = 20) -> tuple[torch.Tensor, Strokes]:
    generator = torch.Generator().manual_seed(seed)
    positions = torch.rand(batch, particles, 3, generator=generator, dtype=torch.float64) * 0.3
    ends = torch.rand(2, batch, 2, generator=generator, dtype=torch.float64) * 0.3
    return positions, Strokes.of(ends[0], ends[1], [0, 1])


def turn(angle: float, shift: tuple[float, float], positions: torch.Tensor, strokes: Strokes):
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)
    offset = torch.tensor(shift, dtype=torch.float64)
    moved = torch.cat([positions[..., :2] @ rotation.T + offset, positions[..., 2:]], -1)
    return moved, strokes.moved(rotation, offset)


def reflect(positions: torch.Tensor, strokes: Strokes):
    flip = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    return positions * flip, strokes.moved(flip[:2].diag())


def network(action_head: bool, mirror: bool = False) -> EGNN:
    torch.manual_seed(0)
    net = EGNN(neighbors=6, hidden=16, layers=3, action_head=action_head, mirror=mirror).double()
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return net.eval()


@given(st.integers(0, 100), angles, shifts, st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_canonical_action_does_not_change_with_the_frame(seed, angle, shift, mirror):
    positions, strokes = scene(seed)
    before = canonical_action(positions, strokes, mirror)
    after = canonical_action(*turn(angle, shift, positions, strokes), mirror)
    torch.testing.assert_close(after, before, atol=1e-9, rtol=1e-7)


def test_reflection_changes_the_sides_alone():
    positions, strokes = scene(4)
    features, sides = canonical_action(positions, strokes, mirror=True)
    reflected, other_sides = canonical_action(*reflect(positions, strokes), mirror=True)
    torch.testing.assert_close(reflected, features)
    torch.testing.assert_close(other_sides, -sides)
    assert (sides.abs() > 0.1).any()


def test_the_canonical_action_tells_where_the_stroke_began_and_its_mode():
    positions, strokes = scene(0)
    longer = replace(strokes, start=strokes.start - strokes.along)
    assert not torch.allclose(canonical_action(positions, strokes)[0], canonical_action(positions, longer)[0])
    other = replace(strokes, mode=1 - strokes.mode)
    assert not torch.allclose(canonical_action(positions, strokes)[0], canonical_action(positions, other)[0])


def test_the_canonical_action_is_the_papers():
    strokes = Strokes.of([[0.0, 0.0]], [[0.0, 2.0]], 0)
    features = canonical_action(torch.tensor([[[0.0, 3.0, 0.5], [1.0, 2.0, 0.0]]]), strokes)[0][0]
    torch.testing.assert_close(features[0, :5], torch.tensor([1.0, 0.0, 0.5, 2.0, 0.0]))
    torch.testing.assert_close(features[1, :5], torch.tensor([0.0, -1.0, 0.0, 2.0, 0.0]))
    near = torch.tensor([[1.0, 3.0, 0.0], [0.0, 2.0, -1.0]])
    torch.testing.assert_close(features[:, 5:8], (near / NEAR).tanh())
    torch.testing.assert_close(features[:, 8:], torch.stack([features[:, 1].abs(), features[:, 7].abs()], 1))


@given(st.integers(0, 100), angles, shifts, st.booleans(), st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_network_turns_and_moves_with_the_scene(seed, angle, shift, head, mirror):
    positions, strokes = scene(seed)
    net = network(head, mirror)
    with torch.no_grad():
        predicted, _ = turn(angle, shift, net(positions, strokes), strokes)
        turned = net(*turn(angle, shift, positions, strokes))
    torch.testing.assert_close(turned, predicted, atol=1e-8, rtol=1e-6)


@given(st.integers(0, 100), st.booleans())
@settings(max_examples=20, deadline=None)
def test_the_order_of_particles_does_not_matter(seed, head):
    positions, strokes = scene(seed)
    order = torch.randperm(positions.shape[1], generator=torch.Generator().manual_seed(seed))
    net = network(head)
    with torch.no_grad():
        torch.testing.assert_close(
            net(positions[:, order], strokes), net(positions, strokes)[:, order], atol=1e-9, rtol=1e-7
        )


@given(st.integers(0, 100), st.booleans())
@settings(max_examples=20, deadline=None)
def test_reflection_is_a_symmetry_where_it_shall_be(seed, head):
    positions, strokes = scene(seed)
    for mirror in (True, False):
        net = network(head, mirror)
        with torch.no_grad():
            expected, _ = reflect(net(positions, strokes), strokes)
            found = net(*reflect(positions, strokes))
        assert torch.allclose(found, expected, atol=1e-8) == mirror


def test_only_the_action_head_moves_a_straight_rope_sideways():
    rope = torch.zeros(1, 20, 3, dtype=torch.float64)
    rope[0, :, 0] = torch.linspace(0, 0.3, 20)
    stroke = Strokes.of([[0.15, -0.05]], [[0.15, 0.05]], 0).to(torch.float64)
    with torch.no_grad():
        without, with_head, mirrored = (
            network(*choice)(rope, stroke)[0, :, 1].abs().max() for choice in ((False,), (True,), (True, True))
        )
    assert without < 1e-12
    assert min(with_head, mirrored) > 1e-3


def test_the_batch_does_not_mix():
    positions, strokes = scene(1, batch=2)
    with torch.no_grad():
        both = network(True)(positions, strokes)
        alone = network(True)(positions[1:], strokes[1:])
    torch.testing.assert_close(both[1:], alone)


def test_neighbors_are_the_nearest_others():
    positions = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [7, 0, 0]]])
    assert nearest_neighbors(positions, 2)[0].tolist() == [[1, 2], [0, 2], [1, 0], [2, 1]]
    assert nearest_neighbors(positions, 12).shape == (1, 4, 3)
