"""Proposals touch the object, costs measure what they say, CEM finds known optima, the loop stops when it is done."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import sure
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.experience import Tried
from piegraph_cli.planning.greedy import put_worst_right
from piegraph_cli.planning.mpc import run_episode
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import CLEARANCE, StrokeSpace, _deviation, _first_contacts, solid_edges
from piegraph_cli.planning.search import INFEASIBLE, Search

SQUARE = torch.tensor([[x, y, 0.0] for x in np.linspace(-0.05, 0.05, 6) for y in np.linspace(-0.05, 0.05, 6)]).float()
SPACE = StrokeSpace((PUSH,), solid_edges(SQUARE), 0.02, 0.14, 0.3, 0.01, 0.002, (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35))
PICKS = replace(SPACE, modes=(PICK,))
BOTH = replace(SPACE, modes=(PUSH, PICK))


def carried(positions: torch.Tensor, strokes: Strokes) -> torch.Tensor:
    """Everything moves along with the stroke."""
    motion = torch.nn.functional.pad(strokes.along, (0, 1))
    return positions + motion[:, None]


def test_a_push_starts_just_off_the_object_and_heads_where_it_says():
    proposal = torch.tensor([[PUSH, 0.0, 0.0, 0.1, 0.0], [PUSH, math.pi / 2, 1.0, 0.05, 0.0]])
    strokes, feasible = SPACE.strokes(SQUARE.expand(2, -1, -1), proposal)
    assert feasible.all()
    assert strokes.start[0, 0].item() == pytest.approx(-0.05 - SPACE.pusher_radius - SPACE.margin - CLEARANCE, abs=1e-3)
    torch.testing.assert_close(strokes.along[0, 0], torch.tensor(0.1))
    torch.testing.assert_close(strokes.ends[1, :, 0], torch.tensor([-0.05, -0.05]))
    distances = (SQUARE[:, :2] - strokes.start[0]).norm(dim=-1)
    assert distances.min() > SPACE.pusher_radius


def test_a_push_starts_off_an_object_that_is_thicker_than_its_particles_show():
    rope = torch.stack([torch.linspace(-0.2, 0.2, 50), torch.zeros(50), torch.full((50,), 0.008)], 1)
    space = replace(SPACE, edges=solid_edges(rope), margin=0.01)
    proposals = space.sample((500,), torch.Generator().manual_seed(0))
    strokes, feasible = space.strokes(rope.expand(500, -1, -1), proposals)
    gaps = (strokes[feasible].start[:, None] - rope[None, :, :2]).norm(dim=-1).amin(1)
    assert feasible.sum() > 300
    assert gaps.min() >= space.pusher_radius + 0.008, "oblique pushes start off the rope too"


def test_a_push_that_grazes_is_infeasible_until_it_goes_in():
    side = torch.stack([torch.linspace(0, 0.4, 81), torch.zeros(81), torch.zeros(81)], 1)
    space = replace(SPACE, edges=solid_edges(side))
    lengths = torch.tensor([0.02, 0.05, 0.1, 0.2, 0.3])
    proposals = torch.nn.functional.pad(lengths[:, None], (3, 1))
    proposals[:, 1], proposals[:, 2] = -math.radians(3), 0.5
    strokes, feasible = space.strokes(side.expand(5, -1, -1), proposals)
    into = space.pusher_radius + space.margin - strokes.end[:, 1]
    assert (strokes.start[:, 1] > 0.012).all(), "from above"
    assert feasible.tolist() == (into > 0.007).tolist() == [False, False, False, True, True]


def test_strokes_out_of_the_workspace_are_infeasible():
    _, feasible = SPACE.strokes(
        (SQUARE + torch.tensor([0.45, 0.0, 0.0]))[None], torch.tensor([[PUSH, 0.0, 0.0, 0.1, 0.0]])
    )
    assert not feasible.any()


def test_a_gap_in_the_object_may_be_missed():
    apart = torch.cat([SQUARE + torch.tensor([0.0, s * 0.2, 0.0]) for s in (-1, 1)])
    space = replace(SPACE, edges=solid_edges(apart))
    _, feasible = space.strokes(apart[None], torch.tensor([[PUSH, 0.0, 0.0, 0.1, 0.0]]))
    assert not feasible.any()


def test_the_pusher_does_not_slip_between_sparse_particles():
    sparse = SQUARE * 3
    space = replace(SPACE, edges=solid_edges(sparse))
    between = torch.tensor([[PUSH, 0.0, share, 0.1, 0.0] for share in (0.1, 0.2, -0.3)])
    strokes, feasible = space.strokes(sparse.expand(3, -1, -1), between)
    assert feasible.all()
    assert (strokes.start[:, 0] < -0.15).all()


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


def test_the_earth_movers_distance_matches_particles_one_to_one():
    goal = SQUARE + torch.tensor([0.03, 0.04, 0.0])
    shuffled = goal[torch.randperm(36, generator=torch.Generator().manual_seed(0))]
    assert make_cost("emd", shuffled, 36)(SQUARE[None]).item() <= 0.05 + 1e-6
    assert make_cost("emd", SQUARE.flip(0), 36)(SQUARE[None]).item() == pytest.approx(0, abs=1e-4)
    # all particles on one goal particle: near for the chamfer distance one way, far for an assignment
    heap = SQUARE[:1].expand(36, -1)
    assert make_cost("emd", SQUARE, 36)(heap[None]).item() == pytest.approx(
        SQUARE.sub(heap[0]).norm(dim=1).mean().item()
    )
    with pytest.raises(DataError, match="fewer than"):
        make_cost("emd", goal[:5], 36)


def search(state, predict, cost, space, seed: int = 0, **settings):
    return Search(sure(predict), cost, space, PlanParams(**settings), torch.Generator().manual_seed(seed))(state)


@pytest.mark.parametrize("horizon", [1, 2])
@pytest.mark.parametrize("planner", ["cem", "mppi"])
@pytest.mark.parametrize("space", [SPACE, PICKS, BOTH])
def test_a_search_finds_the_strokes_that_carry_the_object_to_its_goal(space, planner, horizon):
    motion = torch.tensor([0.06 * horizon, -0.07 * horizon, 0.0])
    cost = make_cost("distance", SQUARE + motion, 36)
    plan = search(
        SQUARE, carried, cost, space, planner=planner, horizon=horizon, samples=200, cem_iterations=10, noise=0.05
    )
    along = cost(plan.predicted)
    assert along[-1] < 0.02
    assert along[0] < 0.8 * cost(SQUARE[None])[0], "the first stroke goes there as well"
    assert plan.cost == pytest.approx(along.mean().item(), abs=1e-6)
    assert plan.strokes.mode.shape == (horizon,)
    assert plan.predicted.shape == (horizon, 36, 3)
    looked = plan.candidates
    assert set(looked.strokes[looked.costs.isfinite()].mode.unique().tolist()) == set(space.modes)


def test_the_mode_that_works_is_chosen():
    def pushed_only(positions, strokes):
        return torch.where((strokes.mode == PUSH)[:, None, None], carried(positions, strokes), positions)

    cost = make_cost("distance", SQUARE + torch.tensor([0.08, 0.0, 0.0]), 36)
    plan = search(SQUARE, pushed_only, cost, BOTH, samples=60)
    assert plan.strokes.mode[0] == PUSH
    modes = plan.candidates.strokes.mode[:, :, 0]
    assert all(0.3 < (drawn == PICK).float().mean() < 0.7 for drawn in modes), "the other goes on"


def test_what_was_looked_at_is_kept():
    cost = make_cost("distance", SQUARE + 0.05, 36)
    plan = search(SQUARE, carried, cost, SPACE, samples=20, cem_iterations=3, elites=0.2, horizon=2)
    seen = plan.candidates
    assert seen.strokes.mode.shape == (3, 20, 2)
    assert seen.costs.min().item() == pytest.approx(plan.cost)
    assert ((seen.weights > 0).sum(1) == 4).all(), "a fifth of the candidates are elites"
    torch.testing.assert_close(seen.weights.sum(1), torch.ones(3))
    worst_elite = torch.where(seen.weights > 0, seen.costs, 0).amax(1)
    assert (torch.where(seen.weights > 0, torch.inf, seen.costs).amin(1) >= worst_elite).all()


def test_picks_start_at_a_particle_and_carry_far_enough():
    generator = torch.Generator().manual_seed(0)
    proposals = PICKS.sample((300,), generator)
    proposals[0, 3:] = 0.0
    strokes, _ = PICKS.strokes(SQUARE.expand(300, -1, -1), proposals)
    apart = (strokes.start[:, None] - SQUARE[None, :, :2]).norm(dim=-1).amin(1)
    assert apart.max() < 1e-6
    assert strokes.length.min() >= PICKS.min_length - 1e-6
    assert (strokes.mode == PICK).all()
    grasped = (strokes.start[:, None] - SQUARE[None, :, :2]).norm(dim=-1).argmin(1)
    assert len(grasped.unique()) > 25, "all of the object can be grasped"


def test_the_greedy_planner_carries_the_worst_particle_to_its_place():
    goal = SQUARE.clone()
    goal[7, :2] += torch.tensor([0.2, 0.1])
    cost = make_cost("distance", goal, 36)
    plan = put_worst_right(SQUARE, goal, cost, PICKS)
    torch.testing.assert_close(plan.strokes[0].ends, torch.stack([SQUARE[7, :2], goal[7, :2]]))
    assert plan.strokes.mode[0] == PICK
    x, y = (SQUARE[7, :2] + goal[7, :2]).tolist()
    between = (x / 2 - 0.01, x / 2 + 0.01, y / 2 - 0.01, y / 2 + 0.01, 0.0, 0.3)
    walled = replace(PICKS, keep_out=(between,))
    assert put_worst_right(SQUARE, goal, cost, walled) is None
    assert put_worst_right(goal, goal, cost, PICKS) is None, "all is in place"
    goal[30, :2] += torch.tensor([0.02, -0.1])
    second = put_worst_right(SQUARE, goal, cost, walled)
    torch.testing.assert_close(second.strokes[0].ends, torch.stack([SQUARE[30, :2], goal[30, :2]]))


def test_cem_ends_when_its_elites_are_as_good_as_the_best():
    cost = make_cost("distance", SQUARE + torch.tensor([0.06, 0.02, 0.0]), 36)
    full, early = (search(SQUARE, carried, cost, SPACE, samples=100, cem_iterations=30, converged=c) for c in (0, 1e-3))
    assert full.candidates.costs.isfinite().all()
    count = int(early.candidates.costs.isfinite().all(1).sum())
    assert 1 < count < 30
    torch.testing.assert_close(early.candidates.costs[:count], full.candidates.costs[:count])
    assert early.candidates.costs[count:].isnan().all()
    assert not early.candidates.weights[count:].any()
    assert early.cost < full.cost + 1e-3
    elites = early.candidates.weights > 0
    assert float(early.candidates.costs[elites][-10:].max()) - early.cost < 1e-3
    assert search(SQUARE + 5.0, carried, cost, SPACE, samples=20, converged=1.0) is None
    picks = search(SQUARE, carried, cost, PICKS, samples=100, cem_iterations=30, converged=1e-3).candidates
    spared = picks.costs.isnan()
    assert spared.any()
    assert not picks.strokes[spared].mode.any()
    assert picks.strokes[spared].ends.isnan().all()


def test_the_deviation_is_that_of_the_elites_and_never_nothing():
    values = torch.tensor([[1.0, 2.0, 3.0, 4.0], [3.0, 2.0, 3.0, 4.0], [9.0, 9.0, 9.0, 9.0]])
    weight = torch.tensor([[0.5], [0.5], [0.0]])
    found = _deviation(values, weight, (weight * values).sum(0))
    torch.testing.assert_close(found, torch.tensor([math.sqrt(2) + 1e-4, 1e-4, 1e-4, 1e-4]))
    alone = _deviation(values, torch.tensor([[0.0], [1.0], [0.0]]), values[1])
    torch.testing.assert_close(alone, torch.full((4,), 1e-4))


@pytest.mark.parametrize("planner", ["cem", "mppi"])
def test_a_search_goes_on_while_nothing_is_feasible(planner):
    """Candidates that all miss agree with each other, and not on a plan."""

    class Lucky:
        """At first every stroke misses; what is drawn next does not."""

        modes = (PUSH,)

        def sample(self, shape, generator):
            return torch.zeros(*shape, 5)

        def refit(self, proposals, weights, noise, count, generator):
            return torch.ones(count, proposals.shape[1], 5)

        def strokes(self, positions, proposals):
            start = torch.zeros(len(positions), 2)
            return Strokes.of(start, start + 0.1, PUSH), proposals[:, 0] > 0

    params = PlanParams(samples=8, cem_iterations=3, planner=planner, converged=1.0)
    cost, generator = make_cost("distance", SQUARE, 36), torch.Generator().manual_seed(0)
    plan = Search(sure(carried), cost, Lucky(), params, generator)(SQUARE)
    assert plan is not None
    assert plan.cost == pytest.approx(0.1 * math.sqrt(2), rel=1e-4)


@pytest.mark.parametrize("planner", ["cem", "mppi"])
def test_picks_are_sought_on_although_most_harm_where_pushes_change_nothing(planner):
    """The object is carried as far as the pick goes, and pushes leave it: 2 cm off, one pick in three hundred helps."""

    def foresee(positions, strokes):
        return (
            positions + torch.nn.functional.pad(strokes.along, (0, 1))[:, None] * (strokes.mode == PICK)[:, None, None]
        )

    params = PlanParams(samples=100, cem_iterations=6, planner=planner, temperature=0.002, noise=0.05, min_length=0.005)
    cost, generator = (
        make_cost("distance", SQUARE + torch.tensor([0.02, 0.01, 0.0]), 36),
        torch.Generator().manual_seed(0),
    )
    plan = Search(sure(foresee), cost, replace(BOTH, min_length=0.005), params, generator)(SQUARE)
    assert int(plan.strokes.mode[0]) == PICK
    assert plan.cost < 0.01
    first = plan.candidates.strokes.mode[:, :, 0]
    assert all(30 < int((modes == PICK).sum()) < 70 for modes in first)


def test_layers_of_a_folded_object_are_as_far_apart_as_they_are():
    """The spacing is that in space: from above, the particles of two layers lie on each other."""
    upper = SQUARE + torch.tensor([0.0005, 0.0, 0.01])
    folded = torch.cat([SQUARE, upper])
    edges = {tuple(edge) for edge in solid_edges(folded).tolist()}
    assert (0, 36) in edges
    beside = {(k, k + 1) for k in range(5)}
    assert beside <= edges
    assert all(0 <= a < b < 72 for a, b in edges)
    first, second = SQUARE[solid_edges(SQUARE)].unbind(1)
    assert 0.039 < float((first - second).norm(dim=-1).max()) < 0.041, "up to twice the spacing"
    assert len(solid_edges(SQUARE[:1])) == 0


def test_a_plan_follows_from_its_seed():
    cost = make_cost("distance", SQUARE + 0.05, 36)
    first, again, other = (
        search(SQUARE, carried, cost, SPACE, seed, samples=20).strokes.packed() for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_stroke_that_cannot_be_carried_out_is_never_chosen():
    assert search(SQUARE + 5.0, carried, make_cost("distance", SQUARE, 36), SPACE, samples=20) is None
    # the goal is beyond the workspace: the best that stays inside is taken
    goal = SQUARE + torch.tensor([0.5, 0.0, 0.0])
    edge = SQUARE + torch.tensor([0.3, 0.0, 0.0])
    plan = search(edge, carried, make_cost("distance", goal, 36), BOTH, samples=100)
    assert plan.cost < INFEASIBLE
    assert plan.strokes[0].ends.abs().max() <= 0.45


def test_the_loop_stops_at_success_at_its_limit_before_the_first_stroke_and_without_a_plan():
    goal = SQUARE + torch.tensor([0.2, 0.0, 0.0])
    cost = make_cost("distance", goal, 36)
    world = SQUARE.clone()

    def act(stroke: Strokes) -> tuple[np.ndarray, bool]:
        nonlocal world
        world = carried(world[None], Strokes.stack([stroke]))[0]
        return world.numpy(), False

    def make_plan(state: torch.Tensor, tried: Sequence[Tried]):
        return search(state, carried, cost, SPACE)

    def play(begin: torch.Tensor, plan=make_plan, strokes: int = 10):
        return run_episode(begin.numpy(), plan, act, cost, strokes=strokes, success=0.02)

    steps, ending = play(SQUARE)
    assert 2 <= len(steps) <= 4
    assert steps[-1].distance < 0.02 <= steps[-2].distance
    assert ending == "reached"
    for step in steps:  # each keeps what was predicted for itself
        np.testing.assert_allclose(step.plan.predicted[0], step.after, atol=1e-6)
    assert play(world) == ([], "reached")
    world = SQUARE.clone()
    steps, ending = play(SQUARE, strokes=1)
    assert (len(steps), ending) == (1, "strokes spent")
    assert play(SQUARE, lambda *_: None) == ([], "no stroke is possible")


def test_contacts_in_parts_are_those_of_all_at_once():
    """To the last bit, for one state and for a state of each candidate: the root that nobody asks for changes nothing."""
    generator = torch.Generator().manual_seed(0)
    rest = torch.rand(30, 3, generator=generator) * 0.2
    space = StrokeSpace((PUSH,), solid_edges(rest), 0.02, 0.14, 0.3, 0.01, 0.002, (-1, 1, -1, 1, 0, 1))
    for positions in (rest.expand(150, -1, -1), rest + 0.01 * torch.randn(150, 30, 3, generator=generator)):
        numbers = space.sample((150,), generator)[:, 1:]
        whole = space._pushes(positions, numbers)
        for first in range(0, 150, 50):
            part = space._pushes(positions[first : first + 50], numbers[first : first + 50])
            assert all(torch.equal(a[first : first + 50], b) for a, b in zip(whole, part, strict=True))
        depth, apart = torch.randn(2, 150, 90, generator=generator).unbind()
        apart = apart.square() * 1e-3
        apart[:, ::7] = space._reaches[0]  # met by a hair: a miss
        reach = space._reaches[:, None, None] - apart
        plain = torch.where(reach > 0, depth - reach.clamp(min=0).sqrt(), torch.inf).amin(-1)
        assert torch.equal(_first_contacts(depth, apart, space._reaches), plain)
