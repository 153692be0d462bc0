"""Which sequences are learned from, chosen by, and measured on: apart from each other, and each where it belongs."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import MODELS
from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.dynamics.splits import TEST, TRAIN, VALIDATION, split_sequences
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.stages.learning import read_model, read_sequences
from tests.stages.chain import FRAMES, PACE, artifact, make_dataset, make_metrics, make_model, tracks

TINY = {"hidden": 4, "layers": 1, "steps": 6, "batch": 4, "neighbors": 4}


@pytest.fixture(scope="module")
def data():
    return make_dataset()


def names_of(data, split: int) -> set[str]:
    return {
        name for name, part in zip(data.texts("sequence_name"), data["sequence_split"], strict=True) if part == split
    }


def loss_on(data, model, split: int) -> float:
    """The loss of the model's weights on all pairs of one split."""
    trained = read_model(model)
    learner = MODELS[model.params["label"].partition("@")[0]].learner
    assert learner is not None
    examples = learner.examples(read_sequences(data, split), trained.settings, "cpu")
    with torch.no_grad():
        return float(examples.loss(trained.network, torch.arange(len(examples))))


@pytest.mark.parametrize("seed", range(4))
def test_a_split_has_the_numbers_asked_for_and_leaves_empty_sequences_to_the_test(seed):
    names = [f"s{k}" for k in range(9)]
    split = split_sequences(names, DatasetParams(train=4, validation=2, seed=seed), {"s0", "s5"})
    assert [(split == part).sum() for part in (TRAIN, VALIDATION, TEST)] == [4, 2, 3]
    assert split[0] == split[5] == TEST


def test_the_split_follows_its_seed_and_needs_something_to_test_on():
    names = [f"s{k}" for k in range(30)]
    one, again, other = (split_sequences(names, DatasetParams(seed=s), set()) for s in (0, 0, 1))
    assert one.tolist() == again.tolist() != other.tolist()
    with pytest.raises(DataError, match="none is left to test on"):
        split_sequences(names[:10], DatasetParams(train=8, validation=2), set())
    assert (split_sequences(names[:11], DatasetParams(train=8, validation=2), set()) == TEST).sum() == 1
    with pytest.raises(DataError, match="9 sequences with strokes"):
        split_sequences(names[:11], DatasetParams(train=8, validation=1), {"s1", "s2"})


def test_a_dataset_has_every_stroke_and_pair_of_its_sequences():
    data = make_dataset(5, strokes=3, train=3, validation=1)
    length = 3 * (FRAMES + 1)
    assert data["sequence_start"].tolist() == [k * length for k in range(5)]
    assert data["strokes"][:4].tolist() == [[0, 5], [7, 12], [14, 19], [21, 26]]
    assert data["stroke_sequence"].tolist() == np.repeat(np.arange(5), 3).tolist()
    np.testing.assert_array_equal(data["positions"][length:][:length], tracks(1, 3)["positions"])
    gaps = np.diff(data["pairs"], axis=1)[:, 0]
    assert (gaps.min(), gaps.max()) == (2, 5)
    assert len(gaps) == 15 * (4 + 3 + 2 + 1)
    own = data["strokes"][data["pair_stroke"]]
    assert ((data["pairs"][:, 0] >= own[:, 0]) & (data["pairs"][:, 1] <= own[:, 1])).all()
    assert not data["stroke_mode"].any()
    assert make_dataset(5, train=3, validation=1, pick=True)["stroke_mode"].all()


@pytest.mark.parametrize(("setting", "value"), [("train", 3), ("validation", 1), ("min_gap", 4), ("seed", 3)])
def test_every_setting_of_a_dataset_changes_it(setting, value):
    one, other = make_dataset(), make_dataset(**{setting: value})
    same = (
        one["pairs"].tolist() == other["pairs"].tolist(),
        one["sequence_split"].tolist() == other["sequence_split"].tolist(),
    )
    assert same == ((False, True) if setting == "min_gap" else (True, False))


