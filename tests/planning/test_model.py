"""A model as one object: what it takes as positions, and what it refuses."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.planning import model as of_model
from piegraph_cli.planning.model import PARTICLES, Model
from tests.planning.table import SQUARE

STATIC = Model("static", None)
TWO = Strokes.of([[-0.1, 0.0], [0.1, 0.0]], [[0.0, 0.0], [0.0, 0.0]], 0)


@pytest.fixture
def asked(monkeypatch):
    """What the prediction is made from and asked about; it moves the object by the number of the stroke, in metres."""
    noted = []

    def make(label, trained, rest, settings):
        def predict(positions, strokes):
            noted.append((label, rest, positions, strokes, settings))
            return positions + torch.arange(len(positions))[:, None, None]

        return predict

    monkeypatch.setattr(of_model, "make_predict", make)
    return noted


@pytest.mark.parametrize("kind", [np.float64, np.float32, list])
def test_positions_may_be_of_any_kind_and_for_all_strokes_at_once(asked, kind):
    state = SQUARE.tolist() if kind is list else SQUARE.astype(kind)
    found = STATIC.predict(state, TWO)
    assert (found.shape, found.dtype) == ((2, 25, 3), np.float32)
    np.testing.assert_allclose(found, [SQUARE, SQUARE + 1])
    label, rest, positions, strokes, settings = asked[0]
    assert (label, settings) == ("static", STATIC.settings)
    assert (rest.dtype, positions.dtype, strokes.start.dtype) == (torch.float32,) * 3
    np.testing.assert_array_equal(rest, SQUARE)


def test_each_stroke_may_have_its_own_positions_and_the_object_its_rest(asked):
    both = np.stack([SQUARE, SQUARE + 5])
    np.testing.assert_allclose(STATIC.predict(both, TWO), [SQUARE, SQUARE + 6])
    np.testing.assert_array_equal(asked[0][1], SQUARE)
    STATIC.predict(both, TWO, rest=SQUARE * 2)
    np.testing.assert_array_equal(asked[1][1], SQUARE * 2)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (np.zeros((3, 25, 3)), r"positions \[3, 25, 3\] for 2 strokes"),
        (np.zeros(3), r"positions \[3\] for 2 strokes"),
        (np.zeros((25, 2)), r"not finite points \[P, 3\] but an array \[50, 2\]"),
        (np.full((25, 3), np.nan), "not finite points"),
    ],
)
def test_positions_that_do_not_fit_are_refused(positions, message):
    with pytest.raises(DataError, match=message):
        STATIC.predict(positions, TWO)


def test_a_plan_needs_one_goal_and_enough_points():
    cloud = np.random.default_rng(0).uniform(-0.05, 0.05, (PARTICLES, 3))
    few = {"samples": 4, "cem_iterations": 1}
    with pytest.raises(DataError, match=f"{PARTICLES - 1} points, the model needs {PARTICLES} or more"):
        STATIC.plan(cloud[1:], goal=cloud, **few)
    for goals in ({}, {"goal": cloud, "goal_pose": (0, 0, 0)}):
        with pytest.raises(DataError, match="one goal is needed"):
            STATIC.plan(cloud, **goals, **few)
    with pytest.raises(UsageError, match="sample: unknown setting"):
        STATIC.plan(cloud, goal=cloud, sample=3)
    moved = STATIC.plan(cloud, goal_pose=(0.1, 0, 0), **few)
    assert moved.start_distance == pytest.approx(0.1, rel=1e-4)
    assert len(moved.steps) == 1
    there = STATIC.plan(cloud, goal=cloud, corresponds=True, **few)
    assert (there.steps, there.start_distance) == ([], 0)
    beside = cloud + np.array([0.1, 0, 0])
    assert STATIC.plan(cloud, goal=beside, corresponds=True, **few).start_distance == pytest.approx(0.1, rel=1e-4)
    shuffled = cloud[::-1] + np.float32([0.05, 0, 0])
    assert STATIC.plan(cloud, goal=shuffled, corresponds=True, **few).start_distance > 0.06
    with pytest.raises(DataError, match="50 particles now and 49 in the goal"):
        STATIC.plan(cloud, goal=cloud[1:], corresponds=True, **few)
    assert STATIC.plan(cloud, goal=shuffled, **few).start_distance == pytest.approx(0.051, abs=2e-3), "one shape"
