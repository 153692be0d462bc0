"""The T-block environment: determinism, states, contact, rigidity, and the statistics of its random strokes."""

import math
import warnings

import numpy as np
import pytest

pytest.importorskip("pymunk", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from block_distance import distance_to_block
from gymnasium.utils.env_checker import check_env

from piegraph_cli import environments
from piegraph_cli.environments.base import CLEARANCE, PUSHER_RADIUS, REACH, STROKE_LENGTHS
from piegraph_cli.environments.recording import simulate_tracks
from piegraph_cli.environments.shapes import place, t_block
from piegraph_cli.errors import MissingError, UsageError


@pytest.fixture
def env():
    env = environments.make("tblock")
    env.reset(seed=3)
    return env


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(UsageError, match="tblock"):
        environments.make("teapot")


def test_a_missing_package_names_the_pip_command():
    with pytest.raises(MissingError, match=r"pip install 'piegraph\[sim\]'"):
        environments.import_extra("package_that_is_not_installed")


def test_passes_gymnasiums_checker(env):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env)


def test_same_seed_same_bits(env):
    first, second = (simulate_tracks(env, seed=11, strokes=3) for _ in range(2))
    assert all(np.array_equal(first[key], second[key]) for key in first)
    assert not np.array_equal(first["positions"][0], simulate_tracks(env, seed=12, strokes=1)["positions"][0])


def test_first_stroke_is_independent_of_the_first_pose(env):
    start, heading = [], []
    for seed in range(60):
        track = simulate_tracks(env, seed, 1)
        along = track["end_effector"][-1] - track["end_effector"][0]
        start.append(track["positions"][0].mean(0)[:2])
        heading.append(math.atan2(along[1], along[0]))
    assert np.abs(np.corrcoef(np.array(start).T, heading)[-1, :-1]).max() < 0.4


def test_golden_trajectory(env):
    env.reset(options={"pose": [0.02, -0.01, 0.5]})
    poses = [env.step({"start": [-0.14, 0.05], "end": [-0.02, 0.05], "mode": 0})[4]["shapes"][-1]]
    poses.append(env.step({"start": [0.05, -0.2], "end": [0.03, -0.08], "mode": 0})[4]["shapes"][-1])
    np.testing.assert_allclose(
        poses, [[0.0397370, -0.0208117, 0.3814158], [0.0403845, 0.0599040, 0.2724120]], atol=1e-5
    )


def test_state_returns_bit_for_bit(env):
    rng = np.random.default_rng(0)
    env.step(env.sample_stroke(rng))
    state, stroke = env.get_state(), env.sample_stroke(rng)
    first = env.step(stroke)
    env.step(env.sample_stroke(rng))
    env.set_state(state)
    second = env.step(stroke)
    assert np.array_equal(first[0], second[0])
    assert all(np.array_equal(first[4][key], second[4][key]) for key in first[4])


def test_a_miss_moves_nothing(env):
    before = env.particles()
    after, _, _, _, info = env.step({"start": [0.3, -0.3], "end": [0.3, 0.3], "mode": 0})
    assert np.array_equal(before, after)
    assert np.array_equal(info["frames"], np.broadcast_to(before, info["frames"].shape))


def test_pusher_stays_outside_and_particles_stay_rigid(env):
    rng = np.random.default_rng(1)
    shape = np.linalg.norm(env.body_particles[:, None] - env.body_particles, axis=-1)
    for _ in range(8):
        _, _, _, _, info = env.step(env.sample_stroke(rng))
        gaps = [
            distance_to_block(env, p, c[None])[0] for p, c in zip(info["shapes"], info["pusher"][:, :2], strict=True)
        ]
        assert min(gaps) > PUSHER_RADIUS - 1e-3
        for frame in info["frames"]:
            np.testing.assert_allclose(np.linalg.norm(frame[:, None] - frame, axis=-1), shape, atol=1e-6)


def test_sampled_strokes_start_just_before_contact(env):
    rng = np.random.default_rng(2)
    for seed in range(10):
        env.reset(seed=seed)
        pose, stroke = env.get_state()["pose"], env.sample_stroke(rng)
        length = np.linalg.norm(stroke["end"] - stroke["start"])
        assert STROKE_LENGTHS[0] <= length <= STROKE_LENGTHS[1]
        touch = stroke["start"] + (stroke["end"] - stroke["start"]) * CLEARANCE / length
        assert distance_to_block(env, pose, touch[None])[0] == pytest.approx(PUSHER_RADIUS, abs=1e-5)
        assert not env.step(stroke)[4]["blocked"]


def test_a_start_on_the_block_is_moved_back(env):
    pose = env.get_state()["pose"]
    info = env.step({"start": pose[:2], "end": pose[:2] + np.array([0.1, 0.0]), "mode": 0})[4]
    assert info["blocked"]
    assert info["start_used"][0] < pose[0]
    assert distance_to_block(env, pose, info["start_used"][None])[0] >= PUSHER_RADIUS - 1e-6


def test_strokes_move_the_block_enough_and_keep_it_in_reach(env):
    tracks = [simulate_tracks(env, seed, 4) for seed in range(40)]
    moved = []
    for track in tracks:
        starts = np.flatnonzero(~track["contact"])
        ends = np.append(starts[1:] - 1, len(track["contact"]) - 1)
        step = track["positions"][ends] - track["positions"][starts]
        moved += np.linalg.norm(step, axis=-1).mean(1).tolist()
        assert len(starts) == 4
        assert np.abs(track["positions"][..., :2]).max() < REACH
    assert 0.048 < np.mean(moved) < 0.060


def test_goals_are_reachable_poses(env):
    start, rng = env.get_state()["pose"], np.random.default_rng(4)
    for _ in range(20):
        goal = env.goal(rng)
        assert goal.shape == (50, 3)
        assert np.abs(goal[:, :2]).max() < REACH
        assert np.linalg.norm(goal.mean(0) - env.particles().mean(0)) < 0.4
    assert np.array_equal(env.get_state()["pose"], start)


def test_particles_lie_on_the_visible_surface(env):
    block, points = t_block(), env.body_particles
    on_top = np.isclose(points[:, 2], block.height)
    at_side = np.abs(distance_to_block(env, np.zeros(3), points[:, :2])) < 1e-9
    assert (on_top | at_side).all()
    assert on_top.any()
    assert (points[:, 2] >= 0).all()


def test_block_mesh_is_closed_and_faces_outwards():
    import trimesh

    block = t_block()
    mesh = trimesh.Trimesh(*block.mesh(), process=False)
    assert mesh.volume == pytest.approx((0.2 * 0.05 + 0.05 * 0.15) * block.height)


def test_place_turns_about_z():
    moved = place(np.array([[1.0, 0.0, 0.5]]), np.array([1.0, 2.0, math.pi / 2]))
    np.testing.assert_allclose(moved, [[1.0, 3.0, 0.5]], atol=1e-12)
