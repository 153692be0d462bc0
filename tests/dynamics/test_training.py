"""Training: it learns, it repeats itself bit for bit, it goes on from stored arrays, and it chooses weights as it says."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.examples import Pairs
from piegraph_cli.dynamics.losses import dynamics_loss
from piegraph_cli.dynamics.models import make_network
from piegraph_cli.dynamics.params import EGNNParams
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.errors import DataError
from piegraph_cli.params import PUSH

PARAMS = EGNNParams(hidden=8, layers=2, steps=30)


def pairs(count: int = 40, seed: int = 0) -> Pairs:
    """Objects that are carried along by the whole stroke."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(0, 0.2, (count, 16, 3))
    begin = rng.uniform(0, 0.2, (count, 2))
    angle, length = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.03, 0.14, count)
    motion = np.stack([np.cos(angle), np.sin(angle)], 1) * length[:, None]
    end = start + np.pad(motion, ((0, 0), (0, 1)))[:, None]
    strokes = Strokes.of(begin, begin + motion, PUSH)
    return Pairs(start, end, strokes, start, np.arange(count), np.zeros(count), PARAMS.neighbors)


def trainer_of(examples: Pairs, validation: Pairs | None = None, params: EGNNParams = PARAMS, seed: int = 0) -> Trainer:
    return Trainer(make_network("piegraph", params, False, seed), examples, validation, params, seed)


def trained(steps: int, trainer: Trainer | None = None, seed: int = 0) -> Trainer:
    trainer = trainer or trainer_of(pairs(), pairs(seed=1), seed=seed)
    for _ in range(steps):
        trainer.step()
    return trainer


def test_it_learns():
    params = EGNNParams(hidden=16, layers=2, steps=300)
    trainer = trainer_of(pairs(), pairs(seed=1), params)
    first = trainer.record()[2]
    trained(300, trainer)
    assert trainer.record()[2] < 0.1 * first


def test_one_seed_one_result_and_another_seed_another():
    first, second = (trained(10).network.state_dict() for _ in range(2))
    other = trained(10, seed=1).network.state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert not all(torch.equal(first[name], other[name]) for name in first)


def test_stored_and_taken_up_again_it_ends_in_the_same_bits():
    whole = trained(20)
    whole.record()
    half = trained(12)
    resumed = trainer_of(pairs(), pairs(seed=1))
    resumed.load(half.state())
    trained(8, resumed).record()
    assert resumed.history == whole.history
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name])


def test_the_best_weights_on_validation_are_kept():
    trainer = trained(5)
    trainer.record()
    best = {name: value.clone() for name, value in trainer.best.items()}
    with torch.no_grad():
        trainer.network.head[-1].bias += 100.0
    trainer.record()
    assert all(torch.equal(trainer.best[name], best[name]) for name in best)


def test_without_validation_the_last_weights_are_kept():
    trainer = trainer_of(pairs())
    trained(3, trainer).record()
    trained(3, trainer).record()
    assert all(torch.equal(trainer.best[n], v) for n, v in trainer.network.state_dict().items())


def test_divergence_and_emptiness_are_errors():
    with pytest.raises(DataError, match="diverged"):
        broken = pairs()
        broken.end *= torch.nan
        trainer_of(broken).step()
    empty = pairs(1)
    empty.start = empty.start[:0]
    with pytest.raises(DataError, match="nothing to train on"):
        trainer_of(empty)


def test_the_loss_is_mean_square_plus_shape():
    target = torch.zeros(1, 3, 3)
    neighbors = torch.tensor([[[1], [0], [1]]])
    assert dynamics_loss(target + 0.1, target, neighbors, 0.5).item() == pytest.approx(3.0)
    moved = target.clone()
    moved[0, 0, 0] = 0.1
    assert dynamics_loss(moved, target, neighbors, 0.5).item() == pytest.approx((1 + 0.5 * 2) / 3)


