"""Every setting of training and of every model reaches its network, its examples or its optimiser."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from piegraph_cli.dynamics.examples import Pairs, Sequences
from piegraph_cli.dynamics.models import MODELS, make_network
from piegraph_cli.dynamics.params import (
    BY_GRADIENT,
    LEARNED,
    EGNNParams,
    LearningParams,
    TrainParams,
    split_label,
    trained_label,
)
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.errors import UsageError

GRAPH = {"hidden": 8, "layers": 2, "neighbors": 4, "batch": 3, "steps": 20}
SMALL: dict[str, dict] = {
    "piegraph": GRAPH,
    "egnn-g": GRAPH,
    "gnn": GRAPH,
    "gnn-aug": GRAPH,
    "pgnd": {"batch": 2, "rollout": 1, "noise": 1e-3, "steps": 20},
    "gbnd": {"batch": 3, "hidden": 8, "rollout": 1, "neighbors": 3, "steps": 20},
}
OTHERS = {
    "learning_rate": 0.011,
    "weight_decay": 0.3,
    "clip": 1e-5,
    "batch": 4,
    "steps": 7,
    "neighbors": 2,
    "hidden": 12,
    "layers": 1,
    "shape_weight": 2.0,
    "radius": 0.03,
    "reach": 0.03,
    "rollout": 3,
    "history": 1,
    "noise": 0.01,
    "cell": 0.03,
    "gripper": 0.1,
    "pusher": 0.03,
    "step": 0.004,
    "edge_weight": 3.0,
}
"""Another value of each setting that is a number."""
SYMMETRIC = ("egnn-g", "mirror")
"""Has no action head, so its network knows no left and right: mirrored pairs teach it the same."""
HOLDING = ("pgnd", "gripper")
"""Is for picks alone. `cycles` says how long training goes on: see test_training.py."""
CASES = [
    (name, field)
    for name, of in BY_GRADIENT.items()
    for field in of.model_fields
    if (name, field) not in (SYMMETRIC, HOLDING)
    and field not in ("cycles", "prior")  # what it begins with: test_prior.py
]


def sequences() -> Sequences:
    """Three objects, a stroke each through their middle, in which what is ahead of the hand goes along."""
    rng, frames, particles = np.random.default_rng(0), 5, 12
    rest = np.concatenate([rng.uniform(-0.06, 0.06, (3, particles, 2)), np.full((3, particles, 1), 0.004)], -1)
    positions, hand = [], []
    for state in rest:
        along = np.append(rng.normal(size=2), 0)
        along /= np.linalg.norm(along)
        goes = ((state - state.mean(0)) @ along > -0.02)[:, None]
        positions += [state + 0.012 * k * along * goes for k in range(frames)]
        hand += [state.mean(0)[:2] + (0.012 * k - 0.02) * along[:2] for k in range(frames)]
    pairs = np.array([[frames * s + i, frames * s + j] for s in range(3) for i, j in ((0, 2), (0, 4), (2, 4))])
    return Sequences(
        positions=np.array(positions, np.float32),
        hand=np.array(hand, np.float32),
        strokes=np.array([[0, 4], [5, 9], [10, 14]]),
        mode=np.zeros(3, np.uint8),
        owner=np.arange(3),
        rest=rest.astype(np.float32),
        pairs=pairs,
        pair_stroke=np.repeat(np.arange(3), 3),
    )


DATA = sequences()


def trainer_of(
    name: str, params: LearningParams, seed: int = 0, validation: Sequences | None = None, data: Sequences = DATA
) -> Trainer:
    learner = MODELS[name].learner
    assert learner is not None
    held_out = learner.examples(validation, params, "cpu") if validation else None
    return Trainer(
        make_network(name, params, False, seed), learner.examples(data, params, "cpu"), held_out, params, seed
    )


def learned(name: str, data: Sequences = DATA, **settings) -> list[np.ndarray]:
    """The weights and the loss after a few steps."""
    trainer = trainer_of(name, LEARNED[name](**SMALL[name] | settings), data=data)
    for _ in range(4):
        trainer.step()
    loss = trainer.record()[1]
    return [*(value.numpy() for value in trainer.network.state_dict().values()), np.array(loss)]


@pytest.fixture(scope="module")
def as_they_are():
    found: dict[str, list[np.ndarray]] = {}
    return lambda name: found.setdefault(name, learned(name))


@pytest.mark.parametrize(("name", "field"), CASES)
def test_every_setting_changes_what_a_model_learns(name, field, as_they_are):
    before = SMALL[name].get(field, LEARNED[name].model_fields[field].default)
    changed = not before if isinstance(before, bool) else OTHERS[field]
    assert changed != before
    after = learned(name, **{field: changed})
    same = len(after) == len(as_they_are(name)) and all(map(np.array_equal, after, as_they_are(name)))
    assert not same


def test_what_a_hand_drags_along_matters_where_it_holds_alone(as_they_are):
    assert all(map(np.array_equal, learned("pgnd", gripper=0.1), as_they_are("pgnd")))
    picks = replace(DATA, mode=np.ones(3, np.uint8))
    assert not all(map(np.array_equal, learned("pgnd", picks, gripper=0.1), learned("pgnd", picks)))


def test_a_network_without_handedness_learns_the_same_from_mirrored_pairs(as_they_are):
    for mirrored, plain in zip(learned("egnn-g", mirror=True), as_they_are("egnn-g"), strict=True):
        np.testing.assert_allclose(mirrored, plain, atol=1e-5)


@pytest.mark.parametrize("name", BY_GRADIENT)
def test_the_same_settings_learn_the_same(name, as_they_are):
    assert all(map(np.array_equal, learned(name), as_they_are(name)))


def test_the_size_of_a_network_is_what_its_settings_say():
    def shapes(**settings) -> dict[str, tuple[int, ...]]:
        network = make_network("piegraph", EGNNParams(**settings), False, 0)
        return {name: tuple(value.shape) for name, value in network.named_parameters()}

    base = shapes(hidden=8, layers=3)
    assert base["embed.weight"] == (8, 10)
    assert len({name.split(".")[1] for name in base if name.startswith("layers.")}) == 3
    assert any(name.startswith("head.") for name in base)
    assert any(".pool." in name for name in base)
    assert not any(name.startswith("head.") for name in shapes(action_head=False))
    assert not any(".pool." in name for name in shapes(pool=False))
    assert make_network("piegraph", EGNNParams(mirror=False, neighbors=5), False, 0).neighbors == 5
    assert [make_network("piegraph", EGNNParams(mirror=m), False, 0).mirror for m in (False, True)] == [False, True]


def test_weights_and_batches_follow_the_seed():
    params = EGNNParams(**GRAPH)
    one, again, other = (make_network("piegraph", params, False, seed).embed.weight for seed in (0, 0, 1))
    assert torch.equal(one, again)
    assert not torch.equal(one, other)


def test_the_rate_falls_along_a_cosine_from_the_rate_given_to_nothing():
    params = EGNNParams(**GRAPH | {"learning_rate": 0.02, "steps": 4, "weight_decay": 0.25})
    trainer, rates = trainer_of("piegraph", params), []
    for _ in range(4):
        trainer.step()
        rates.append(trainer.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([0.02, 0.01 * (1 + math.sqrt(0.5)), 0.01, 0.01 * (1 - math.sqrt(0.5))])
    assert trainer.optimizer.param_groups[0]["weight_decay"] == 0.25
    assert isinstance(trainer.optimizer, torch.optim.AdamW)


class One(torch.nn.Module):
    """A network of one weight; its gradient is 3 whatever it is asked."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor(2.0))


