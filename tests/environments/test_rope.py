"""The rope environments: determinism, states, elasticity, friction, contact, options, divergence."""

import math
import warnings

import mujoco
import numpy as np
import pytest
import trimesh
from gymnasium.utils.env_checker import check_env

from piegraph_cli import environments
from piegraph_cli.environments.base import CLEARANCE, PUSHER_RADIUS
from piegraph_cli.environments.mujoco_base import smooth_path
from piegraph_cli.environments.recording import simulate_tracks
from piegraph_cli.environments.rope import Rope
from piegraph_cli.errors import DataError, UsageError

FLAT = {"pose": [0.0, 0.0, 0.0]}
MIDDLE = {"start": [0.0, -0.05], "end": [0.0, 0.1], "mode": 0}


@pytest.fixture(scope="module")
def ropes():
    return {name: environments.make(name) for name in ("rope-stiff", "rope-bendy")}


@pytest.fixture(params=["rope-stiff", "rope-bendy"])
def env(request, ropes):
    ropes[request.param].reset(seed=3)
    return ropes[request.param]


def sagitta(points: np.ndarray) -> float:
    """How far points [N, 3] in a row stray from the line through both ends, metres."""
    chord = points[-1, :2] - points[0, :2]
    across = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
    return float(np.abs((points[:, :2] - points[0, :2]) @ across).max())


def turning(points: np.ndarray) -> float:
    """The angle through which a row of points [N, 3] turns in all, rad."""
    edges = np.diff(points[:, :2], axis=0)
    return float(np.ptp(np.unwrap(np.arctan2(edges[:, 1], edges[:, 0]))))


def bending_energy(env: Rope) -> float:
    """Of a straight rod bent to the current nodes, joules; MuJoCo's own sum leaves it out."""
    edges = np.diff(env.nodes, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    curvature = 2 * np.cross(edges[:-1], edges[1:])
    curvature /= (lengths[:-1] * lengths[1:] + (edges[:-1] * edges[1:]).sum(1))[:, None]
    inertia = math.pi * env.options.radius**4 / 4
    return float((env.options.young * inertia / (lengths[:-1] + lengths[1:]) * (curvature**2).sum(1)).sum())


def test_passes_gymnasiums_checker(env):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env)


def test_same_seed_same_bits(env):
    first, second = (simulate_tracks(env, seed=11, strokes=2) for _ in range(2))
    assert all(np.array_equal(first[key], second[key]) for key in first)
    assert not np.array_equal(first["positions"][0], simulate_tracks(env, seed=12, strokes=1)["positions"][0])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (
            "rope-stiff",
            [[-0.08019, -0.137, 0.007653], [-0.002464, 0.006811, 0.007633], [0.136072, 0.199076, 0.007667]],
        ),
        (
            "rope-bendy",
            [[-0.064117, -0.123617, 0.007674], [-0.022717, 0.032539, 0.007621], [0.192107, 0.075207, 0.007615]],
        ),
    ],
)
def test_golden_trajectory(ropes, name, expected):
    env = ropes[name]
    env.reset(options={"pose": [0.02, -0.01, 0.5]})
    env.step({"start": [0.05, -0.06], "end": [0.02, 0.06], "mode": 0})
    particles = env.step({"start": [-0.1, 0.05], "end": [-0.08, -0.1], "mode": 0})[0]
    # the last bit of a start already makes 0.8 mm of difference, and machines differ in it
    np.testing.assert_allclose(particles[[0, 20, 49]], expected, atol=2e-3)


def test_state_returns_bit_for_bit(env):
    rng = np.random.default_rng(0)
    env.step(env.sample_stroke(rng))
    state, stroke = env.get_state(), env.sample_stroke(rng)
    first = env.step(stroke)
    env.step(env.sample_stroke(rng))
    env.set_state(state)
    assert np.array_equal(env.get_state()["integration"], state["integration"])
    second = env.step(stroke)
    assert np.array_equal(first[0], second[0])
    assert all(np.array_equal(first[4][key], second[4][key]) for key in first[4])


