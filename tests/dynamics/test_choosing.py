"""Which model a recording of few strokes speaks for: by strokes that were left out, whole sequences at a time."""

from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli.dynamics import choosing
from piegraph_cli.dynamics import own_block as own_block_module
from piegraph_cli.dynamics.choosing import Compared, comparable, compared
from piegraph_cli.dynamics.params import SHIPPED_PRIORS, EGNNParams
from piegraph_cli.dynamics.tuning import KINDS
from piegraph_cli.stages.comparing import told
from piegraph_cli.stages.prior import TUNING, read_prior
from tests.dynamics.test_doubts import aside
from tests.dynamics.test_prior import NUMBERS, bent
from tests.dynamics.test_rigid_body import pushed

TUNED = EGNNParams(neighbors=6, hidden=64, **TUNING)


def paired(data):
    """Pairs are whole strokes."""
    return replace(data, pairs=data.strokes, pair_stroke=np.arange(len(data.strokes)))


@pytest.fixture
def compare(monkeypatch):
    monkeypatch.setattr(own_block_module, "SIMULATED", 80)
    monkeypatch.setitem(choosing.KINDS, "blocks", replace(KINDS["blocks"], compared=6))
    prior, _ = read_prior(SHIPPED_PRIORS["blocks"])
    return lambda data: compared(data, prior, TUNED, EGNNParams(steps=10, hidden=8, layers=1), 0, list)


def test_on_a_block_the_law_that_moves_it_beats_networks_and_a_prior_beats_none(compare):
    data = paired(pushed(NUMBERS, 12))
    found = compare(data)
    means = {label: float(errors.mean()) for label, errors in found.errors.items()}
    assert min(means, key=means.__getitem__) == found.best
    assert found.best == "rigid-gp"
    assert means["piegraph:prior"] < means["piegraph"]
    assert all(np.isfinite(errors).all() and len(errors) == 12 for errors in found.errors.values())
    static = np.linalg.norm(np.diff(data.positions.reshape(12, 2, -1, 3), axis=1), axis=-1).mean((1, 2))
    np.testing.assert_allclose(found.errors["static"], static, rtol=1e-5)
    assert "better: `piegraph train --model rigid-gp`" in told(found, "piegraph")


def test_a_fit_that_is_none_compares_nothing(compare):
    assert compare(aside(paired(pushed(NUMBERS, 12)))) is None


def test_few_strokes_many_and_other_things_are_not_compared():
    data = pushed(NUMBERS, 12)
    assert comparable(data) == "blocks"
    assert comparable(replace(data, owner=data.owner % 2)) is None, "two sequences"
    assert comparable(bent(data, 0.05)) is None, "no prior is for it"
    assert comparable(pushed(NUMBERS, choosing.FEWEST - 1)) is None
    assert comparable(pushed(NUMBERS, choosing.MOST + 1)) is None


def test_another_model_is_advised_only_where_it_is_surely_better():
    owner = np.repeat(np.arange(6), 2)
    near, far = np.linspace(0.01, 0.012, 12), np.linspace(0.022, 0.02, 12)
    found = Compared({"piegraph:prior": near, "piegraph": far, "static": far + 0.01}, owner)
    text = told(found, "piegraph")
    assert text.endswith("piegraph:prior 1.10, piegraph 2.10, static 3.10; better: `piegraph train --from prior`")
    assert told(found, "piegraph:prior").endswith("static 3.10")
    one = near.copy()
    one[:2] += 0.05  # one sequence makes the whole difference
    unsure = Compared({"piegraph:prior": near, "piegraph": one, "static": far + 0.01}, owner)
    assert told(unsure, "piegraph").endswith("no other is surely better")
