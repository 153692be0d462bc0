"""Proposals touch the object, costs measure what they say, CEM finds known optima, the loop stops when it is done."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.errors import DataError
from piegraph_cli.planning.cem import plan_strokes
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.mpc import run_episode
from piegraph_cli.planning.proposals import CLEARANCE, MARGIN, PushSpace, solid_edges

SQUARE = torch.tensor([[x, y, 0.0] for x in np.linspace(-0.05, 0.05, 6) for y in np.linspace(-0.05, 0.05, 6)]).float()
SPACE = PushSpace(solid_edges(SQUARE), 0.02, 0.14, 0.01, (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35))


def carried(positions: torch.Tensor, strokes: torch.Tensor) -> torch.Tensor:
    """Everything moves along with the stroke."""
    motion = torch.nn.functional.pad(strokes[:, 2:4] - strokes[:, :2], (0, 1))
    return positions + motion[:, None]


def test_a_push_starts_just_off_the_object_and_heads_where_it_says():
    proposal = torch.tensor([[0.0, 0.0, 0.1], [math.pi / 2, 1.0, 0.05]])
    strokes, feasible = SPACE.strokes(SQUARE.expand(2, -1, -1), proposal)
    assert feasible.all()
    assert strokes[0, 0].item() == pytest.approx(-0.05 - SPACE.pusher_radius - MARGIN - CLEARANCE, abs=1e-3)
    torch.testing.assert_close(strokes[0, 2] - strokes[0, 0], torch.tensor(0.1))
    torch.testing.assert_close(strokes[1, [0, 2]], torch.tensor([-0.05, -0.05]))
    distances = (SQUARE[:, :2] - strokes[0, :2]).norm(dim=-1)
    assert distances.min() > SPACE.pusher_radius


def test_strokes_out_of_the_workspace_are_infeasible():
    _, feasible = SPACE.strokes((SQUARE + torch.tensor([0.45, 0.0, 0.0]))[None], torch.tensor([[0.0, 0.0, 0.1]]))
    assert not feasible.any()


def test_a_gap_in_the_object_may_be_missed():
    apart = torch.cat([SQUARE + torch.tensor([0.0, s * 0.2, 0.0]) for s in (-1, 1)])
    space = replace(SPACE, edges=solid_edges(apart))
    _, feasible = space.strokes(apart[None], torch.tensor([[0.0, 0.0, 0.1]]))
    assert not feasible.any()


def test_the_pusher_does_not_slip_between_sparse_particles():
    sparse = SQUARE * 3
    space = replace(SPACE, edges=solid_edges(sparse))
    between = torch.tensor([[0.0, 0.1, 0.1], [0.0, 0.2, 0.1], [0.0, -0.3, 0.1]])
    strokes, feasible = space.strokes(sparse.expand(3, -1, -1), between)
    assert feasible.all()
    assert (strokes[:, 0] < -0.15).all()


def test_costs():
    goal = SQUARE + torch.tensor([0.03, 0.04, 0.0])
    torch.testing.assert_close(make_cost("distance", goal, 36)(SQUARE[None]), torch.tensor([0.05]))
    shuffled = SQUARE[torch.randperm(36)]
    assert make_cost("chamfer", shuffled, 36)(SQUARE[None]).item() == pytest.approx(0, abs=1e-3)
    assert make_cost("chamfer", goal, 36)(SQUARE[None]).item() > 0.01
    with pytest.raises(DataError, match="do not correspond"):
        make_cost("distance", goal[:5], 36)
    with pytest.raises(DataError, match="no points"):
        make_cost("chamfer", goal[:0], 36)


@pytest.mark.parametrize("horizon", [1, 2])
def test_cem_finds_the_stroke_that_carries_the_object_to_its_goal(horizon):
    motion = torch.tensor([0.06 * horizon, -0.07 * horizon, 0.0])
    cost = make_cost("distance", SQUARE + motion, 36)
    plan = plan_strokes(
        SQUARE,
        carried,
        cost,
        SPACE,
        horizon=horizon,
        samples=200,
        iterations=8,
        elites=0.1,
        generator=torch.Generator(),
    )
    assert plan.cost < 0.01
    assert plan.strokes.shape == (horizon, 5)
    assert plan.predicted.shape == (horizon, 36, 3)


def test_a_plan_follows_from_its_seed():
    cost = make_cost("distance", SQUARE + 0.05, 36)

    def strokes(seed: int) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        return plan_strokes(
            SQUARE, carried, cost, SPACE, horizon=1, samples=20, iterations=2, elites=0.2, generator=generator
        ).strokes

    assert torch.equal(strokes(1), strokes(1))
    assert not torch.equal(strokes(1), strokes(2))


def test_no_feasible_stroke_is_an_error():
    with pytest.raises(DataError, match="no stroke touches"):
        plan_strokes(
            SQUARE + 5.0,
            carried,
            make_cost("distance", SQUARE, 36),
            SPACE,
            horizon=1,
            samples=20,
            iterations=2,
            elites=0.2,
            generator=torch.Generator(),
        )


def test_the_loop_stops_at_success_at_its_limit_and_before_the_first_stroke():
    goal = SQUARE + torch.tensor([0.2, 0.0, 0.0])
    cost = make_cost("distance", goal, 36)
    world = SQUARE.clone()

    def act(stroke: torch.Tensor) -> tuple[np.ndarray, bool]:
        nonlocal world
        world = carried(world[None], stroke[None])[0]
        return world.numpy(), False

    def make_plan(state: torch.Tensor):
        return plan_strokes(
            state, carried, cost, SPACE, horizon=1, samples=100, iterations=5, elites=0.1, generator=torch.Generator()
        )

    steps = list(run_episode(SQUARE.numpy(), make_plan, act, cost, strokes=10, success=0.02))
    assert 2 <= len(steps) <= 4
    assert steps[-1].distance < 0.02 <= steps[-2].distance
    assert len(list(run_episode(world.numpy(), make_plan, act, cost, strokes=10, success=0.02))) == 0
    world = SQUARE.clone()
    assert len(list(run_episode(SQUARE.numpy(), make_plan, act, cost, strokes=1, success=0.02))) == 1