def test_strokes_too_short_are_no_strokes():
    assert len(make_dataset(min_stroke=0.049)["strokes"]) == 16
    assert make_dataset(min_stroke=0.051)["stroke_sequence"].tolist() == np.repeat(np.arange(1, 8), 2).tolist()
    with pytest.raises(DataError, match="no stroke was found"):
        make_dataset(min_stroke=0.1)


def test_the_parts_of_a_dataset_share_no_sequence_no_stroke_and_no_pair(data):
    parts = [read_sequences(data, split) for split in (TRAIN, VALIDATION, TEST)]
    assert [len(part.rest) for part in parts] == [4, 2, 2]
    for name in ("strokes", "pairs"):
        rows = [set(map(tuple, getattr(part, name).tolist())) for part in parts]
        assert len(set.union(*rows)) == sum(map(len, rows)) == len(data[name])
    for part, split in zip(parts, (TRAIN, VALIDATION, TEST), strict=True):
        sequences = np.flatnonzero(data["sequence_split"] == split)
        np.testing.assert_array_equal(part.rest, data["positions"][data["sequence_start"][sequences]])
        assert part.owner.tolist() == np.repeat(np.arange(len(sequences)), 2).tolist()
        own = part.strokes[part.pair_stroke]
        assert ((part.pairs[:, 0] >= own[:, 0]) & (part.pairs[:, 1] <= own[:, 1])).all()