class Asked:
    """Examples that note what is chosen of them, and whether they may be varied."""

    def __init__(self, count: int, losses: list[float] | None = None):
        self.count, self.chosen, self.varied, self.losses = count, [], [], list(losses or [])

    def __len__(self) -> int:
        return self.count

    def loss(self, network, chosen, rng=None):
        self.chosen.append(chosen.tolist())
        self.varied.append(rng is not None)
        return network.weight * 3 + (self.losses.pop(0) - 3 * network.weight.detach() if self.losses else 0)


def test_a_step_takes_a_batch_and_clips_its_gradient():
    examples = Asked(50)
    trainer = Trainer(One(), examples, None, LearningParams(batch=6, steps=10, clip=0.5), 0)
    trainer.step()
    trainer.step()
    assert [len(chosen) for chosen in examples.chosen] == [6, 6]
    assert examples.chosen[0] != examples.chosen[1]
    assert examples.varied == [True, True]
    assert trainer.network.weight.grad.item() == pytest.approx(0.5, rel=1e-4)
    free = Trainer(One(), Asked(50), None, LearningParams(batch=6, steps=10, clip=10.0), 0)
    free.step()
    assert free.network.weight.grad.item() == pytest.approx(3)
    again = Asked(50)
    Trainer(One(), again, None, LearningParams(batch=6, steps=10), 0).step()
    assert again.chosen[0] == examples.chosen[0]
    other = Asked(50)
    Trainer(One(), other, None, LearningParams(batch=6, steps=10), 1).step()
    assert other.chosen[0] != examples.chosen[0]


