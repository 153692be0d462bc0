"""Closed loops in an environment: the same starts and goals for all, models that are not trained, the pusher that acts."""

from itertools import product

import numpy as np
import pytest
from torch.nn.functional import pad

from piegraph_cli import environments
from piegraph_cli.dynamics.models import sure
from piegraph_cli.errors import DataError
from piegraph_cli.planning import planner
from piegraph_cli.planning.episode import APART, Episode, play
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Goal
from tests.planning.block import Block

SETTINGS = {"samples": 40, "cem_iterations": 3, "strokes": 4, "success": 0.03}


def carried_almost(positions, strokes):
    return positions + 0.9 * pad(strokes.along, (0, 1))[:, None]


def episode(model: str, start: int = 0, goal: int = 0, environment: Block | None = None, **settings) -> Episode:
    return play(environment or Block(), None, PlanParams(model=model, **SETTINGS | settings), start=start, goal=goal)


def test_a_model_that_knows_the_block_pushes_it_to_its_goal(monkeypatch):
    monkeypatch.setattr(planner, "make_foresee", lambda *_: sure(carried_almost))
    found = episode("static")
    assert found.start_distance > 0.07
    assert found.end_distance < 0.03
    assert not any(step.blocked for step in found.steps)
    assert len(found.states) == len(found.steps) + 1
    for step, before, after in zip(found.steps, found.states, found.states[1:], strict=False):
        np.testing.assert_array_equal(step.before, before)
        np.testing.assert_array_equal(step.after, after)
    assert found.end_distance == pytest.approx(np.linalg.norm(found.states[-1] - found.goal, axis=1).mean(), abs=1e-6)


def test_a_narrower_pusher_than_the_one_that_acts_starts_inside():
    assert all(step.blocked for step in episode("sms-no", pusher_radius=0.0101).steps)


def test_every_model_meets_the_same_start_and_goal():
    one, other = episode("sms-no"), episode("static")
    np.testing.assert_array_equal(one.start, other.start)
    np.testing.assert_array_equal(one.goal, other.goal)
    assert not np.array_equal(one.start, episode("static", start=1).start)
    elsewhere = episode("static", goal=1)
    np.testing.assert_array_equal(one.start, elsewhere.start)
    assert not np.array_equal(one.goal, elsewhere.goal)


def test_an_episode_does_not_depend_on_those_before_it():
    environment = Block()
    episode("static", start=3, environment=environment)
    again, alone = episode("sms-no", environment=environment), episode("sms-no")
    np.testing.assert_array_equal(again.states, alone.states)


def test_another_goal_may_be_chosen():
    params = PlanParams(model="static", **SETTINGS)
    found = play(Block(), None, params, Goal.of_particles, start=0, goal=0)
    assert (found.steps, found.start_distance, found.end_distance) == ([], 0.0, 0.0)
    assert len(found.states) == 1


def tasks(environment, count: int = 4, **settings) -> dict[tuple[int, int], Episode]:
    """Episodes without a stroke, by start and goal."""
    nothing = {"strokes": 1, "success": 0.9, "fixed_goals": True}
    pairs = product(range(count), repeat=2)
    return {(s, g): episode("static", s, g, environment, **nothing | settings) for s, g in pairs}


def test_goals_in_place_follow_from_their_number_alone():
    found, drawn = tasks(Block()), tasks(Block(), fixed_goals=False)
    for (start, goal), one in found.items():
        np.testing.assert_array_equal(one.goal, found[0, goal].goal)
        assert one.start_distance > APART
        # goals of this environment lie to the right of where it is: of a start of their own, not of the trial's
        assert not np.array_equal(one.goal, drawn[start, goal].goal)
    assert len({one.goal.tobytes() for one in found.values()}) == 4
    again = tasks(Block(), seed=1)
    assert not np.array_equal(again[0, 0].goal, found[0, 0].goal)


def test_starts_stay_but_where_they_coincide_with_the_goal():
    environment = Block()
    found, drawn = tasks(environment, 8), tasks(environment, 8, fixed_goals=False)
    near = {k for k, one in found.items() if np.linalg.norm(drawn[k].start - one.goal, axis=1).mean() <= APART}
    assert 3 < len(near) < 40
    moved = {k for k, one in found.items() if not np.array_equal(one.start, drawn[k].start)}
    assert moved == near


def test_an_environment_without_another_start_is_named():
    class Stuck(Block):
        def reset(self, *, seed=None, options=None):
            self.place = np.zeros(2)
            return self.particles(), {}

        def goal(self, rng):
            return self.particles(np.array([0.049, 0]))

    with pytest.raises(DataError, match=r"every start lies within 5 cm of goal 2"):
        episode("static", goal=2, environment=Stuck(), fixed_goals=True)


def test_block_goals_in_place_lie_all_over_the_table_and_in_reach():
    found = tasks(environments.make("tblock", 50), 12)
    middles = np.array([one.goal[:, :2].mean(0) for one in found.values()])
    assert np.abs(middles).max() < 0.26
    assert (np.ptp(middles, axis=0) > 0.2).all()
    turns = np.ptp([np.arctan2(*(one.goal[1] - one.goal[0])[:2]) for one in found.values()])
    assert turns > np.pi, "goals are turned by more than 90 degrees from some start"


@pytest.mark.parametrize(
    ("walls", "inside"), [(None, False), ((-0.1, 0.5, -0.5, 0.5), True), ((-9, 9, -9, 0.1), False)]
)
def test_strokes_stay_inside_the_walls_of_an_environment(monkeypatch, walls, inside):
    moved = sure(lambda x, s: x + 0.9 * pad(s.along, (0, 1))[:, None])
    monkeypatch.setattr(planner, "make_foresee", lambda *_: moved)
    block = Block()
    block.walls = walls
    found = episode("static", environment=block, workspace=(-0.4, 0.4, -0.4, 0.4, -0.02, 0.35))
    ends = np.array([[*step.plan.strokes[0].start, *step.plan.strokes[0].end] for step in found.steps])
    assert (ends[:, [0, 2]].min() >= -0.1) == inside
    assert np.abs(ends).max() <= 0.4