def test_energy_does_not_grow_after_the_pusher_left(env):
    env.reset(options=FLAT)
    env.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    path = smooth_path(np.array([0, -0.05, 0.018]), np.array([0, 0.06, 0.018]), 240)
    env._place_pusher(path[0])
    env._follow(path, env._steer_pusher)
    env._place_pusher(np.array([0.0, 0.0, 2.0]))
    totals = []
    for _ in range(40):
        bending = bending_energy(env)  # MuJoCo's energies are of a step's beginning
        env._advance(env.model.opt.timestep)
        totals.append(env.data.energy.sum() + bending)
    env.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    gained = np.diff(totals)
    assert totals[-1] < totals[0]
    assert gained.max() < 0.02 * (totals[0] - totals[-1]) + 1e-7


def test_it_stays_in_one_piece_on_the_table_and_outside_the_pusher(env):
    rng = np.random.default_rng(1)
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(3):
            info = env.step(env.sample_stroke(rng))[4]
            lengths = np.linalg.norm(np.diff(info["shapes"], axis=1), axis=-1).sum(1)
            np.testing.assert_allclose(lengths, env.options.length, rtol=0.05)
            assert info["frames"][..., 2].min() > env.options.radius - 3e-3
            assert info["frames"][..., 2].max() < env.options.radius + 5e-3
            # the last frame is after the pusher left
            gaps = np.linalg.norm(env._dense @ info["shapes"][:-1, :, :2] - info["pusher"][:-1, None, :2], axis=-1)
            assert gaps.min() > PUSHER_RADIUS + env.options.radius - 2e-3


def test_stiff_bends_less_than_bendy(ropes):
    bent = {}
    for name, env in ropes.items():
        env.reset(options=FLAT)
        bent[name] = sagitta(env.step(MIDDLE)[0])
    assert bent["rope-stiff"] < 0.02
    assert bent["rope-bendy"] > 0.06


def test_friction_stops_it_where_coulomb_says():
    for friction in (0.3, 0.6):
        env = environments.make("rope-stiff", options={"friction": friction})
        env.reset(options=FLAT)
        before, speed = env.nodes, 0.6
        env.data.qvel[env._qvel[:, 1]] = speed
        env._advance(1.0)
        slid = (env.nodes - before).mean(0)
        assert slid[1] == pytest.approx(speed**2 / (2 * friction * 9.81), rel=0.1)
        assert np.linalg.norm(env.data.qvel[env._qvel], axis=1).max() < 1e-3


def test_a_bent_rope_hardly_creeps(env):
    env.reset(options=FLAT)
    env.step(MIDDLE)
    before = env.nodes
    env._advance(2.0)
    assert np.linalg.norm(env.nodes - before, axis=1).max() < 2e-3


def test_young_between_the_ropes_bends_between_them(ropes):
    between = environments.make("rope-stiff", options={"young": 2e5})
    bent = []
    for env in (ropes["rope-stiff"], between, ropes["rope-bendy"]):
        env.reset(options=FLAT)
        bent.append(sagitta(env.step(MIDDLE)[0]))
    assert bent == sorted(bent)


def test_a_curled_rope_lies_curled_and_returns_to_it():
    env = environments.make("rope-stiff", options={"curl": 2.0})
    env.reset(options=FLAT)
    assert turning(env.nodes) == pytest.approx(2.0, abs=0.02)
    lowest = env.nodes[:, 1].min()
    after = env.step({"start": [0.0, lowest - 0.05], "end": [0.0, lowest + 0.1], "mode": 0})[0]
    assert after[:, 1].mean() > 0.03
    assert turning(env.nodes) == pytest.approx(2.0, abs=0.25)


def test_length_radius_and_density_are_as_given():
    env = environments.make("rope-bendy", options={"length": 0.3, "radius": 0.01, "density": 800.0})
    env.reset(options=FLAT)
    assert np.linalg.norm(np.diff(env.nodes, axis=0), axis=1).sum() == pytest.approx(0.3, rel=1e-3)
    assert env.nodes[:, 2].mean() == pytest.approx(0.01, abs=1e-3)
    mass = env.model.body_mass[env.model.flex_vertbodyid].sum()
    assert mass == pytest.approx(800 * math.pi * 0.01**2 * 0.3)


def test_a_stroke_looks_the_same_from_every_side(ropes):
    env = ropes["rope-stiff"]
    results = []
    for yaw in (0.0, 0.4, 2.0):
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([[cos, -sin], [sin, cos]])
        env.reset(options={"pose": [0, 0, yaw]})
        after = env.step({"start": turn @ [0.1, -0.03], "end": turn @ [0.12, 0.08], "mode": 0})[0]
        results.append(after[:, :2] @ turn)
    assert np.linalg.norm(results[0] - results[1:], axis=-1).max() < 2e-3


