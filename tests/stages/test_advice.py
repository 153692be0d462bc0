"""What `train` says of other models for a recording of few strokes, and of which trainings it says nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.dynamics.choosing import Compared
from piegraph_cli.dynamics.params import EGNNParams, ModelParams
from piegraph_cli.stages import comparing, train
from tests.dynamics.test_prior import NUMBERS
from tests.dynamics.test_rigid_body import pushed

SMALL = EGNNParams(steps=2, hidden=4, layers=1, neighbors=2)


class Dataset(dict):
    """What a training reads of a dataset of strokes, a sequence each."""

    path = "dataset.h5"

    @classmethod
    def of(cls, data):
        count = len(data.strokes)
        first = {"positions": data.positions, "end_effector": data.hand, "strokes": data.strokes, "pairs": data.strokes}
        owners = {name: np.arange(count) for name in ("stroke_sequence", "pair_stroke")}
        split, mode = np.zeros(count, np.uint8), data.mode
        seen = np.ones(data.positions.shape[:2], bool)
        start = data.strokes[:, 0]
        return cls(first | owners, sequence_split=split, stroke_mode=mode, seen=seen, sequence_start=start)


def trained(label: str, count: int) -> str:
    """The line of a training on so many strokes."""
    context = SimpleNamespace(
        device="cpu", checkpoint=SimpleNamespace(load=lambda: None), progress=lambda items, what: items
    )
    params = ModelParams(label=label, seed=0, settings=SMALL)
    return train.run({"dataset": Dataset.of(pushed(NUMBERS, count))}, params, context).quality


@pytest.fixture
def asked(monkeypatch):
    """The families and the steps of what was compared."""
    found = []

    def compared(data, prior, tuned, plain, seed, counted):
        found.append((prior.family, tuned.learning_rate, plain, len(data.strokes)))
        near, far = np.full(12, 0.01), np.linspace(0.02, 0.03, 12)
        return Compared({"piegraph:prior": near, "piegraph": far, "static": far * 2}, data.owner)

    monkeypatch.setattr(comparing, "compared", compared)
    return found


def test_a_training_on_few_strokes_ends_with_the_comparison(asked):
    line = trained("piegraph", 12)
    assert line.endswith("piegraph:prior 1.00, piegraph 2.50, static 5.00; better: `piegraph train --from prior`")
    assert asked == [("blocks", 1e-3, SMALL, 12)]


def test_what_is_one_of_a_comparison_already_is_compared_with_nothing(asked):
    assert trained("piegraph@12", 12).endswith(train.RIGID)
    assert trained("piegraph", 6).endswith(train.RIGID)
    assert asked == []