def test_a_record_has_the_mean_training_loss_and_the_loss_on_validation_examples():
    training, validation = Asked(50, [1.0, 2.0, 6.0]), Asked(70, [5.0, 1.0])
    trainer = Trainer(One(), training, validation, LearningParams(batch=2, steps=10), 0)
    for _ in range(3):
        trainer.step()
    step, train, held_out = trainer.record()
    assert (step, train) == (3, pytest.approx(3.0))
    assert held_out == pytest.approx((5.0 * 64 + 1.0 * 6) / 70), "every example counts once"
    assert [k for part in validation.chosen for k in part] == list(range(70))
    assert validation.varied == [False, False]
    training.losses = [4.0]
    trainer.step()
    assert trainer.record()[1] == pytest.approx(4.0), "since the last record"


def test_of_many_validation_examples_some_of_all_are_looked_at():
    validation = Asked(1000)
    trainer = Trainer(One(), Asked(5), validation, LearningParams(batch=2, steps=10), 0)
    trainer.record()
    chosen = [k for part in validation.chosen for k in part]
    assert (len(chosen), chosen[0], chosen[-1]) == (256, 0, 999)
    assert max(np.diff(chosen)) <= 4


def test_the_weights_kept_are_those_of_the_lowest_validation_loss():
    validation = Asked(3, [3.0, 1.0, 2.0, 1.0])
    trainer = Trainer(One(), Asked(5), validation, LearningParams(batch=2, steps=10, learning_rate=0.1), 0)
    kept, weights = [], []
    for _ in range(4):
        trainer.step()
        trainer.record()
        weights.append(trainer.network.weight.item())
        kept.append(trainer.best["weight"].item())
    assert kept == [weights[0], weights[1], weights[1], weights[1]]
    assert trainer.best_loss == 1.0


VARIANTS = {"piegraph:wide": {"hidden": 64, "clip": 0.5}, "pgnd:far": {"rollout": 9}}


def test_a_label_finds_the_settings_of_its_model_and_variant():
    params = TrainParams(**{"piegraph": {"hidden": 16, "steps": 30}, "gnn-aug": {"layers": 7}, "variants": VARIANTS})
    assert params.of("piegraph@20") == EGNNParams(hidden=16, steps=30)
    assert params.of("piegraph:wide@20") == EGNNParams(hidden=64, steps=30, clip=0.5)
    assert params.of("gnn-aug").layers == 7
    assert params.of("gnn").layers != 7
    assert (params.of("pgnd:far").rollout, params.of("pgnd").rollout) == (9, 10)
    with pytest.raises(UsageError, match="no variant gnn:wide"):
        params.of("gnn:wide")
    with pytest.raises(UsageError, match="hide"):
        TrainParams(variants={"gnn:a": {"hide": 3}}).of("gnn:a")
    assert set(LEARNED) == {name for name, model in MODELS.items() if model.learner}
    for name in LEARNED:
        assert params.of(name) == getattr(params, name.replace("-", "_"))


def test_labels_in_parts():
    assert split_label("pgnd:fine@20") == ("pgnd", "fine", 20)
    assert split_label("piegraph-ng") == ("piegraph-ng", "", None)
    assert [trained_label(label) for label in ("piegraph-ng:wide@20", "kabsch@3", "egnn-g", "static", "sms-no")] == [
        "piegraph:wide@20",
        "piegraph@3",
        "egnn-g",
        None,
        None,
    ]
    assert TrainParams(models="piegraph:prior@0").models == ("piegraph:prior@0",)
    assert TrainParams(models="kabsch@20,gnn").models == ("piegraph@20", "gnn")
    for wrong in ("static", "oracle", "gnn@0", "kabsch:x@00", "static@3", "gnn:@3"):
        with pytest.raises(ValidationError):
            TrainParams(models=wrong)


@pytest.mark.parametrize("name", BY_GRADIENT)
def test_the_loss_of_nothing_moving_is_zero_where_nothing_moves_and_that_of_a_network_at_rest_elsewhere(name):
    still = replace(DATA, positions=np.repeat(DATA.rest, 5, 0))
    params = LEARNED[name](**SMALL[name])
    assert trainer_of(name, params, data=still).static_loss() == pytest.approx(0, abs=1e-9)
    trainer = trainer_of(name, params)
    examples = trainer.examples
    every = torch.arange(len(examples))
    if isinstance(examples, Pairs):
        found = examples.loss(lambda start, *_: start, every)
    else:
        trainer.network.step = lambda past, *_: past[:, -1]
        found = examples.loss(trainer.network, every)
    assert trainer.static_loss() == pytest.approx(found.item(), rel=1e-5)
    assert trainer.static_loss() > 0.001
    validated = trainer_of(name, params, validation=still)
    assert validated.static_loss() == pytest.approx(0, abs=1e-9), "validation examples, where there are any"
