"""What is kept of steps: each stroke in its column, and the same columns where no step was taken."""

import numpy as np

from piegraph_cli.params import PUSH
from piegraph_cli.planning.episode import play
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.stages.steps import step_arrays
from tests.planning.block import Block

PARAMS = PlanParams(model="static", samples=6, cem_iterations=2, horizon=3, strokes=2)


def test_every_column_has_its_place():
    steps = play(Block(), None, PARAMS, start=0, goal=0).steps
    arrays = step_arrays(steps, 36)
    assert arrays["stroke"].shape == (2, 2, 2)
    assert arrays["candidate_stroke"].shape == (2, 2, 6, 3, 2, 2)
    assert arrays["candidate_mode"].shape == (2, 2, 6, 3)
    first = steps[0].plan
    np.testing.assert_array_equal(arrays["stroke"][0], [first.strokes.start[0], first.strokes.end[0]])
    np.testing.assert_array_equal(arrays["candidate_stroke"][0, 1, 5, 2, 1], first.candidates.strokes.end[1, 5, 2])
    assert arrays["mode"].tolist() == [PUSH, PUSH]
    assert not arrays["candidate_mode"].any()


def test_no_step_leaves_empty_columns():
    some, none = (step_arrays(steps, 36) for steps in (play(Block(), None, PARAMS, start=0, goal=0).steps, []))
    assert some.keys() == none.keys()
    assert all(len(column) == 0 for column in none.values())
    assert {n: c.ndim for n, c in none.items()} == {n: c.ndim for n, c in some.items()}
