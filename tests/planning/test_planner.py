"""The planner that settings ask for: modes that model, tool and user share, and the pusher of the tool that acts."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import (
    Goal,
    Tool,
    choose_modes,
    make_planner,
    pusher_radius,
    stroke_space,
    tool_warnings,
)
from tests.planning.block import Block

WIDE = Tool((PUSH,), Block.pusher_radius)


def blocked(params: PlanParams, tool: Tool) -> float:
    """The share of feasible ones among 500 proposed pushes that would start inside the block."""
    environment = Block()
    state, _ = environment.reset(seed=0)
    space = stroke_space(torch.as_tensor(state), params, (PUSH,), pusher_radius(params, tool))
    proposals = space.sample((500,), torch.Generator().manual_seed(0))
    strokes, feasible = space.strokes(torch.as_tensor(state).expand(500, -1, -1), proposals)
    assert feasible.sum() > 200
    known, found = environment.get_state(), []
    for index in feasible.nonzero()[:, 0].tolist():
        found.append(environment.step(strokes[index].action())[4]["blocked"])
        environment.set_state(known)
    return float(np.mean(found))


def test_pushes_start_off_the_object_for_the_pusher_that_acts():
    assert blocked(PlanParams(), WIDE) < 0.05
    assert blocked(PlanParams(), Tool((PUSH,))) > 0.95, "a robot's has 10 mm unless the settings say otherwise"
    assert blocked(PlanParams(pusher_radius=0.024), Tool((PUSH,))) < 0.05


def test_a_radius_that_is_asked_for_wins_and_is_said():
    asked = PlanParams(env="daxbench-rope", pusher_radius=0.012)
    assert pusher_radius(asked, WIDE) == 0.012
    (warning,) = tool_warnings(asked, WIDE)
    assert "plan.pusher_radius 0.012 m" in warning
    assert "daxbench-rope has 0.024 m" in warning
    for params, tool in ((PlanParams(), WIDE), (PlanParams(pusher_radius=0.024), WIDE), (asked, Tool())):
        assert tool_warnings(params, tool) == []


def test_settings_of_equal_value_plan_alike_however_they_were_given():
    """Keys of artifacts tell values apart, not where they came from."""
    given = PlanParams(pusher_radius=PlanParams().pusher_radius)
    assert given.model_dump() == PlanParams().model_dump()
    assert pusher_radius(given, WIDE) == pusher_radius(PlanParams(), WIDE) == WIDE.pusher_radius


def test_a_push_must_be_long_enough_for_the_pusher():
    state = torch.rand(20, 3, generator=torch.Generator().manual_seed(0))
    stroke_space(state, PlanParams(max_length=0.021), (PUSH,), 0.01)
    with pytest.raises(UsageError, match="do not go into"):
        stroke_space(state, PlanParams(max_length=0.021), (PUSH,), 0.024)
    stroke_space(state, PlanParams(max_length=0.021), (PICK,), 0.024)


@pytest.mark.parametrize(
    ("asked", "learned", "known", "modes"),
    [
        ((), None, None, (PUSH, PICK)),
        ((), (PICK,), None, (PICK,)),
        ((), None, (PICK, PUSH), (PUSH, PICK)),
        ((), (PUSH, PICK), (PICK,), (PICK,)),
        (("pick",), (PUSH, PICK), None, (PICK,)),
    ],
)
def test_modes_are_those_that_all_know(asked, learned, known, modes):
    assert choose_modes(PlanParams(modes=asked), learned, known) == modes


@pytest.mark.parametrize(
    ("asked", "learned", "known", "message"),
    [
        (("pick",), (PUSH,), None, "no pick can be planned: the model was trained on push only"),
        (("pick",), None, (PUSH,), "no pick can be planned: tblock knows push only"),
        ((), (PICK,), (PUSH,), "the model was trained on pick strokes, which tblock does not know"),
    ],
)
def test_modes_that_none_knows_are_refused(asked, learned, known, message):
    with pytest.raises(UsageError, match=message):
        choose_modes(PlanParams(modes=asked, env="tblock"), learned, known)


def test_what_a_model_has_learned_counts_only_where_it_is_asked():
    state, _ = Block().reset(seed=0)
    goal, pushes = (
        Goal.of_particles(state + np.array([0.05, 0, 0])),
        Trained(torch.nn.Identity(), None, 0.0, (PUSH,), 36),
    )
    picks = {"modes": ("pick",), "samples": 8, "cem_iterations": 1}
    _, make_plan = make_planner(pushes, state, goal, PlanParams(model="static", **picks), Tool(), [0])
    assert make_plan(torch.as_tensor(state), ()).strokes.mode.tolist() == [PICK]
    with pytest.raises(UsageError, match="trained on push only"):
        make_planner(pushes, state, goal, PlanParams(model="piegraph", **picks), Tool(), [0])


def test_the_greedy_planner_needs_picks_and_places():
    state, _ = Block().reset(seed=0)
    params = PlanParams(model="static", planner="greedy")
    for goal, tool in ((Goal.of_particles(state), WIDE), (Goal(state), Tool())):
        with pytest.raises(UsageError, match="the greedy planner picks"):
            make_planner(None, state, goal, params, tool, [0])


def test_a_goal_outside_the_workspace_is_refused():
    state, _ = Block().reset(seed=0)
    with pytest.raises(DataError, match="the goal lies around"):
        make_planner(
            None, state, Goal.of_particles(state + np.array([1.0, 0, 0])), PlanParams(model="static"), Tool(), [0]
        )