def test_steps_that_the_sparse_solver_misses_are_made_again(ropes, monkeypatch):
    env = ropes["rope-bendy"]
    env.reset(seed=3)
    state, stroke = env.get_state(), env.sample_stroke(np.random.default_rng([3, 1]))
    after = env.step(stroke)[0]
    env.set_state(state)
    monkeypatch.setattr(env.model.opt, "jacobian", mujoco.mjtJacobian.mjJAC_DENSE)
    monkeypatch.setattr(env, "_step", lambda: mujoco.mj_step(env.model, env.data))
    assert np.abs(env.step(stroke)[0] - after).max() < 1e-3


def test_particles_run_along_the_centre_line_evenly(ropes):
    env = ropes["rope-stiff"]
    env.reset(options=FLAT)
    np.testing.assert_allclose(np.diff(env.particles()[:, 0]), 0.4 / 49, rtol=1e-3)
    assert np.array_equal(env.particles(), env.particles(env.nodes))


def test_surface_is_a_closed_tube_around_the_nodes(env):
    env.step(env.sample_stroke(np.random.default_rng(5)))
    mesh = trimesh.Trimesh(env.surface(), env.triangles, process=False)
    radius, length = env.options.radius, env.options.length
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(math.pi * radius**2 * (length + 4 / 3 * radius), rel=0.1)
    assert env.surface(np.stack([env.nodes] * 2)).shape == (2, *mesh.vertices.shape)
    distance = np.linalg.norm(mesh.vertices[:, None] - env._dense @ env.nodes, axis=-1).min(1)
    np.testing.assert_allclose(distance, radius, atol=1.5e-3)


def test_sampled_strokes_begin_just_before_contact(env):
    rng = np.random.default_rng(2)
    for seed in range(5):
        env.reset(seed=seed)
        stroke = env.sample_stroke(rng)
        along = stroke["end"] - stroke["start"]
        touch = stroke["start"] + along * CLEARANCE / np.linalg.norm(along)
        gap = np.linalg.norm(env._outline()[0] - touch, axis=1).min()
        assert gap == pytest.approx(PUSHER_RADIUS + env.options.radius, abs=1e-4)


def test_random_strokes_move_it_and_keep_it_in_reach(env):
    moved = []
    for seed in range(8):
        env.reset(seed=seed)
        rng = np.random.default_rng([seed, 1])
        for _ in range(4):
            frames = env.step(env.sample_stroke(rng))[4]["frames"]
            moved.append(np.linalg.norm(frames[-1] - frames[0], axis=1).mean())
            assert np.abs(frames[..., :2]).max() < env.reach
    assert 0.03 < np.mean(moved) < 0.08


def test_a_goal_is_reachable_and_leaves_the_state(env):
    before = env.get_state()
    goal = env.goal(np.random.default_rng(4))
    assert goal.shape == (50, 3)
    assert np.abs(goal[:, :2]).max() < env.reach
    assert np.linalg.norm(goal - env.particles(), axis=1).mean() > 0.02
    assert np.array_equal(env.get_state()["integration"], before["integration"])


def test_a_diverged_simulation_is_an_error_and_leaves_the_state(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    env = environments.make("rope-stiff")
    env.reset(options=FLAT)
    env.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER  # explicit: such steps are far too long for it
    before, particles = env.get_state(), env.particles()
    with pytest.raises(DataError, match="diverged"):
        env.step(MIDDLE)
    assert np.array_equal(env.get_state()["integration"], before["integration"])
    assert np.array_equal(env.particles(), particles)
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""


def test_a_rope_that_never_rests_is_an_error():
    with pytest.raises(DataError, match="rest"):
        environments.make("rope-stiff", options={"young": 1e20}).reset(seed=0)


def test_wrong_options_are_usage_errors():
    with pytest.raises(UsageError, match="colour") as unknown:
        environments.make("rope-stiff", options={"colour": 1})
    assert "curl" in unknown.value.hint
    assert "[rad]" in unknown.value.hint
    with pytest.raises(UsageError, match="refuses"):
        environments.make("rope-stiff", options={"density": 1e-12})
