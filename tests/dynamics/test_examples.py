"""What models learn from, worked out by hand: pairs and windows of frames, strokes and picks, and what varies them."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.examples import Pairs, Sequences, Windows, planar_motions
from piegraph_cli.dynamics.losses import dynamics_loss
from piegraph_cli.errors import DataError
from tests import strokes as of_strokes

PUSH, PICK = 0, 1
PARTICLES = 7


def sequences(modes=(PICK, PUSH)) -> Sequences:
    """Two objects, a stroke each: frames 0-4 at 1 cm a frame, frames 6-9 at 2 cm a frame; between them the hand is far."""
    rng = np.random.default_rng(0)
    rest = np.concatenate([rng.uniform(-0.1, 0.1, (2, PARTICLES, 2)), rng.uniform(0, 0.02, (2, PARTICLES, 1))], -1)
    first = [rest[0] + [0.01 * k, 0, 0] for k in range(5)]
    second = [rest[1] + [0, 0.02 * k, 0] for k in range(4)]
    grip = [rest[0, 3, :2] + [0.01 * k, 0.001] for k in range(5)]
    push = [rest[1, 5, :2] + [0, 0.02 * k - 0.002] for k in range(4)]
    return Sequences(
        positions=np.array([*first, rest[0] + 9, *second], np.float32),
        hand=np.array([*grip, [9, 9], *push], np.float32),
        strokes=np.array([[0, 4], [6, 9]]),
        mode=np.array(modes, np.uint8),
        owner=np.array([0, 1]),
        rest=rest.astype(np.float32),
        pairs=np.array([[0, 4], [1, 3], [0, 2], [2, 4], [6, 9], [7, 9]]),
        pair_stroke=np.array([0, 0, 0, 0, 1, 1]),
    )


class Listener(torch.nn.Module):
    """A network that notes what it is asked, and predicts that nothing moves."""

    def forward(self, *given):
        self.given = given
        return given[0]

    def loss(self, window):
        self.given = window
        return window.past.sum()


def test_sequences_know_their_pace_their_picks_and_what_the_hand_was_at():
    data = sequences()
    assert data.pace == pytest.approx(0.01)
    assert sequences().picks
    assert not sequences((PUSH, PUSH)).picks
    assert data.grasped().tolist() == [3, 5]
    whole = of_strokes.as_numbers(data.whole())
    np.testing.assert_allclose(whole[:, :4], np.concatenate([data.hand[[0, 6]], data.hand[[4, 9]]], 1), atol=1e-6)
    assert whole[:, 4:].tolist() == [[PICK, 0, 0], [PUSH, 0, 0]]


def test_a_hand_that_waits_does_not_slow_the_pace():
    data = sequences()
    data.hand[7:9] = data.hand[6]
    assert data.pace == pytest.approx(0.01)


def test_every_pair_is_there_with_its_stroke_its_object_and_its_grasp():
    data = sequences()
    pairs = Pairs.of(data, 4)
    assert len(pairs) == 6
    first, last = data.pairs.T
    np.testing.assert_array_equal(pairs.start, data.positions[first])
    np.testing.assert_array_equal(pairs.end, data.positions[last])
    np.testing.assert_array_equal(of_strokes.start(pairs.strokes), data.hand[first])
    np.testing.assert_array_equal(of_strokes.end(pairs.strokes), data.hand[last])
    assert of_strokes.mode(pairs.strokes).tolist() == [1, 1, 1, 1, 0, 0]
    assert pairs.owner.tolist() == [0, 0, 0, 0, 1, 1]
    assert pairs.grasp.tolist() == [3, 3, 3, 3, 5, 5], "of the stroke's start, not the pair's"
    np.testing.assert_array_equal(pairs.rest.positions, data.rest)
    assert pairs.rest.neighbors.shape == (2, PARTICLES, 4)
    assert pairs.picks
    assert not Pairs.of(sequences((PUSH, PUSH)), 4).picks


def test_a_pick_holds_the_object_at_ends_that_are_not_its_strokes():
    """Grasped before a pair that begins later than its stroke, not let go before one that ends earlier."""
    held = of_strokes.held(Pairs.of(sequences((PICK, PICK)), 4).strokes)
    assert held.tolist() == [[0, 0], [1, 1], [0, 1], [1, 0], [0, 0], [1, 0]]


def test_the_network_is_asked_about_the_chosen_pairs_with_their_own_rest_and_grasp():
    data, network = sequences(), Listener()
    pairs = Pairs.of(data, 4, shape_weight=0.3)
    chosen = torch.tensor([4, 1])
    loss = pairs.loss(network, chosen)
    start, strokes, rest, grasp = network.given
    np.testing.assert_array_equal(start, data.positions[[6, 1]])
    assert torch.equal(of_strokes.as_numbers(strokes), of_strokes.as_numbers(pairs.strokes)[chosen])
    np.testing.assert_array_equal(rest.positions, data.rest[[1, 0]])
    assert torch.equal(rest.neighbors, pairs.rest.neighbors[torch.tensor([1, 0])])
    assert grasp.tolist() == [5, 3]
    expected = dynamics_loss(start, pairs.end[chosen], rest.neighbors, 0.3)
    assert float(loss) == pytest.approx(float(expected))
    assert float(loss) == pytest.approx((0.6**2 + 0.2**2) / 2, rel=1e-4), "in dm2; nothing changes shape"


@pytest.mark.parametrize(("mirror", "turn"), [(False, False), (True, False), (False, True), (True, True)])
def test_pairs_are_moved_as_a_whole_where_they_are_varied(mirror, turn):
    network = Listener()
    pairs = Pairs.of(sequences(), 4, mirror=mirror, turn=turn)
    chosen = torch.arange(6).repeat(8)
    pairs.loss(network, chosen, np.random.default_rng(0))
    start, strokes, rest, grasp = network.given
    motions = planar_motions(np.random.default_rng(0), 48, mirror, turn).float()
    signs = torch.linalg.det(motions)
    assert set(signs.round().tolist()) == ({-1, 1} if mirror else {1})
    assert (torch.unique(motions[:, 0, 0].round(decimals=3)).numel() > 30) == turn

    def moved(points):
        flat = torch.einsum("bij,b...j->b...i", motions, points[..., :2])
        return torch.cat([flat, points[..., 2:]], -1)

    torch.testing.assert_close(start, moved(pairs.start[chosen]))
    torch.testing.assert_close(rest.positions, moved(pairs.rest.positions[pairs.owner[chosen]]))
    before, after = of_strokes.as_numbers(pairs.strokes)[chosen], of_strokes.as_numbers(strokes)
    torch.testing.assert_close(after[:, :2], moved(before[:, :2]))
    torch.testing.assert_close(after[:, 2:4], moved(before[:, 2:4]))
    assert torch.equal(after[:, 4:], before[:, 4:])
    assert torch.equal(grasp, pairs.grasp[chosen])
    pairs.loss(network, chosen)
    assert torch.equal(network.given[0], pairs.start[chosen]), "validation is never varied"


def test_windows_hold_what_was_what_will_be_and_where_the_hand_goes():
    data, network = sequences(), Listener()
    windows = Windows(data, history=2, rollout=2)
    assert len(windows) == 4 + 3
    loss = windows.loss(network, torch.tensor([0, 3, 5]))
    window = network.given
    assert float(loss) == float(window.past.sum()) != 0, "the network's own"
    np.testing.assert_array_equal(window.past, data.positions[[[0, 0, 0], [1, 2, 3], [6, 6, 7]]])
    np.testing.assert_array_equal(window.future, data.positions[[[1, 2], [4, 4], [8, 9]]])
    np.testing.assert_array_equal(window.hand, data.hand[[[0, 1, 2], [3, 4, 4], [7, 8, 9]]])
    assert window.valid.tolist() == [[True, True], [True, False], [True, True]]
    assert window.mode.tolist() == [PICK, PICK, PUSH]
    assert window.grasp.tolist() == [3, 3, 5]
    none = sequences()
    with pytest.raises(DataError, match="no strokes"):
        Windows(Sequences(**{**vars(none), "strokes": none.strokes[:0]}), 2, 2)


def test_noise_is_on_the_past_alone_and_turns_are_of_the_whole_window():
    data, network = sequences(), Listener()
    chosen = torch.arange(7).repeat(20)
    quiet = Windows(data, 2, 2)
    quiet.loss(network, chosen, np.random.default_rng(0))
    plain = network.given
    Windows(data, 2, 2, noise=0.004).loss(network, chosen, np.random.default_rng(0))
    noisy = network.given
    assert float((noisy.past - plain.past).std()) == pytest.approx(0.004, rel=0.05)
    assert torch.equal(noisy.future, plain.future)
    assert torch.equal(noisy.hand, plain.hand)
    Windows(data, 2, 2, turn=True).loss(network, chosen, np.random.default_rng(0))
    turned = network.given
    spans = [w.past[:, 0, 0, :2] - w.hand[:, 0] for w in (plain, turned)]
    assert float((spans[0] - spans[1]).norm(dim=1).max()) > 0.01
    torch.testing.assert_close(spans[0].norm(dim=1), spans[1].norm(dim=1), atol=1e-5, rtol=1e-4)
    ahead = [(w.future[:, 1, 0, :2] - w.hand[:, 2]).norm(dim=1) for w in (plain, turned)]
    torch.testing.assert_close(*ahead, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(turned.past[..., 2], plain.past[..., 2])
    assert torch.equal(turned.valid, plain.valid)
