"""The stroke's type: rows for kernels and back, motions of the plane, the batch's axes, and what is refused."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from piegraph_cli.dynamics.stroke import MIN_STROKE, Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK, PUSH

angles = st.floats(-math.pi, math.pi)
places = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


def strokes(seed: int, *batch: int, axes: int = 2) -> Strokes:
    generator = torch.Generator().manual_seed(seed)
    start, end = torch.rand(2, *batch, axes, generator=generator, dtype=torch.float64)
    mode, held = torch.rand(batch, generator=generator) < 0.5, torch.rand((*batch, 2), generator=generator) < 0.5
    return Strokes.of(start, end, mode, held)


def rotation(angle: float) -> torch.Tensor:
    cosine, sine = math.cos(angle), math.sin(angle)
    return torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)


def same(one: Strokes, other: Strokes, **tolerance) -> None:
    for name in ("start", "end", "mode", "held"):
        torch.testing.assert_close(getattr(one, name), getattr(other, name), **tolerance)


@given(st.integers(0, 100), st.lists(st.integers(0, 3), max_size=3))
@settings(max_examples=30, deadline=None)
def test_rows_hold_every_field(seed, batch):
    some = strokes(seed, *batch)
    rows = some.packed()
    assert rows.shape == (*batch, 7)
    assert rows.dtype == torch.float64
    same(Strokes.of(rows[..., :2], rows[..., 2:4], rows[..., 4], rows[..., 5:]), some, atol=0, rtol=0)
    torch.testing.assert_close(some.to(torch.float32).packed(), rows.float(), atol=0, rtol=0)


@given(st.integers(0, 100), angles, places, st.booleans())
@settings(max_examples=30, deadline=None)
def test_motions_of_the_plane_keep_lengths_and_turn_headings(seed, angle, shift, mirror):
    some = strokes(seed, 5)
    motion = rotation(angle) @ torch.tensor([[1.0, 0.0], [0.0, -1.0 if mirror else 1.0]], dtype=torch.float64)
    offset = torch.tensor(shift, dtype=torch.float64)
    moved = some.moved(motion, offset)
    torch.testing.assert_close(moved.length, some.length)
    torch.testing.assert_close(moved.along, some.along @ motion.T)
    torch.testing.assert_close(moved.start, some.start @ motion.T + offset)
    same(moved.moved(motion.T, -offset @ motion), some, atol=1e-12, rtol=0)
    same(some.moved(motion.expand(5, 2, 2)), some.moved(motion), atol=1e-12, rtol=0)
    if not mirror:
        torch.testing.assert_close(moved.rotation, motion @ some.rotation)


def test_the_rotation_turns_x_to_the_heading():
    some = strokes(0, 4)
    x = torch.tensor([1.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(some.rotation @ x * some.length[:, None], some.along)
    torch.testing.assert_close(some.ends[:, 1] - some.ends[:, 0], some.along)


def test_the_axes_are_the_batchs():
    some = strokes(1, 7, 3)
    assert len(some) == 7
    for k, chunk in enumerate(some.split(3)):
        same(chunk, some[3 * k : 3 * k + 3])
    assert [len(chunk) for chunk in some.split(3)] == [3, 3, 1]
    assert strokes(1, 0).split(3) == []
    assert some[2, 1].mode.shape == ()
    same(Strokes.stack([some[k] for k in range(7)]), some)
    same(Strokes.stack([some[:, k] for k in range(3)], 1), some)
    same(some[some.mode == PICK][:1], some[tuple((some.mode == PICK).nonzero()[0])][None])


def test_heights_are_kept_and_seen_from_above_they_are_none():
    some = strokes(2, 4, axes=3)
    flat = Strokes(some.start[:, :2], some.end[:, :2], some.mode, some.held)
    same(some.planar, flat)
    assert flat.planar is flat
    torch.testing.assert_close(some.length, flat.length)
    torch.testing.assert_close(some.packed(), flat.packed())
    turned = some.moved(rotation(0.5))
    same(turned.planar, flat.moved(rotation(0.5)))
    torch.testing.assert_close(turned.end[:, 2], some.end[:, 2])


def test_an_action_is_one_stroke():
    action = Strokes.of([[0.0, 1.0], [2.0, 3.0]], [[4.0, 5.0], [6.0, 7.0]], [PUSH, PICK])[1].action()
    assert (action["start"].tolist(), action["end"].tolist(), action["mode"]) == ([2.0, 3.0], [6.0, 7.0], PICK)
    assert action["start"].dtype == float


def test_one_mode_may_stand_for_all_and_strokes_are_whole_by_default():
    some = Strokes.of([[0.0, 1.0], [2.0, 3.0]], [[4.0, 5.0], [6.0, 7.0]], PICK)
    assert some.mode.tolist() == [PICK, PICK]
    assert not some.held.any()
    assert some.held.shape == (2, 2)


@pytest.mark.parametrize(
    ("start", "end", "mode", "held"),
    [
        ([[0.0, 1.0]], [[0.0, 1.0], [2.0, 3.0]], 0, None),
        ([0.0], [1.0], 0, None),
        ([[0.0, 1.0]], [[2.0, 3.0]], [0, 1], None),
        ([[0.0, 1.0]], [[2.0, 3.0]], 0, [[True]]),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(start, end, mode, held):
    with pytest.raises(DataError, match="no strokes: start"):
        Strokes.of(start, end, mode, held)


def test_an_unknown_mode_is_refused():
    with pytest.raises(DataError, match="no mode 7"):
        Strokes.of([[0.0, 1.0]], [[2.0, 3.0]], [7])


@pytest.mark.parametrize("end", [[0.1, 0.2], [0.1, 0.2 + MIN_STROKE / 2], [float("nan"), 0.0], [0.0, float("inf")]])
def test_a_stroke_without_heading_is_refused(end):
    some = Strokes.of([[0.0, 0.0], [0.1, 0.2]], [[1.0, 1.0], end], PUSH)
    with pytest.raises(DataError, match="no heading") as caught:
        some.check()
    assert caught.value.where == "stroke 1"
    some[:1].check()
