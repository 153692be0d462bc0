"""Every setting of a plan reaches what it is a setting of, and nothing that comes before that."""

import math

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import sure
from piegraph_cli.dynamics.params import PredictionParams
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK, PUSH, validated
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import CLEARANCE, DEPTH
from piegraph_cli.planning.question import chosen_particles
from piegraph_cli.planning.search import INFEASIBLE, Search
from piegraph_cli.stages.steps import make_environment
from tests import strokes as of_strokes
from tests.planning.table import ANYWHERE, SQUARE, Rehearsal, choose_modes, plan_stage, planner_of, space_of

BASE = {"samples": 12, "cem_iterations": 3, "strokes": 2, "converged": 0.0, "success": 1e-6}
MPPI = {"planner": "mppi"}
CHANGES = {
    "env": ("toy", "environment"),
    "options": ({"friction": 0.3}, "environment"),
    "daxbench_python": ("python3", "environment"),
    "daxbench_repo": ("repo", "environment"),
    "seed": (1, "start"),
    "fixed_goals": (True, "start"),
    "model": ("sms-no", "model"),
    "cost": ("chamfer", "costs"),
    "modes": (("pick",), "candidates"),
    "planner": ("mppi", "weights"),
    "horizon": (2, "candidates"),
    "samples": (13, "candidates"),
    "cem_iterations": (4, "iterations"),
    "converged": (1.0, "iterations"),
    "elites": (0.5, "weights"),
    "temperature": (0.05, "weights"),
    "noise": (0.3, "later"),
    "strokes": (3, "steps"),
    "state_noise": (0.01, "seen"),
    "success": (0.9, "steps"),
    "min_length": (0.05, "candidates"),
    "max_length": (0.1, "candidates"),
    "max_carry": (0.2, "candidates"),
    "pusher_radius": (0.02, "candidates"),
    "margin": (0.006, "candidates"),
    "workspace": ((-0.06, 0.45, -0.45, 0.45, -0.02, 0.35), "costs"),
    "keep_out": ("-0.45,-0.06,-0.45,0.45,0,0.1", "costs"),
    "retreat": (0.5, "costs"),
}
"""Another value of each setting, and what it is the first to change of what `observed` lists in order."""
OF_MODELS = dict.fromkeys(PredictionParams.model_fields, 0.5) | {"iterations": 3, "tension_only": True}
OF_THE_STAGE = {"state", "goal", "goal_pose", "goal_at", "episodes", "table", "frame", "cameras"}
OF_THE_PATH = {"approach_height", "speed"}
OF_CAMERAS = ("look", "accept", "keep", "sight")
"""Of what the planner knows the object by: tests/planning/test_seeing.py."""
OF_ERRORS = {"caution", "stop", "remember", "look_every"}
"""Of no effect on a model that is never wrong and not calibrated: `test_experience` has them."""
BASES = {"temperature": MPPI, "noise": MPPI}


def observed(**settings) -> dict[str, object]:
    """What planning two strokes goes through, from the environment to the strokes carried out."""
    with pytest.MonkeyPatch.context() as patch:
        rehearsal = Rehearsal(patch)
        episode, _ = rehearsal.play(**BASE | settings)
        ((name, particles, given),) = rehearsal.environments
        model = [
            (label, params.model_dump(include=set(PredictionParams.model_fields)))
            for label, _, _, params in rehearsal.made
        ]
        found: dict[str, object] = {
            "environment": (name, particles, given.options, given.daxbench_python, given.daxbench_repo),
            "start": (rehearsal.table.resets, episode.start.tolist()),
            "goal": episode.goal.tolist(),
            "model": model,
            "steps": len(episode.steps) if {"strokes", "success"} & set(settings) else 2,
        }
        if not episode.steps:
            return found
        looked = episode.steps[0].plan.candidates
        found |= {
            "seen": rehearsal.seen[0][0].tolist(),
            "candidates": of_strokes.as_numbers(looked.strokes)[0].tolist(),
            "costs": looked.costs[0].tolist(),
            "weights": looked.weights[0].tolist(),
            "iterations": int(looked.costs.isfinite().any(1).sum()),
            "later": str(of_strokes.as_numbers(looked.strokes)[1].tolist()),
        }
        return found


