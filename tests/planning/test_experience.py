"""Errors that count in a plan: those a model is known to make, and those of the strokes that an episode has tried."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import sure
from piegraph_cli.dynamics.reliability import GROWTH, Calibration
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.experience import LIKE_STROKE, Tried, shown
from piegraph_cli.planning.mpc import helps, run_episode
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.search import Search
from tests.planning.test_planning import SPACE, SQUARE, carried

COST = make_cost("distance", SQUARE + torch.tensor([0.06, 0.0, 0.0]), len(SQUARE))
OFTEN_OFF = Calibration(0.0, 0.5, 0.0, 2.0)


def plan(tried=(), calibration=None, foresee=sure(carried), **settings):
    params = PlanParams(**{"samples": 60, "converged": 0} | settings)
    return Search(foresee, COST, SPACE, params, torch.Generator().manual_seed(0), False, calibration)(SQUARE, tried)


def moving(positions, strokes):
    """Carries everything along, and tells how far."""
    after = carried(positions, strokes)
    return after, torch.stack([(after - positions).norm(dim=-1).mean(1), torch.zeros(len(after))], 1)


def test_a_stroke_has_shown_what_it_did_of_those_that_are_like_it():
    ends = torch.tensor([[[0.0, 0.0], [0.1, 0.0]]])
    tried = [Tried(SQUARE, ends[0], 0.04), Tried(SQUARE + 1.0, ends[0], 0.5)]
    aside = ends + torch.tensor([0.0, LIKE_STROKE])
    found = shown(SQUARE, torch.cat([ends, aside, ends + 1.0]), tried)
    assert found.tolist() == pytest.approx([0.04, 0.04 * np.exp(-0.5), 0.0])
    assert shown(SQUARE, ends, ()).isnan().all()


def test_unasked_nothing_that_is_known_of_errors_changes_a_plan():
    plain = plan()
    tried = [Tried(SQUARE, plain.strokes.ends[0], 0.5)]
    again = plan(tried, OFTEN_OFF, moving, remember=False)
    assert torch.equal(plain.strokes.packed(), again.strokes.packed())
    assert torch.equal(plain.candidates.costs, again.candidates.costs)
    assert (plain.cost, bool(plain.errors.isnan().all())) == (again.cost, True)
    assert float(again.errors[0]) == pytest.approx(0.5)
    first = plan()
    assert torch.equal(plain.strokes.packed(), first.strokes.packed()), "nothing was tried yet"


def test_a_stroke_that_did_nothing_is_not_tried_again():
    first = plan()
    tried = [Tried(SQUARE, first.strokes.ends[0], 0.06)]
    repeated, other = (plan(tried, remember=remember) for remember in (False, True))
    assert torch.equal(repeated.strokes.ends, first.strokes.ends)
    assert (other.strokes.ends - first.strokes.ends).norm(dim=-1).mean() > LIKE_STROKE / 2
    assert other.cost == pytest.approx(float(COST(other.predicted)[0]), abs=1e-6), "the distance alone"


def test_caution_prefers_strokes_that_move_little_where_motion_goes_wrong():
    bold, careful = (plan((), OFTEN_OFF, moving, caution=caution) for caution in (0.0, 5.0))
    assert float(careful.errors[0]) < 0.5 * float(bold.errors[0])
    assert float(bold.errors[0]) == pytest.approx(
        0.5 * float((bold.predicted[0] - SQUARE).norm(dim=-1).mean()), rel=1e-4
    )
    assert careful.cost == pytest.approx(float(COST(careful.predicted)[0]), abs=1e-6), "the distance alone"


def test_errors_grow_from_stroke_to_stroke():
    found = plan((), Calibration(0.01, 0.0, 0.0, 1.0), horizon=3)
    assert found.errors.tolist() == pytest.approx([0.01, 0.01 * 2**GROWTH, 0.01 * 3**GROWTH])


def test_a_plan_helps_where_it_gains_more_than_it_may_be_off():
    found = plan((), OFTEN_OFF, moving)
    assert helps(found, 0.06, COST)
    assert not helps(found, found.cost + float(found.errors[0]) - 1e-4, COST)
    assert helps(plan(), 0.06, COST), "nothing is known against it"


def episode(stop: bool, works: bool, calibration: Calibration | None = None, **limits):
    """Of an object that does not move unless it `works`."""
    world = SQUARE.clone()

    def act(stroke: Strokes):
        nonlocal world
        world = carried(world[None], Strokes.stack([stroke]))[0] if works else world
        return world.numpy(), False

    params = PlanParams(samples=60, horizon=limits.get("look_every", 1))
    search = Search(moving, COST, SPACE, params, torch.Generator().manual_seed(0), False, calibration)
    return run_episode(SQUARE.numpy(), search, act, COST, strokes=6, success=0.005, stop=stop, **limits)


def test_an_episode_ends_when_nothing_is_expected_to_help():
    wrong = Calibration(0.0, 1.5, 0.0, 1.0)
    assert episode(stop=True, works=False, calibration=wrong) == ([], "no stroke is expected to help")
    steps, ending = episode(stop=False, works=False, calibration=wrong)
    assert (len(steps), ending) == (6, "strokes spent")
    assert episode(stop=True, works=True, calibration=OFTEN_OFF)[1] == "reached"


def test_strokes_are_carried_out_before_it_is_looked_again():
    steps, ending = episode(stop=False, works=True, look_every=3)
    assert (len(steps), ending) == (3, "reached")
    assert steps[0].seconds > 0 == steps[1].seconds == steps[2].seconds
    for step in steps:
        np.testing.assert_allclose(step.plan.predicted[0], step.after, atol=1e-5)


def test_no_more_strokes_are_carried_out_than_are_planned():
    with pytest.raises(ValueError, match="look_every 2 is more than horizon 1"):
        PlanParams(look_every=2)