def test_a_number_of_sequences_is_chosen_of_the_training_ones_by_the_seed(data):
    training = set(map(tuple, read_sequences(data, TRAIN).strokes.tolist()))
    chosen = {seed: read_sequences(data, TRAIN, 2, seed) for seed in range(6)}
    for some in chosen.values():
        assert set(map(tuple, some.strokes.tolist())) < training
        assert len(some.rest) == 2
        np.testing.assert_array_equal(some.rest[some.owner], some.positions[some.strokes[:, 0] // 14 * 14])
    assert len({some.strokes.tobytes() for some in chosen.values()}) > 2
    assert read_sequences(data, TRAIN, 2, 3).strokes.tolist() == chosen[3].strokes.tolist()
    assert set(map(tuple, read_sequences(data, TRAIN, 4, 0).strokes.tolist())) == training
    with pytest.raises(UsageError, match="4 sequences to train on, 5 are asked for"):
        read_sequences(data, TRAIN, 5)


@pytest.mark.parametrize("label", ["piegraph", "gnn@2"])
def test_training_learns_from_training_sequences_and_notes_the_loss_on_validation_ones(data, label, monkeypatch):
    seen = []
    name, _, count = label.partition("@")
    learner = MODELS[name].learner
    assert learner is not None
    real = learner.examples

    def examples(own, settings, device):
        seen.append({tuple(stroke) for stroke in own.strokes.tolist()})
        return real(own, settings, device)

    monkeypatch.setitem(learner.__dict__, "examples", examples)
    model = make_model(data, label, seed=1, **TINY)
    wanted = {
        split: {
            tuple(s) for s in read_sequences(data, split, int(count) if count and split == TRAIN else None, 1).strokes
        }
        for split in (TRAIN, VALIDATION)
    }
    assert sorted(map(sorted, seen)) == sorted(map(sorted, wanted.values()))
    monkeypatch.undo()
    best = np.nanmin(model["validation_loss"])
    assert best == pytest.approx(loss_on(data, model, VALIDATION), rel=1e-4)
    assert best != pytest.approx(loss_on(data, model, TRAIN), rel=1e-2)
    assert best != pytest.approx(loss_on(data, model, TEST), rel=1e-2)


def test_the_kept_weights_are_those_of_the_lowest_validation_loss(data, monkeypatch):
    """Losses on validation that are told, lowest at the third look: rounding can not decide which is best."""
    learner = MODELS["piegraph"].learner
    assert learner is not None
    real, weights = learner.examples, []

    class Told:
        def __init__(self, examples):
            self.examples, self.static_loss = examples, examples.static_loss

        def __len__(self):
            return len(self.examples)

        def loss(self, network, chosen, rng=None):
            if rng is not None:
                return self.examples.loss(network, chosen, rng)
            weights.append({name: value.detach().clone() for name, value in network.state_dict().items()})
            return torch.tensor(abs(len(weights) - 3.0) + 1)

    monkeypatch.setitem(learner.__dict__, "examples", lambda *given: Told(real(*given)))
    model = make_model(data, "piegraph", **TINY | {"steps": 12, "cycles": 1})
    assert model["validation_loss"].tolist() == [abs(k - 2.0) + 1 for k in range(len(weights))]
    assert len(weights) > 3
    for name, value in weights[2].items():
        np.testing.assert_array_equal(model[f"weights/{name}"], value)
    assert any((weights[2][name] != value).any() for name, value in weights[-1].items())


def test_without_validation_sequences_there_is_no_validation_loss():
    data = make_dataset(train=4, validation=0)
    assert np.isnan(make_model(data, "piegraph", **TINY)["validation_loss"]).all()


def test_a_model_notes_what_it_learned_from(data):
    model = make_model(data, "piegraph", **TINY | {"cycles": 1})
    assert (int(model["particles"]), model["modes"].tolist()) == (16, [0])
    paces = PACE + 0.001 * np.flatnonzero(data["sequence_split"] == TRAIN)
    assert float(model["pace"]) == pytest.approx(np.median(paces), rel=1e-3)
    assert model["step"].tolist() == [1, 2, 3, 4, 5, 6]
    picks = make_model(make_dataset(pick=True), "piegraph", **TINY)
    assert picks["modes"].tolist() == [1]
    assert read_model(picks).network.picks
    assert not read_model(model).network.picks


def test_metrics_are_of_the_test_sequences_alone(data):
    found = make_metrics(data, None, "static")
    assert set(found["sequence"].tolist()) == names_of(data, TEST)
    other = make_metrics(make_dataset(seed=5), None, "static")
    assert set(other["sequence"].tolist()) == names_of(make_dataset(seed=5), TEST)


def test_metrics_are_those_of_the_weights_they_are_given(data):
    """The guided and the unguided network, and two trainings, are told apart."""
    models = [make_model(data, "piegraph", seed=s, **TINY | {"learning_rate": 0.1}) for s in (0, 1)]
    pds = [
        make_metrics(data, model, label)["pd"].mean()
        for model, label in (
            (models[0], "piegraph"),
            (models[0], "piegraph-ng"),
            (models[0], "kabsch"),
            (models[1], "piegraph"),
        )
    ]
    assert len({round(float(pd), 4) for pd in pds}) == 4


def test_truth_is_compared_at_the_frame_in_which_a_stroke_ends(data):
    names = sorted(names_of(data, TEST))
    true = {}
    for k, name in enumerate(names):
        positions = tracks(int(name[-4:]))["positions"].astype(np.float64)
        true[name] = artifact({"true_positions": positions + np.array([0, 0.01 * (k + 1), 0])})
    found = make_metrics(data, None, "static", scores=true)
    at_truth = found["pd_truth"].reshape(2, 3)
    assert found["first_stroke"].reshape(2, 3).tolist() == [[0, 1, 0]] * 2
    assert found["horizon"].reshape(2, 3).tolist() == [[1, 1, 2]] * 2
    for k, name in enumerate(names):
        own = tracks(int(name[-4:]))["positions"].astype(np.float64)
        stroke = 500 * (PACE + 0.001 * int(name[-4:]))
        np.testing.assert_allclose(found["pd"].reshape(2, 3)[k, :2], stroke, rtol=1e-4)
        ends = own[[5, 12, 12]] + np.array([0, 0.01 * (k + 1), 0])
        expected = np.linalg.norm(own[[0, 7, 0]] - ends, axis=-1).mean(-1) * 100
        np.testing.assert_allclose(at_truth[k], expected, rtol=1e-4)
    without = make_metrics(
        data, None, "static", scores={name: artifact({"true_positions": np.zeros((0, 16, 3))}) for name in names}
    )
    assert np.isnan(without["pd_truth"]).all()