def test_mirrored_training_predicts_mirrored_scenes():
    """Strokes of one handedness: only a network that saw their mirror images knows those."""
    rng = np.random.default_rng(5)
    start = rng.uniform(0, 0.2, (60, 16, 3))
    begin = rng.uniform(0, 0.2, (60, 2))
    angle = rng.uniform(-np.pi, np.pi, 60)
    motion = 0.1 * np.stack([np.cos(angle), np.sin(angle)], 1)
    left = np.stack([-motion[:, 1], motion[:, 0]], 1)
    beside = ((start[..., :2] - begin[:, None]) * left[:, None]).sum(-1, keepdims=True)
    end = start + np.pad(motion, ((0, 0), (0, 1)))[:, None] * (beside > 0)
    start[..., :2] += left[:, None] * 2.0  # all of it lies to the left
    end[..., :2] += left[:, None] * 2.0
    strokes = Strokes.of(begin, begin + motion, PUSH)
    flip = [1, -1, 1]
    flipped = strokes.moved(torch.tensor([[1.0, 0.0], [0.0, -1.0]], dtype=torch.float64))
    unseen = Pairs(start * flip, end * flip, flipped, start * flip, np.arange(60), np.zeros(60), PARAMS.neighbors)
    losses = {}
    for mirror in (False, True):
        seen = Pairs(start, end, strokes, start, np.arange(60), np.zeros(60), PARAMS.neighbors, mirror=mirror)
        trainer = trained(200, trainer_of(seen, params=EGNNParams(hidden=8, layers=2, steps=200, mirror=False)))
        with torch.no_grad():
            losses[mirror] = unseen.loss(trainer.network, torch.arange(60)).item()
    assert losses[True] < 0.7 * losses[False]


class Foreseen:
    """Examples whose validation losses are given: one for each record."""

    def __init__(self, losses: list[float]):
        self.losses = losses

    def __len__(self) -> int:
        return 1

    def loss(self, network, chosen, rng=None):
        zero = 0 * next(network.parameters()).sum()
        return zero if rng is not None else zero + self.losses.pop(0)


@pytest.mark.parametrize(
    ("losses", "cycles", "steps"),
    [
        ([1.0, 0.98, 0.5], 3, 8),  # the second cycle gained less than 3 %
        ([1.0, 0.9, 0.5], 3, 16),
        ([1.0, 0.9, 0.88, 0.1], 4, 16),  # the third one did
        ([1.0, 0.9, 0.8, 0.7], 4, 32),
        ([1.0, 1.5, 0.5], 3, 8),
        ([1.0, 0.5], 1, 4),
        ([math.nan, 0.5, 0.4], 3, 16),
        (None, 3, 4),  # nothing to validate on: one cycle
    ],
)
def test_another_cycle_as_long_as_all_before_begins_where_the_last_one_gained_3_percent(losses, cycles, steps):
    params = EGNNParams(hidden=8, layers=2, steps=4, cycles=cycles, learning_rate=1.0)
    examples = Foreseen([])
    validation = None if losses is None else Foreseen(losses)
    trainer, rates = Trainer(make_network("piegraph", params, False, 0), examples, validation, params, 0), []
    while not trainer.finished:
        trainer.step()
        rates.append(trainer.optimizer.param_groups[0]["lr"])
        if trainer.done == trainer.cycle[0]:
            trainer.record()
    assert trainer.done == steps
    starts = [k for k, rate in enumerate(rates) if rate == 1.0]
    assert starts == [k for k in (0, 4, 8, 16) if k < steps], "the rate starts anew with each cycle"
    assert all(b < a for k, (a, b) in enumerate(pairwise(rates), 1) if k not in starts)


def test_taken_up_again_in_a_later_cycle_it_stops_where_it_would_have():
    params = EGNNParams(hidden=8, layers=2, steps=4, cycles=4)
    whole = Trainer(make_network("piegraph", params, False, 0), pairs(), Foreseen([1.0, 0.9, 0.89]), params, 0)
    while whole.done < 10:
        whole.step()
        if whole.done == whole.cycle[0]:
            whole.record()
    again = Trainer(make_network("piegraph", params, False, 0), pairs(), Foreseen([0.89]), params, 0)
    again.load({name: value.copy() for name, value in whole.state().items()})  # as a file would keep it
    for trainer in (whole, again):
        while not trainer.finished:
            trainer.step()
            if trainer.done == trainer.cycle[0]:
                trainer.record()
    assert (whole.done, again.done) == (16, 16)
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, again.network.state_dict()[name])