ORDER = [
    "environment",
    "start",
    "goal",
    "model",
    "steps",
    "seen",
    "candidates",
    "costs",
    "weights",
    "iterations",
    "later",
]


@pytest.mark.parametrize("field", [*CHANGES, *OF_MODELS])
def test_every_setting_changes_what_it_is_a_setting_of_and_nothing_before(field):
    assert {*CHANGES, *OF_MODELS, *OF_THE_STAGE, *OF_THE_PATH, *OF_ERRORS, *OF_CAMERAS} == set(PlanParams.model_fields)
    value, first = CHANGES.get(field, (OF_MODELS.get(field), "model"))
    base = BASES.get(field, {})
    before, after = observed(**base), observed(**base | {field: value})
    changed = [name for name in ORDER if before.get(name) != after.get(name)]
    assert changed[0] == first


def test_the_same_settings_plan_the_same():
    assert observed() == observed()


@pytest.fixture
def rehearsal(monkeypatch):
    return Rehearsal(monkeypatch)


def test_starts_goals_and_candidates_each_follow_their_own_number(rehearsal):
    """So every model meets the same starts and goals; a goal depends on the seed and its number alone."""

    def of(start, goal, seed=0):
        episode, _ = rehearsal.play(start, goal, **BASE | {"strokes": 1, "seed": seed})
        offset = (episode.goal - episode.start)[0]
        return episode.start, offset, of_strokes.as_numbers(episode.steps[0].plan.candidates.strokes[0])

    base, again, other_start, other_goal, other_seed = of(0, 0), of(0, 0), of(1, 0), of(0, 1), of(0, 0, seed=5)
    for one, two in zip(base, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.allclose(base[0], other_start[0])
    np.testing.assert_allclose(base[1], other_start[1], atol=1e-6)
    np.testing.assert_array_equal(base[0], other_goal[0])
    assert not np.allclose(base[1], other_goal[1])
    assert all(not np.allclose(one, two) for one, two in zip(base, other_seed, strict=True))


def test_the_planner_sees_particles_with_noise_anew_in_every_step_and_the_record_is_true(rehearsal):
    def off(noise: float) -> list[np.ndarray]:
        rehearsal.seen.clear()
        settings = BASE | {"strokes": 3, "cem_iterations": 1, "state_noise": noise}
        episode, _ = rehearsal.play(**settings)
        assert np.allclose(episode.steps[0].before, episode.start)
        assert [step.before.tolist() for step in episode.steps[1:]] == [
            step.after.tolist() for step in episode.steps[:-1]
        ]
        return [seen[0].numpy() - step.before for seen, step in zip(rehearsal.seen, episode.steps, strict=True)]

    assert all((error == 0).all() for error in off(0.0))
    errors = off(0.01)
    assert np.std(errors) == pytest.approx(0.01, rel=0.15)
    assert abs(np.mean(errors)) < 0.003
    assert not np.allclose(errors[0], errors[1])
    np.testing.assert_allclose(errors, np.array(off(0.02)) / 2, atol=1e-6)
    assert not np.allclose(errors, [[seen] for seen in off(0.0)])


def test_an_episode_keeps_what_was_planned_carried_out_and_reached(rehearsal):
    episode, last = rehearsal.play(**BASE | {"strokes": 3, "modes": ("pick",), "workspace": ANYWHERE})
    assert len(episode.steps) == len(rehearsal.table.actions) == 3
    for step, action in zip(episode.steps, rehearsal.table.actions, strict=True):
        stroke = step.plan.strokes[0]
        np.testing.assert_allclose(action["start"], of_strokes.start(stroke))
        np.testing.assert_allclose(action["end"], of_strokes.end(stroke))
        assert action["mode"] == PICK
        far = np.linalg.norm(step.after - episode.goal, axis=1).mean()
        assert step.distance == pytest.approx(far, rel=1e-5)
    assert [step.blocked for step in episode.steps] == [False, True, False]
    np.testing.assert_array_equal(last, episode.steps[-1].after)
    assert episode.end_distance == episode.steps[-1].distance
    assert episode.start_distance == pytest.approx(
        np.linalg.norm(episode.start - episode.goal, axis=1).mean(), rel=1e-5
    )
    assert min(step.distance for step in episode.steps) < episode.start_distance


def test_the_model_is_made_for_the_object_as_it_starts(rehearsal):
    episode, _ = rehearsal.play(**BASE)
    ((name, trained, rest, params),) = rehearsal.made
    assert (name, trained, params.env) == ("piegraph", None, "tblock")
    np.testing.assert_array_equal(rest, episode.start)


def test_success_ends_an_episode_before_its_strokes_are_spent(rehearsal):
    near = BASE | {"strokes": 8, "samples": 60, "success": 0.03}
    episode, _ = rehearsal.play(**near)
    assert 1 <= len(episode.steps) < 8
    assert episode.steps[-1].distance < 0.03
    assert all(step.distance >= 0.03 for step in episode.steps[:-1])
    assert rehearsal.play(**near | {"success": 1.0})[0].steps == []


def test_options_reach_the_environment():
    for friction in (0.3, 0.7):
        params = PlanParams(env="tblock", options={"friction": friction})
        assert make_environment("tblock", 8, params).options.friction == friction


WALL = np.stack([np.zeros(81), np.linspace(-0.1, 0.1, 81), np.full(81, 0.01)], 1).astype(np.float32)
"""Particles 2.5 mm apart in a line along y."""


def push_at(space, length: float, share: float = 0.0, heading: float = 0.0):
    """The stroke and whether it is feasible, against the wall."""
    proposal = torch.tensor([[PUSH, heading, share, length, 0.0]])
    strokes, feasible = space.strokes(torch.as_tensor(WALL)[None], proposal)
    return strokes[0], bool(feasible[0])


@pytest.mark.parametrize(("radius", "margin"), [(0.01, 0.0), (0.01, 0.002), (0.01, 0.015), (0.02, 0.002)])
def test_a_push_starts_clear_of_the_object_by_the_pusher_and_the_margin(radius, margin):
    stroke, feasible = push_at(space_of(WALL, pusher_radius=radius, margin=margin), 0.1)
    assert feasible
    first = -(radius + margin) - CLEARANCE
    np.testing.assert_allclose(of_strokes.start(stroke), [first, 0], atol=1e-5)
    np.testing.assert_allclose(of_strokes.end(stroke), [first + 0.1, 0], atol=1e-5)


@pytest.mark.parametrize("radius", [0.01, 0.02])
@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_a_push_is_feasible_once_it_goes_in_deep_enough(radius, margin):
    space = space_of(WALL, pusher_radius=radius, margin=margin)
    shortest = CLEARANCE + DEPTH * radius
    assert not push_at(space, shortest - 5e-4)[1]
    assert push_at(space, shortest + 5e-4)[1]


def test_a_push_that_ends_before_it_has_gone_in_is_refused_with_the_length_that_it_needs():
    with pytest.raises(UsageError, match=r"0\.0149 m at most") as refused:
        space_of(WALL, pusher_radius=0.01, max_length=0.0149, min_length=0.01)
    assert "more than 0.015" in str(refused.value.hint)
    assert space_of(WALL, (PICK,), max_length=0.0149, min_length=0.01).modes == (PICK,)


@pytest.mark.parametrize(("side", "reached"), [(0, -0.02), (1, 0.08), (2, -0.02), (3, 0.08)])
def test_a_stroke_starts_and_ends_inside_the_workspace(side, reached):
    """From -0.02 to 0.08 along x, then along y: each wall of the workspace stops one of its ends."""
    along_x = side < 2
    wall = WALL if along_x else WALL[:, [1, 0, 2]]
    proposal = torch.tensor([[PUSH, 0.0 if along_x else math.pi / 2, 0.0, 0.1, 0.0]])
    outwards = 1 if side % 2 else -1
    for room, fits in ((1e-3, True), (-1e-3, False)):
        box = list(ANYWHERE)
        box[side] = reached + outwards * room
        space = space_of(wall, margin=0.002, workspace=tuple(box))
        assert bool(space.strokes(torch.as_tensor(wall)[None], proposal)[1][0]) == fits


def test_samples_fill_the_ranges_that_the_settings_give():
    space = space_of(SQUARE, (PUSH, PICK), min_length=0.03, max_length=0.11, max_carry=0.2)
    found = space.sample((4000,), torch.Generator().manual_seed(0))
    pushes, picks = (found[found[:, 0] == m][:, 1:] for m in (PUSH, PICK))
    assert abs(len(pushes) - 2000) < 200
    wide = torch.tensor([[-math.pi, -1, 0.03, 0], [math.pi, 1, 0.11, 0]])
    for values, (low, high) in ((pushes, wide), (picks, torch.tensor([[-1, -1, -0.2, -0.2], [1, 1, 0.2, 0.2]]))):
        assert (values >= low).all()
        assert (values <= high).all()
        torch.testing.assert_close(values.amin(0), low, atol=0.02, rtol=0)
        torch.testing.assert_close(values.amax(0), high, atol=0.02, rtol=0)
        torch.testing.assert_close(values.mean(0), (low + high) / 2, atol=0.1, rtol=0)


def carried(positions, strokes):
    return positions + of_strokes.motion(strokes)[:, None]


def search(space, predict=carried, seed: int = 0, **settings):
    state = torch.as_tensor(SQUARE)
    cost = make_cost("distance", state + torch.tensor([0.08, 0.0, 0.0]), len(state))
    return Search(sure(predict), cost, space, PlanParams(**settings), torch.Generator().manual_seed(seed))(state)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_mppi_draws_around_its_mean_with_the_noise_it_is_given(noise):
    """Of picks, whose strokes show what was drawn: a share of 60 cm in either direction."""
    space = space_of(SQUARE, (PICK,), workspace=ANYWHERE)
    plan = search(space, samples=400, cem_iterations=4, planner="mppi", noise=noise, temperature=0.002)
    moves = of_strokes.motion(plan.candidates.strokes)[:, 1:, 0, :2]
    spread = moves[2:].std(1)
    torch.testing.assert_close(spread, torch.full_like(spread, noise * 0.6), rtol=0.15, atol=0)
    wide = search(space, samples=400, cem_iterations=4, planner="cem", converged=0.0)
    narrowing = of_strokes.motion(wide.candidates.strokes)[:, 1:, 0, :2].std(1).mean(1)
    assert (narrowing.diff() < 0).all(), "CEM fits the deviation"


def test_pushes_are_drawn_around_their_mean_with_the_noise_too():
    space = space_of(SQUARE, (PUSH,), workspace=ANYWHERE)
    plan = search(space, samples=400, cem_iterations=5, planner="mppi", noise=0.02, temperature=0.001)
    moves = of_strokes.motion(plan.candidates.strokes)[-1, 1:, 0]
    assert float(moves.norm(dim=-1).std()) == pytest.approx(0.02 * (0.14 - 0.02), rel=0.2)
    assert float(torch.atan2(moves[:, 1], moves[:, 0]).std()) == pytest.approx(0.02 * 2 * math.pi, rel=0.2)


@pytest.mark.parametrize("temperature", [0.002, 0.05])
def test_mppi_weighs_by_cost_over_temperature(temperature):
    space = space_of(SQUARE, (PICK,), workspace=ANYWHERE)
    plan = search(space, samples=30, cem_iterations=3, planner="mppi", temperature=temperature)
    looked = plan.candidates
    torch.testing.assert_close(looked.weights, torch.softmax(-looked.costs / temperature, 1))
    assert len(looked.costs) == int(looked.costs.isfinite().all(1).sum()) == 3, "it never ends early"


@pytest.mark.parametrize(("share", "samples", "count"), [(0.1, 40, 4), (0.25, 40, 10), (0.01, 40, 2), (1.0, 8, 8)])
def test_cem_weighs_its_elites_alike_and_no_others(share, samples, count):
    plan = search(
        space_of(SQUARE, (PICK,), workspace=ANYWHERE), elites=share, samples=samples, cem_iterations=2, converged=0
    )
    looked = plan.candidates
    for costs, weights in zip(looked.costs, looked.weights, strict=True):
        elites = costs.argsort()[:count]
        torch.testing.assert_close(weights[elites], torch.full((count,), 1 / count))
        assert float(weights.sum()) == pytest.approx(1)


def test_the_best_so_far_is_looked_at_again_and_is_the_plan():
    space = space_of(SQUARE, (PUSH, PICK), workspace=ANYWHERE)
    for planner_name in ("cem", "mppi"):
        plan = search(space, planner=planner_name, samples=15, cem_iterations=4, converged=0.0)
        looked = plan.candidates
        best = looked.costs[0].argmin()
        torch.testing.assert_close(
            of_strokes.as_numbers(looked.strokes)[1, 0],
            of_strokes.as_numbers(looked.strokes)[0, best],
            atol=1e-6,
            rtol=0,
        )
        assert (looked.costs.amin(1).diff() <= 1e-6).all()
        assert plan.cost == pytest.approx(float(looked.costs.min()))


def test_the_cost_of_a_plan_is_the_mean_over_its_horizon_and_misses_are_dear():
    space = space_of(SQUARE, (PICK,), workspace=ANYWHERE)
    plan = search(space, samples=10, cem_iterations=1, horizon=3)
    state = torch.as_tensor(SQUARE)
    cost = make_cost("distance", state + torch.tensor([0.08, 0.0, 0.0]), len(state))
    assert plan.cost == pytest.approx(float(cost(plan.predicted).mean()), rel=1e-5)
    strokes = of_strokes.motion(plan.strokes)
    torch.testing.assert_close(plan.predicted, state + strokes.cumsum(0)[:, None], atol=1e-6, rtol=0)
    tight = space_of(SQUARE, (PICK,), workspace=(-0.06, 0.06, -0.06, 0.06, -1, 1))
    looked = search(tight, samples=40, cem_iterations=1, horizon=2).candidates
    inside = [
        (points.abs() <= 0.06).all(-1) for points in (of_strokes.start(looked.strokes), of_strokes.end(looked.strokes))
    ]
    misses = (~(inside[0] & inside[1]))[0].sum(1)
    assert (looked.costs[0] // INFEASIBLE).tolist() == misses.tolist()


@pytest.mark.parametrize(
    ("asked", "learned", "known", "modes"),
    [
        ((), None, None, (PUSH, PICK)),
        ((), (PUSH,), None, (PUSH,)),
        ((), (PUSH, PICK), (PICK,), (PICK,)),
        ((), None, (PUSH,), (PUSH,)),
        (("pick",), (PUSH, PICK), (PUSH, PICK), (PICK,)),
        (("pick", "push"), None, None, (PICK, PUSH)),
    ],
)
def test_the_modes_planned_with_are_those_asked_for_or_those_that_all_know(asked, learned, known, modes):
    assert choose_modes(asked, learned, known) == modes


def test_modes_that_the_model_or_the_environment_lacks_are_refused():
    with pytest.raises(UsageError, match="no pick can be planned: the model was trained on push only"):
        choose_modes(("pick",), (PUSH,), (PUSH, PICK))
    with pytest.raises(UsageError, match="no push can be planned: tblock knows pick only"):
        choose_modes(("push",), (PUSH, PICK), (PICK,))
    with pytest.raises(UsageError, match="trained on pick strokes, which tblock does not know"):
        choose_modes((), (PICK,), (PUSH,))


@pytest.mark.parametrize(
    ("kind", "corresponds", "means"),
    [
        ("auto", True, "distance"),
        ("auto", False, "emd"),
        ("distance", False, "distance"),
        ("chamfer", True, "chamfer"),
        ("emd", True, "emd"),
    ],
)
def test_the_cost_is_the_one_asked_for_or_what_the_goal_allows(kind, corresponds, means):
    goal = SQUARE[::-1].copy() + np.array([0.03, 0, 0], np.float32)
    cost, _ = planner_of(SQUARE, goal, corresponds, cost=kind, model="static")
    state = torch.as_tensor(SQUARE)[None]
    expected = {
        name: float(make_cost(name, torch.as_tensor(goal), 25)(state)[0]) for name in ("distance", "chamfer", "emd")
    }
    assert len({round(value, 4) for value in expected.values()}) == 3
    assert float(cost(state)[0]) == pytest.approx(expected[means])


def test_greedy_picks_the_worst_particle_and_needs_to_know_where_it_belongs():
    goal = SQUARE.copy()
    goal[3, :2] += 0.1
    goal[7, :2] -= 0.2
    _, make_plan = planner_of(SQUARE, goal, planner="greedy", model="static")
    plan = make_plan(torch.as_tensor(SQUARE), ())
    np.testing.assert_allclose(of_strokes.start(plan.strokes)[0], SQUARE[7, :2])
    np.testing.assert_allclose(of_strokes.end(plan.strokes)[0], goal[7, :2])
    for refused in ({"corresponds": False}, {"known": (PUSH,)}):
        with pytest.raises(UsageError, match="greedy planner picks"):
            planner_of(SQUARE, goal, planner="greedy", model="static", **refused)


def test_a_goal_outside_the_workspace_is_refused():
    for moved in ([0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]):
        with pytest.raises(DataError, match="the goal lies around"):
            planner_of(SQUARE, SQUARE + np.array([*moved, 0], np.float32), model="static")


def test_every_episode_has_its_own_start_and_goal(rehearsal):
    found = plan_stage(**BASE | {"env": "tblock", "episodes": 3, "strokes": 1, "seed": 6})
    assert found["episode"].tolist() == [0, 1, 2]
    assert found["goal"].shape == (3, 25, 3)
    assert len(set(rehearsal.table.resets)) == 3
    assert len({goal.tobytes() for goal in found["goal"]}) == 3
    assert found["seed"].tolist() == [6, 6, 6]
    np.testing.assert_allclose(found["distance"], found["end_distance"])


def test_a_goal_may_be_a_motion_or_a_file(rehearsal, tmp_path):
    few = BASE | {"env": "tblock", "strokes": 1}
    (found,) = plan_stage(**few, goal_pose=(0.1, -0.05, math.pi / 2))["goal"]
    start = SQUARE + np.array([*np.random.default_rng(rehearsal.table.resets[0]).uniform(-0.05, 0.05, 2), 0])
    middle = start.mean(0)
    turned = np.stack([-(start - middle)[:, 1], (start - middle)[:, 0]], 1) + middle[:2] + [0.1, -0.05]
    np.testing.assert_allclose(found[:, :2], turned, atol=1e-6)
    np.testing.assert_allclose(found[:, 2], 0.01)
    frames = np.stack([SQUARE[:9] + 0.01 * k for k in range(3)]).astype(np.float32)
    np.savez(tmp_path / "goals.npz", frames)
    for text, frame in (
        (str(tmp_path / "goals.npz"), 2),
        (f"{tmp_path / 'goals.npz'}:1", 1),
        (f"{tmp_path / 'goals.npz'}:-3", 0),
    ):
        np.testing.assert_allclose(plan_stage(**few, goal=text)["goal"][0], frames[frame])
    for wrong in ({"env": None}, {"goal": "a.npz", "goal_pose": (0, 0, 1)}):
        with pytest.raises(UsageError, match="give"):
            plan_stage(**few | wrong)
    with pytest.raises(UsageError, match="--state needs a goal"):
        plan_stage(state=tmp_path / "goals.npz")


@pytest.mark.parametrize(
    ("setting", "value"), [("pusher_radius", 10.0), ("max_length", 140.0), ("keep_out", "300,500,-100,100,0,200")]
)
def test_lengths_in_millimetres_are_refused_with_what_they_are_in_metres(setting, value):
    first = 300 if setting == "keep_out" else value
    with pytest.raises(UsageError, match=f"{setting} is in m: {first:g} mm are {first / 1000:g}"):
        validated(PlanParams, {setting: value}, "plan", "", "")


def test_too_few_numbers_are_counted():
    with pytest.raises(UsageError, match=r"plan\.goal_pose: has 2 numbers, more are needed"):
        validated(PlanParams, {"goal_pose": "0.1,0"}, "plan", "", "")


@pytest.mark.parametrize(("height", "refused"), [(0.7, True), (-0.7, True), (0.08, False)])
def test_an_object_far_from_the_table_is_not_planned_for(height, refused):
    cloud = np.random.default_rng(0).uniform(0, 0.03, (200, 3)).astype(np.float32) + np.float32([0, 0, height])
    if not refused:
        assert "80 mm above the table" in chosen_particles(cloud, None, PlanParams(), None, False)[1][0]
        return
    with pytest.raises(DataError, match="the table, where no stroke would touch it"):
        chosen_particles(cloud, None, PlanParams(), None, False)


def test_true_is_no_number():
    with pytest.raises(UsageError, match="strokes is true: give a number"):
        validated(PlanParams, {"strokes": True}, "plan", "", "")
