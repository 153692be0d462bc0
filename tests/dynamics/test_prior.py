"""Priors: pretraining goes on bit for bit, and on a recording a prior beats a network that begins with nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.egnn import Rest
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.family.params import PretrainParams
from piegraph_cli.dynamics.models import make_network
from piegraph_cli.dynamics.own_block import check_block, fitted_body, own_block, own_strokes
from piegraph_cli.dynamics.params import SHIPPED_PRIORS, EGNNParams, ModelParams, TrainParams
from piegraph_cli.dynamics.prior import Pretraining, make_prior
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.dynamics.tuning import KINDS, Tuning, start_tuning, tuned_steps, unseen
from piegraph_cli.errors import DataError
from piegraph_cli.stages.prior import TUNING, read_prior
from tests.dynamics.test_rigid_body import pushed

NUMBERS = [0.2, 0.045, 0.006, 0.0, 0.0]
SMALL = PretrainParams(hidden=8, layers=2, steps=70, batch=16)
SETTINGS = EGNNParams(neighbors=6, hidden=64, **(TUNING | {"steps": 40}))


def begun() -> Pretraining:
    return Pretraining(make_prior(SMALL, False, 0), SMALL)


def test_pretraining_taken_up_again_ends_in_the_same_bits():
    whole = begun()
    states = []
    while not whole.finished:
        whole.step()
        states.append(whole.state() if whole.done == 66 else None)
    again = begun()
    again.load(next(state for state in states if state))
    while not again.finished:
        again.step()
    assert again.done == 70
    assert again.history == whole.history
    assert all(np.array_equal(value, again.state()[name]) for name, value in whole.state().items())


@pytest.fixture(scope="module")
def prior():
    return read_prior(SHIPPED_PRIORS["blocks"])[0]


def error(network: torch.nn.Module, data: Sequences) -> float:
    """Mean particle error (m) of strokes."""
    first, last = data.strokes.T
    before, after = (torch.as_tensor(data.positions[k]) for k in (first, last))
    with torch.no_grad():
        found = network(before, data.whole(), Rest.of(torch.as_tensor(data.rest[data.owner]), SETTINGS.neighbors))
    return float((found - after).norm(dim=-1).mean())


def begin(prior, data: Sequences) -> Trainer:
    return start_tuning(prior, own_block(data, SETTINGS.neighbors, 0), data, None, SETTINGS, 0)


def trained(trainer: Trainer) -> torch.nn.Module:
    while not trainer.finished:
        trainer.step()
    return trainer.network


def test_with_few_strokes_and_steps_a_prior_beats_a_network_that_begins_with_nothing(prior):
    data, test = pushed(NUMBERS, 8), pushed(NUMBERS, 40, seed=1)
    first, last = test.strokes.T
    static = float(np.linalg.norm(test.positions[last] - test.positions[first], axis=-1).mean())
    at_once = error(begin(prior, unseen(data)).network, test)
    tuned = error(trained(begin(prior, data)), test)
    chunk = own_strokes(fitted_body(data), data, SETTINGS.neighbors, 0)
    fresh = make_network("piegraph", SETTINGS, False, 0)
    scratch = error(trained(Trainer(fresh, Tuning(data, chunk, 6, KINDS["blocks"]), None, SETTINGS, 0)), test)
    assert at_once < 0.5 * static
    assert tuned < at_once
    assert tuned < 0.6 * scratch


def test_simulated_strokes_are_of_the_object_and_as_long_as_the_recordings():
    data = pushed(NUMBERS, 8)
    chunk = own_strokes(fitted_body(data), data, 6, 0)
    own = torch.as_tensor(data.rest[0])
    assert torch.allclose(torch.pdist(chunk.before[0]), torch.pdist(own), atol=2e-4)
    moved = (chunk.after - chunk.before).norm(dim=-1).mean(1).median()
    first, last = data.strokes.T
    recorded = np.median(np.linalg.norm(data.positions[last] - data.positions[first], axis=-1).mean(1))
    assert 0.5 * recorded < moved < 1.5 * recorded


def test_fewer_steps_are_taken_only_with_strokes_to_choose_them_by(prior):
    assert tuned_steps(prior, pushed(NUMBERS, 19), SETTINGS, 0) == SETTINGS.steps
    few = SETTINGS.model_copy(update={"steps": 10})
    assert 1 <= tuned_steps(prior, pushed(NUMBERS, 20), few, 0) <= 10


def bent(data: Sequences, by: float) -> Sequences:
    positions = data.positions.copy()
    last = data.strokes[:, 1]
    positions[last, : positions.shape[1] // 2, 0] += by
    return replace(data, positions=positions)


def test_other_things_than_blocks_are_refused_by_what_they_do():
    data = pushed(NUMBERS, 6)
    check_block(data)
    check_block(bent(data, 0.004))
    with pytest.raises(DataError, match="mm from a rigid motion: this bends; the prior is for blocks"):
        check_block(bent(data, 0.05))
    with pytest.raises(DataError, match="hold the object; the prior is for blocks"):
        check_block(replace(data, mode=np.ones_like(data.mode)))
    narrow = data.rest * [1, 0.02, 1]
    with pytest.raises(DataError, match="as narrow as a rope"):
        check_block(replace(data, rest=narrow.astype(np.float32)))


def test_a_model_without_a_prior_has_the_content_it_had():
    settings = ModelParams(label="piegraph", seed=0, settings=EGNNParams()).content()["settings"]
    assert "prior" not in settings
    begins = TrainParams().of("piegraph:prior@5")
    assert begins.files() == {"prior": SHIPPED_PRIORS["blocks"], "prior_ropes": SHIPPED_PRIORS["ropes"]}
    assert begins.content()["prior"] == "prior"


def test_the_word_for_the_shipped_prior_stays_a_word_and_a_file_becomes_a_path(tmp_path):
    train = TrainParams.model_validate({"piegraph": {"prior": "prior"}})
    assert "piegraph.prior" not in train.placed(tmp_path)
    train = TrainParams.model_validate({"piegraph": {"prior": "mine.h5"}})
    assert Path(train.placed(tmp_path)["piegraph.prior"]) == tmp_path.resolve() / "mine.h5"
