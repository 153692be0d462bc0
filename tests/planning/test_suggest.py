"""Which strokes to record next: unlike those recorded and one another, first where a model is unsure."""

import math

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.reliability import Calibration
from piegraph_cli.dynamics.sides import on_object, untouched
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.params import PUSH
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import stroke_space
from piegraph_cli.planning.suggest import suggest

GRID = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 7), np.linspace(-0.05, 0.05, 7)), -1).reshape(-1, 2)
STATE = np.column_stack([GRID, np.full(len(GRID), 0.01)]).astype(np.float32)
SIZE = float(np.sqrt(np.square(GRID).sum(1).mean()))
HERE = np.zeros(3)
NONE = np.zeros((0, 5))
WIDE = (-1.0, 1.0, -1.0, 1.0, 0.0, 1.0)


def model(right: float = 1.0, shift: float = 0.0):
    """Foresees nothing, but for signs that are `right` times as large for strokes that begin at x > 0."""

    def foresee(positions, strokes):
        signs = torch.where(strokes.start[:, :1] > 0, right, 1.0) * torch.tensor([[0.02, 0.01]])
        return positions + shift * (strokes.start[:, 0] > 0)[:, None, None], signs

    return foresee


def asked(models=(model(),), known=NONE, count=6, seed=0, workspace=WIDE, calibration=None, pose=HERE, state=STATE):
    params = PlanParams(workspace=workspace)
    space = stroke_space(torch.as_tensor(state), params, (PUSH,), params.pusher_radius)
    return suggest(models, calibration, state, pose, SIZE, space, known, count, seed)


def apart(found) -> np.ndarray:
    """Distances between all suggested strokes on the object, in sizes of it."""
    seen = on_object(found.strokes, np.zeros((len(found.strokes), 3)), SIZE)[:, :4]
    return np.linalg.norm(seen[:, None] - seen[None], axis=-1)[np.triu_indices(len(seen), 1)]


def test_suggestions_differ_and_are_the_same_for_one_seed():
    found, again, other = asked(), asked(), asked(seed=1)
    assert len(found.strokes) == 6
    assert apart(found).min() > 1.0
    assert torch.equal(found.strokes.ends, again.strokes.ends)
    assert not torch.equal(found.strokes.ends, other.strokes.ends)


def test_what_was_recorded_is_not_suggested_again():
    first = asked(count=3)
    known = on_object(first.strokes, np.zeros((3, 3)), SIZE)
    found = asked(known=known, count=3)
    distance = np.linalg.norm(on_object(found.strokes, np.zeros((3, 3)), SIZE)[:, None] - known[None], axis=-1)
    assert distance.min() > 1.0
    assert (found.new > 0.8).all()


@pytest.mark.parametrize(
    ("models", "calibration", "reason"),
    [
        ((model(3.0),), None, "motion"),
        ((model(3.0),), Calibration(0.0, 0.5, 0.5, 2.0), "expected error"),
        ((model(), model(shift=0.03)), None, "spread"),
    ],
)
def test_strokes_of_which_least_is_known_come_first(models, calibration, reason):
    found = asked(models=models, calibration=calibration, count=4)
    assert found.reason == reason
    assert (found.strokes.start[:3, 0] > 0).all()


def test_strokes_are_seen_from_the_object_wherever_it_lies():
    pose = np.array([0.3, -0.2, 0.7])
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    turn = np.array([[cosine, -sine], [sine, cosine]])
    there = Strokes.of(
        torch.tensor((turn @ [0.1, 0.02] + pose[:2])[None]), torch.tensor((turn @ [0.0, 0.03] + pose[:2])[None]), PUSH
    )
    np.testing.assert_allclose(on_object(there, pose[None], 0.5), [[0.2, 0.04, 0.0, 0.06, PUSH]], atol=1e-9)


def test_a_side_that_no_stroke_comes_from_is_told():
    def around(*degrees: float) -> np.ndarray:
        angle = np.radians(degrees)
        return np.column_stack([np.cos(angle), np.sin(angle), np.zeros((len(angle), 3))])

    assert untouched(around(10, 100, 190, 280)) is None
    middle, width = untouched(around(-60, 0, 45))
    assert np.degrees([middle, width]) == pytest.approx([172.5, 255])
    assert untouched(around(30))[1] == pytest.approx(2 * math.pi)


def test_no_room_for_any_stroke_is_an_error():
    with pytest.raises(DataError, match="no stroke is feasible"):
        asked(workspace=(-0.01, 0.01, -0.01, 0.01, 0.0, 1.0))
