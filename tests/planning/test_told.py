"""What is kept of steps, each stroke in its column; and stages that plan in an environment with a pusher of its own."""

from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.params import PUSH
from piegraph_cli.planning.episode import play
from piegraph_cli.planning.params import PlanParams, TrialParams
from piegraph_cli.planning.told import step_arrays
from piegraph_cli.stages import plan, steps, trials
from tests.planning.block import Block

PARAMS = PlanParams(model="static", samples=6, cem_iterations=2, horizon=3, strokes=2)


def test_every_column_has_its_place():
    taken = play(Block(), None, PARAMS, start=0, goal=0).steps
    arrays = step_arrays(taken, 36)
    assert arrays["stroke"].shape == (2, 2, 2)
    assert arrays["candidate_stroke"].shape == (2, 2, 6, 3, 2, 2)
    assert arrays["candidate_mode"].shape == (2, 2, 6, 3)
    first = taken[0].plan
    np.testing.assert_array_equal(arrays["stroke"][0], [first.strokes.start[0], first.strokes.end[0]])
    np.testing.assert_array_equal(arrays["candidate_stroke"][0, 1, 5, 2, 1], first.candidates.strokes.end[1, 5, 2])
    assert arrays["mode"].tolist() == [PUSH, PUSH]
    assert not arrays["candidate_mode"].any()


def test_no_step_leaves_empty_columns():
    some, none = (step_arrays(taken, 36) for taken in (play(Block(), None, PARAMS, start=0, goal=0).steps, []))
    assert some.keys() == none.keys()
    assert all(len(column) == 0 for column in none.values())
    assert {n: c.ndim for n, c in none.items()} == {n: c.ndim for n, c in some.items()}


@pytest.mark.parametrize("radius", [0.01, 0.012])
def test_plans_and_trials_say_where_their_pusher_is_not_the_environments(monkeypatch, radius):
    monkeypatch.setattr(steps, "open_environment", lambda *_: Block())
    context = SimpleNamespace(progress=lambda numbers, _: numbers, device="cpu", run=None)
    params = PARAMS.model_copy(update={"env": "daxbench-rope", "pusher_radius": radius})
    trial = TrialParams(goal=0, seed=0, network=None, plan=params)
    for output in (plan.run({}, params, context), trials.run({}, trial, context)):
        assert output.arrays["blocked"].tolist() == [radius == 0.012] * 2
        assert [("0.012 m" in text, "0.024 m" in text) for text in output.warnings] == [(True, True)] * (
            radius == 0.012
        )
