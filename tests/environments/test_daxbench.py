"""DaXBench as an environment: axes, scale, strokes and states, through the real child on a stand-in for DaXBench."""

import sys
import warnings

import numpy as np
import pytest
import torch

pytest.importorskip("gymnasium", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from daxbench_stand_in import PUSH_UP, REPO, make_daxbench
from gymnasium.utils.env_checker import check_env
from torch.nn.functional import pad

from piegraph_cli import environments
from piegraph_cli.dynamics.cutting import cut_strokes, frame_pairs
from piegraph_cli.dynamics.models import sure
from piegraph_cli.environments import daxbench, daxbench_child
from piegraph_cli.environments.params import VARIABLES
from piegraph_cli.environments.recording import simulate_tracks
from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.params import PUSH
from piegraph_cli.planning import planner
from piegraph_cli.planning.episode import play, tool_of
from piegraph_cli.planning.goals import Goal
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Tool, pusher_radius, stroke_space


@pytest.fixture(scope="module")
def running():
    envs = [make_daxbench("daxbench-rope"), make_daxbench("daxbench-tshirt")]
    yield envs
    for env in envs:
        env.close()


@pytest.fixture
def rope(running):
    running[0].reset(seed=1)
    return running[0]


@pytest.fixture
def tshirt(running):
    running[1].reset(seed=1)
    return running[1]


def test_passes_gymnasiums_checker(rope):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(rope)


def test_axes_turn_to_z_up_and_keep_right_handedness():
    frame = daxbench.Frame(scale=2.0, table=0.25)
    np.testing.assert_allclose(frame.to_world(np.array([0.6, 0.35, 0.8])), [0.2, -0.6, 0.2], atol=1e-12)
    axes = frame.to_world(np.eye(3)) - frame.to_world(np.zeros(3))
    assert np.linalg.det(axes / 2.0) == pytest.approx(1.0)
    point = np.array([0.13, -0.07])
    back = frame.to_world(np.array(frame.to_daxbench(point)))
    np.testing.assert_allclose(back[:2], point, atol=1e-12)


def test_objects_have_our_size_and_lie_on_the_table(rope, tshirt):
    assert np.ptp(rope._shape[:, 0]) == pytest.approx(0.4, abs=0.05)  # two random pushes bent it
    assert max(np.ptp(tshirt._shape[:, :2], axis=0)) == pytest.approx(0.3, abs=1e-6)
    for env in (rope, tshirt):
        particles = env.particles()
        assert particles.shape == (50, 3)
        assert particles.dtype == np.float32
        assert particles[:, 2].min() == pytest.approx(0.0, abs=1e-6)
        assert particles[:, 2].max() < 0.02
    assert rope.pusher_radius == pytest.approx(0.015 * 1.6, rel=1e-6)


def test_pushes_are_planned_for_its_pusher(rope):
    """Unlike those for a pusher of 10 mm, they start off all of its particles, not just off the 50 that are seen."""
    state, inside = torch.as_tensor(rope.particles()), []
    for tool in (Tool((PUSH,)), tool_of(rope)):
        space = stroke_space(state, PlanParams(), (PUSH,), pusher_radius(PlanParams(), tool))
        proposals = space.sample((500,), torch.Generator().manual_seed(0))
        strokes, feasible = space.strokes(state.expand(500, -1, -1), proposals)
        starts = strokes.start[feasible].numpy()
        gaps = np.linalg.norm(starts[:, None] - rope._shape[None, :, :2], axis=-1).min(1)
        inside.append((gaps < rope.pusher_radius).mean())
    assert inside[0] > 0.95
    assert inside[1] < 0.05


def test_a_push_moves_the_rope_the_way_it_goes(rope):
    before = rope.particles()
    after, _, _, _, info = rope.step(PUSH_UP)
    np.testing.assert_allclose(info["pusher"][[0, -1], :2], [PUSH_UP["start"], PUSH_UP["end"]], atol=1e-6)
    moved = np.linalg.norm(after - before, axis=1) > 0.01
    assert 0 < moved.sum() < 25
    assert np.abs(before[moved, 0] - 0.05).max() < 0.015 * 1.6 + 0.01
    # the pusher's front ends 24 mm beyond its middle, and what it took along coasts on for a thirtieth of the stroke
    assert 0.06 < after[moved, 1].min() <= after[moved, 1].max() < 0.06 + 0.024 + 2 * 0.21 / 30
    np.testing.assert_allclose(after[moved, 0], before[moved, 0], atol=1e-5)
    assert (after[~moved] == before[~moved]).all()


def test_strokes_end_at_rest(rope, tshirt):
    rope.step(PUSH_UP)
    assert np.abs(rope.get_state()["v"]).max() < daxbench_child.STILL
    start = tshirt.particles()[7, :2]
    info = tshirt.step({"start": start, "end": start * 0.5, "mode": 1})[4]
    assert info["frames"][-2][:, 2].max() > 0.01  # DaXBench lets go in the air
    assert info["frames"][-1][:, 2].max() < 1e-6


def test_a_pick_carries_what_it_grasps(tshirt):
    start, before = tshirt.particles()[7, :2], tshirt.particles()
    after, _, _, _, info = tshirt.step({"start": start, "end": start + np.array([0.05, 0.08]), "mode": 1})
    assert info["grasped"]
    np.testing.assert_allclose(after[7, :2] - before[7, :2], [0.05, 0.08], atol=5e-3)
    assert info["pusher"][:, 2].max() == pytest.approx(0.06 * 0.6, abs=1e-3)
    np.testing.assert_allclose(info["pusher"][[0, -1], :2], [start, start + np.array([0.05, 0.08])], atol=1e-6)
    missed = tshirt.step({"start": [0.28, 0.28], "end": [0.2, 0.28], "mode": 1})
    assert not missed[4]["grasped"]
    np.testing.assert_array_equal(missed[0], after)


def test_particles_stay_material_points_whatever_the_seed(rope):
    first = rope.particles()
    nodes = [int(np.abs(rope._shape - p).sum(1).argmin()) for p in first]
    rope.reset(seed=9)
    assert not np.array_equal(rope.particles(), first)
    np.testing.assert_array_equal(rope.particles(), rope._shape[nodes])


def test_same_seed_same_bits(rope):
    first, second = (simulate_tracks(rope, seed=5, strokes=3) for _ in range(2))
    assert all(np.array_equal(first[name], second[name]) for name in first)


def test_states_come_back_bit_for_bit_also_in_another_process(rope):
    for _ in range(3):  # as many steps as would make DaXBench start over, with the settling ones
        rope.step(PUSH_UP)
    state, expected = rope.get_state(), rope.particles()
    after = rope.step({"start": [0.0, 0.2], "end": [0.02, -0.1], "mode": 0})[0]
    other = make_daxbench("daxbench-rope")
    for env in (rope, other):
        env.reset(seed=8)
        env.set_state(state)
        assert np.array_equal(env.particles(), expected)
        again = env.get_state()
        assert all(np.array_equal(again[name], state[name]) for name in state)
        assert np.array_equal(env.step({"start": [0.0, 0.2], "end": [0.02, -0.1], "mode": 0})[0], after)
    other.close()


def test_more_steps_than_daxbench_allows_do_not_start_over(rope):
    for _ in range(8):
        before = rope.particles()
        after = rope.step({"start": [0.3, 0.3], "end": [0.3, 0.4], "mode": 0})[0]
        assert np.array_equal(after, before)


def test_a_state_that_is_not_its_own_is_refused(rope):
    state, before = rope.get_state(), rope.particles()
    for wrong, reason in [
        ({"x": state["x"]}, "missing"),
        (state | {"v": state["v"] * np.nan}, "not finite"),
        (state | {"v": state["v"][:, :-1]}, "its v is"),
    ]:
        with pytest.raises(DataError, match=reason):
            rope.set_state(wrong)
    assert np.array_equal(rope.particles(), before)


def test_goals_are_made_by_strokes_and_leave_the_state(tshirt, rope):
    for env in (tshirt, rope):
        state = env.get_state()
        goal = env.goal(np.random.default_rng(3))
        assert goal.shape == (50, 3)
        assert np.linalg.norm(goal - env.particles(), axis=1).max() > 0.01
        assert all(np.array_equal(array, state[name]) for name, array in env.get_state().items())


@pytest.mark.parametrize("name", ["daxbench-rope", "daxbench-tshirt"])
def test_tracks_of_random_strokes_teach(name):
    env = make_daxbench(name)
    tracks = simulate_tracks(env, seed=2, strokes=4)
    env.close()
    strokes = cut_strokes(tracks["end_effector"], tracks["contact"], 0.01, 0.025).strokes
    assert len(strokes) == 4
    for first, last in strokes:
        assert len(frame_pairs(first, last, tracks["end_effector"], 2)) >= 1
    moved = [np.linalg.norm(tracks["positions"][b] - tracks["positions"][a], axis=1).max() for a, b in strokes]
    assert min(moved) > 0.005
    assert np.abs(tracks["positions"][..., :2]).max() < 0.4


def test_random_picks_stay_in_daxbenchs_box(tshirt):
    rng = np.random.default_rng(0)
    ends = np.array([tshirt.sample_stroke(rng)["end"] for _ in range(200)])
    assert 0.25 < np.abs(ends).max() <= 0.29


def test_a_diverged_simulation_is_an_error_and_the_state_stays(monkeypatch):
    monkeypatch.setenv("FAKE_DAXBENCH", "nan")
    env = make_daxbench("daxbench-rope")
    env.reset(seed=1)
    env.step(PUSH_UP)
    state, particles = env.get_state(), env.particles()
    with pytest.raises(DataError, match="diverged"):
        env.step({"start": [0.05, -0.3], "end": [0.05, 0.1], "mode": 0})
    assert np.array_equal(env.particles(), particles)
    assert all(np.array_equal(array, state[name]) for name, array in env.get_state().items())
    env.close()


@pytest.fixture
def nothing_named(monkeypatch):
    for variable in VARIABLES.values():
        monkeypatch.delenv(variable, raising=False)


def test_what_is_missing_is_named(tmp_path, nothing_named):
    python, repo = sys.executable, str(REPO)
    for options, flag in [
        ({}, "--daxbench-python"),
        ({"python": python}, "--daxbench-repo"),
        ({"repo": repo}, "--daxbench-python"),
        ({"python": str(tmp_path / "none"), "repo": repo}, "--daxbench-python"),
        ({"python": python, "repo": str(tmp_path)}, "--daxbench-repo"),
        ({}, "PIEGRAPH_DAXBENCH_PYTHON=PATH"),
    ]:
        with pytest.raises(MissingError) as error:
            environments.make("daxbench-rope", 50, options)
        assert flag in error.value.hint
        assert "docs/daxbench.md" in error.value.hint


def test_the_shell_may_name_interpreter_and_repository(monkeypatch, nothing_named, tmp_path):
    monkeypatch.setenv("PIEGRAPH_DAXBENCH_PYTHON", sys.executable)
    with pytest.raises(MissingError, match="repository is not given"):
        environments.make("daxbench-rope", 50)
    monkeypatch.setenv("PIEGRAPH_DAXBENCH_REPO", str(REPO))
    environments.make("daxbench-rope", 50).check()
    with pytest.raises(MissingError, match="no DaXBench repository"):  # what is given counts before it
        environments.make("daxbench-rope", 50, {"repo": str(tmp_path)})


def test_plans_end_inside_the_walls_and_are_carried_out_whole(tshirt, monkeypatch):
    moved = sure(lambda x, s: x + pad(s.along, (0, 1))[:, None])
    monkeypatch.setattr(planner, "make_foresee", lambda *_: moved)
    wall = 0.5 * tshirt._frame.scale - 0.01
    assert tshirt.walls == pytest.approx([-wall, wall, -wall, wall])

    far = Goal.of_particles(tshirt.particles() + np.float32([0.29, 0.0, 0]))
    params = PlanParams(model="static", samples=40, strokes=3, success=0.001)
    ends = play(tshirt, None, params, lambda state: far, start=0, goal=0).strokes.end.numpy()
    assert 0.2 < np.abs(ends).max() <= wall + 1e-6
    for end in ends:  # the picker gets where it was sent
        info = tshirt.step({"start": tshirt.particles()[7, :2], "end": end, "mode": 1})[4]
        np.testing.assert_allclose(info["pusher"][-1, :2], end, atol=1e-5)


def test_wrong_uses_are_refused(tshirt):
    with pytest.raises(UsageError, match="knows no push"):
        tshirt.step({"start": [0, 0], "end": [0.1, 0], "mode": 0})
    with pytest.raises(UsageError, match="cannot be rendered"):
        tshirt.surface()
    with pytest.raises(UsageError, match="reset the environment first"):
        make_daxbench("daxbench-rope").particles()
    many = make_daxbench("daxbench-rope", particles=161)
    with pytest.raises(DataError, match="fewer particles"):
        many.reset(seed=0)
    many.close()
