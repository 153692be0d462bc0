"""The square cloth and the T-shirt: determinism, states, grasps, contact, what cloth does, goals, options, surfaces."""

import math
import warnings

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from gymnasium.spaces import Box, Dict
from gymnasium.utils.env_checker import check_env
from scipy.interpolate import LinearNDInterpolator

from piegraph_cli import environments
from piegraph_cli.environments.base import PUSHER_RADIUS, REACH
from piegraph_cli.environments.recording import simulate_tracks
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK, PUSH

FLAT = {"pose": [0.0, 0.0, 0.0]}
GRAVITY = 9.81
GRASP_RADIUS = 0.016


@pytest.fixture(scope="module")
def made():
    """Each environment once; tests start with a reset."""
    return {name: environments.make(name) for name in ("tshirt", "cloth")}


@pytest.fixture
def tshirt(made):
    made["tshirt"].reset(seed=3)
    return made["tshirt"]


@pytest.fixture
def square(made):
    made["cloth"].reset(options=FLAT)
    return made["cloth"]


@pytest.fixture(scope="module")
def fold(made):
    """A corner of the square laid over: flat nodes [V, 3], nodes per frame [F, V, 3], and where the corner went [2] (m)."""
    env, by = made["cloth"], np.array([0.16, 0.2])
    env.reset(options=FLAT)
    flat = env.nodes
    corner = flat[env.mesh.corners[0], :2]
    return flat, env.step({"start": corner, "end": corner + by, "mode": PICK})[4]["shapes"], by


@pytest.fixture(scope="module")
def watched(made):
    """Per environment: two random picks from one reset and a push from another, each (stroke, info) with `released`.

    `released` is the nodes [V, 3] (m) as the stroke ended, before the cloth settled without pusher or gripper.
    """
    return {name: _watch(env) for name, env in made.items()}


def _watch(env):
    rng, strokes, released = np.random.default_rng(1), [], []
    settle = env._settle
    with pytest.MonkeyPatch.context() as context:
        context.setattr(env, "_settle", lambda: (released.append(env.nodes), settle()))
        for seed, mode in ((1, PICK), (None, PICK), (2, PUSH)):
            if seed is not None:
                env.reset(seed=seed)
            stroke = env.sample_stroke(rng, mode)
            info = env.step(stroke)[4]
            strokes.append((stroke, info | {"released": released[-1]}))
    return strokes


def carry(env, start, by):
    """Pick at start [2] and let go `by` [2] (m) further: the stroke's info."""
    return env.step({"start": start, "end": np.add(start, by), "mode": PICK})[4]


def put(env, nodes, velocity=(0.0, 0.0, 0.0)):
    """Set the nodes [V, 3] (m), all at one velocity (m/s)."""
    env.data.qpos[env._qpos] = nodes - env._rest
    env.data.qvel[env._qvel] = velocity


def edges(triangles):
    return np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)


def stretch(env, nodes):
    """Relative change of every edge's length at nodes [..., V, 3] since the cloth was cut out."""
    first, second = edges(env.mesh.triangles).T
    rest = np.linalg.norm(env.mesh.points[first] - env.mesh.points[second], axis=-1)
    return np.linalg.norm(nodes[..., first, :] - nodes[..., second, :], axis=-1) / rest - 1


def masses(env):
    return env.model.body_mass[env.model.flex_vertbodyid]


def test_passes_gymnasiums_checker(tshirt, monkeypatch):
    # strokes across the whole table would take a minute: some near the cloth do
    near = Box(-0.05, 0.05, (2,), np.float64)
    assert set(tshirt.action_space) == {"start", "end", "mode"}
    monkeypatch.setattr(tshirt, "action_space", Dict({**tshirt.action_space, "start": near, "end": near}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(tshirt)


def test_same_seed_same_bits(made):
    first, second = (simulate_tracks(env, seed=11, strokes=1) for env in (made["tshirt"], environments.make("tshirt")))
    assert all(np.array_equal(first[key], second[key]) for key in first)
    assert not np.array_equal(first["positions"][0], made["tshirt"].reset(seed=12)[0])


def test_state_returns_bit_for_bit(tshirt):
    rng, state = np.random.default_rng(0), tshirt.get_state()
    strokes = [tshirt.sample_stroke(rng, mode) for mode in (PICK, PUSH)]
    first = [tshirt.step(stroke) for stroke in strokes]
    tshirt.set_state(state)
    assert np.array_equal(tshirt.get_state()["integration"], state["integration"])
    for (before, *_, known), stroke in zip(first, strokes, strict=True):
        after, _, _, _, info = tshirt.step(stroke)
        assert np.array_equal(before, after)
        assert all(np.array_equal(known[key], info[key]) for key in info)


def test_golden_trajectory(tshirt):
    pose = {"pose": [0.02, -0.01, 0.5]}
    tshirt.reset(options=pose)
    picked = tshirt.step({"start": [0.1, 0.08], "end": [0.02, 0.02], "mode": PICK})[4]["frames"]
    tshirt.reset(options=pose)
    pushed = tshirt.step({"start": [0.12, -0.19], "end": [0.07, -0.08], "mode": PUSH})[4]["frames"]
    # later on, cloth amplifies the last bit of its pose to millimetres
    np.testing.assert_allclose(
        [picked[1, 31], picked[1, 9], pushed[4, 7]],
        [[0.109229, 0.081235, 0.022202], [0.090596, 0.053325, 0.023778], [0.099260, -0.132921, 0.003285]],
        atol=2e-5,
    )
    np.testing.assert_allclose(
        [picked[-1].mean(0), pushed[-1].mean(0)],
        [[0.01322, -0.01508, 0.00579], [0.01235, 0.00339, 0.00452]],
        atol=1.5e-3,
    )


@pytest.mark.parametrize("name", ["tshirt", "cloth"])
def test_a_picked_cloth_rests_unstretched_on_the_table(made, watched, name):
    env = made[name]
    for _, info in watched[name]:
        deviation = np.abs(stretch(env, info["shapes"][-1]))
        # a few edges in sharp folds are further off
        assert np.percentile(deviation, 95) < 0.05
        assert deviation.mean() < 0.015
        assert info["shapes"][..., 2].min() > -1e-3
    crumpled = watched[name][1][1]["shapes"][-1]
    put(env, crumpled)
    env._advance(0.5)
    assert np.linalg.norm(env.nodes - crumpled, axis=1).mean() < 1e-3


@pytest.mark.parametrize("name", ["tshirt", "cloth"])
def test_a_picked_part_ends_near_the_strokes_end(watched, name):
    for stroke, info in watched[name][:2]:
        held = np.linalg.norm(info["shapes"][0][:, :2] - stroke["start"], axis=1) < GRASP_RADIUS
        assert info["grasped"]
        assert held.any()
        ends = [shape[held, :2].mean(0) for shape in (info["released"], info["shapes"][-1])]
        at_release, at_rest = np.linalg.norm(ends - stroke["end"], axis=1)
        assert at_release < 0.012
        assert at_rest < 0.03
        assert info["shapes"][len(info["shapes"]) // 2, held, 2].min() > 0.03


def test_a_pick_beside_the_cloth_moves_nothing(tshirt):
    before, state = tshirt.nodes, tshirt.get_state()["integration"]
    info = carry(tshirt, tshirt.nodes[:, :2].max(0) + GRASP_RADIUS, [0.1, 0.0])
    assert not info["grasped"]
    assert np.array_equal(info["shapes"], np.broadcast_to(before, info["shapes"].shape))
    assert np.array_equal(tshirt.get_state()["integration"], state)
    assert np.ptp(info["pusher"][:, 2]) == pytest.approx(0.05)


@pytest.mark.parametrize("name", ["tshirt", "cloth"])
def test_a_push_moves_cloth_and_stays_outside_it(watched, name):
    _, info = watched[name][2]
    # in the last frame the pusher has left, and the cloth it had bent may lie where it was
    shapes = np.concatenate([info["shapes"][:-1], info["released"][None]])
    gaps = np.linalg.norm(shapes[..., :2] - info["pusher"][:, None, :2], axis=-1)
    assert gaps.min() > PUSHER_RADIUS
    assert gaps.min() < PUSHER_RADIUS + 0.004
    assert not info["blocked"]
    assert np.linalg.norm(info["frames"][-1] - info["frames"][0], axis=1).max() > 0.01


def test_folded_layers_stay_apart(square, fold):
    flat, shapes, by = fold
    shape, corner = shapes[-1], flat[square.mesh.corners[0], :2]
    # signed distance to the fold, whose line is half way: the sheet bends within 2 cm of it
    side = (flat[:, :2] - corner - by / 2) @ by / np.linalg.norm(by)
    upper, lower = shape[side < -0.02], shape[side > 0]
    gap = upper[:, 2] - LinearNDInterpolator(lower[:, :2], lower[:, 2])(upper[:, :2])
    above = np.isfinite(gap)
    assert above.sum() > 40
    assert gap[above].min() > 0.004
    assert np.median(gap[above]) < 0.008


def test_energy_does_not_grow_after_release(square, fold):
    put(square, fold[1][4])
    energy = []
    for _ in range(100):
        speed = np.linalg.norm(square.data.qvel[square._qvel], axis=1)
        energy.append((masses(square) * (speed**2 / 2 + GRAVITY * square.nodes[:, 2])).sum())
        square._step()
    lost = energy[0] - energy[-1]
    assert lost > 1e-4
    # the bent sheet's own energy is not counted: it gives a little back
    assert (energy - np.minimum.accumulate(energy)).max() < 0.04 * lost
    assert speed.max() < 0.01


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_friction_stops_a_sliding_cloth(friction):
    env = environments.make("cloth", options={"friction": friction})
    env.reset(options=FLAT)
    assert env.model.geom("pusher").friction[0] == friction
    before = env.nodes
    put(env, before, (0.4, 0.0, 0.0))
    env._advance(0.5)
    assert np.linalg.norm(env.data.qvel[env._qvel], axis=1).max() < 1e-3
    slid = (env.nodes - before).mean(0)
    assert slid[0] == pytest.approx(0.4**2 / (2 * friction * GRAVITY), rel=0.15)
    assert abs(slid[1]) < 1e-4


def test_a_stiffer_cloth_is_lifted_in_a_larger_part():
    lifted = []
    for young in (3e3, 3e5):
        env = environments.make("cloth", options={"young": young})
        env.reset(options=FLAT)
        shapes = carry(env, env.nodes[env.mesh.corners[0], :2], [0.03, 0.03])["shapes"]
        lifted.append(int((shapes[2, :, 2] > 0.006).sum()))
    assert lifted[0] + 10 < lifted[1]


def test_size_and_density_are_those_asked_for():
    env = environments.make("tshirt", options={"size": 0.2, "density": 0.4})
    assert np.ptp(env.mesh.points, axis=0) == pytest.approx([0.2, 0.2], abs=1e-6)
    assert masses(env).sum() == pytest.approx(0.4 * env.mesh.areas.sum())


def test_states_of_nothing_are_refused(tshirt):
    state = tshirt.get_state()["integration"]
    broken = state.copy()
    broken[7] = np.nan
    for wrong in (broken, state[:-1]):
        with pytest.raises(DataError, match="state"):
            tshirt.set_state({"integration": wrong})
    assert np.array_equal(tshirt.get_state()["integration"], state)


def test_a_diverged_pick_leaves_the_state_before_it(tshirt, monkeypatch):
    state, stroke = tshirt.get_state()["integration"], tshirt.sample_stroke(np.random.default_rng(0))
    steer = tshirt._steer_gripper
    monkeypatch.setattr(tshirt, "_steer_gripper", lambda position: steer(position * 1e12))
    with pytest.raises(DataError, match="diverged in a pick"):
        tshirt.step(stroke)
    assert np.array_equal(tshirt.get_state()["integration"], state)


def test_goals_are_the_flat_cloth_moved_and_turned(tshirt):
    tshirt.reset(options={"pose": [0.03, -0.02, 1.0]})
    state, rng = tshirt.get_state()["integration"], np.random.default_rng(4)
    now = tshirt.particles()
    flat = now[:, :2] - now[:, :2].mean(0)
    shifts, turns = [], []
    for _ in range(200):
        goal = tshirt.goal(rng)
        assert goal.shape == (50, 3)
        assert np.abs(goal[:, :2]).max() <= REACH
        np.testing.assert_allclose(goal[:, 2], now[:, 2], atol=1e-3)
        moved = goal[:, :2] - goal[:, :2].mean(0)
        turn = math.atan2((flat[:, 0] * moved[:, 1] - flat[:, 1] * moved[:, 0]).sum(), (flat * moved).sum())
        turned = flat @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        np.testing.assert_allclose(moved, turned, atol=1e-3)
        shifts.append(np.linalg.norm((goal - now)[:, :2].mean(0)))
        turns.append(abs(turn))
    # the particles' mean is up to 1 cm off the point about which the cloth turns
    assert 0.12 < max(shifts) < 0.16
    assert math.radians(63) < max(turns) < math.radians(70.1)
    assert np.array_equal(tshirt.get_state()["integration"], state)


def test_random_picks_and_goals_stay_in_reach(tshirt):
    tshirt.reset(options={"pose": [0.15, -0.15, 2.0]})
    nodes, rng = tshirt.nodes[:, :2], np.random.default_rng(8)
    for _ in range(50):
        stroke = tshirt.sample_stroke(rng)
        along = np.linalg.norm(nodes - stroke["start"], axis=1) < 0.1
        assert along.any()
        assert np.abs(nodes[along] + stroke["end"] - stroke["start"]).max() <= REACH
        assert np.abs(tshirt.goal(rng)[:, :2]).max() <= REACH


def test_crumpled_goals_leave_the_cloth_alone(monkeypatch):
    env = environments.make("tshirt", options={"goal": "crumpled"})
    env.reset(seed=5)
    state, now = env.get_state()["integration"], env.particles()
    step, picked = env.step, []
    monkeypatch.setattr(env, "step", lambda stroke: picked.append((stroke["mode"], step(stroke))) or picked[-1][1])
    goal = env.goal(np.random.default_rng(0))
    assert [mode for mode, _ in picked] == [PICK, PICK]
    assert np.array_equal(goal, picked[-1][1][0])
    assert np.array_equal(env.get_state()["integration"], state)
    assert np.array_equal(env.particles(), now)
    assert np.linalg.norm(goal - now, axis=1).mean() > 0.02
    assert goal[:, 2].max() > 0.008


@pytest.mark.parametrize("name", ["tshirt", "cloth"])
def test_particles_are_material_points(made, watched, name):
    env, weights = made[name], environments.make(name).weights
    for _, info in watched[name]:
        assert np.array_equal(info["frames"], (weights @ info["shapes"]).astype(np.float32))
        put(env, info["shapes"][-1])
        np.testing.assert_allclose(env.particles(), info["frames"][-1], atol=1e-6)
    np.testing.assert_allclose(weights.sum(1), 1)
    assert (weights >= 0).all()
    used = [frozenset(np.flatnonzero(row)) for row in weights]
    triangles = [frozenset(triangle) for triangle in env.mesh.triangles.tolist()]
    assert all(any(points <= triangle for triangle in triangles) for points in used)
    flat = weights @ env.mesh.points
    apart = np.linalg.norm(flat[:, None] - flat, axis=-1) + np.eye(len(flat))
    assert apart.min() > 0.02
    # every part of the cloth has a particle near it
    assert np.linalg.norm(env.mesh.points[:, None] - flat, axis=-1).min(1).max() < 0.045


@pytest.mark.parametrize("name", ["tshirt", "cloth"])
def test_the_surface_is_closed_and_faces_outwards(made, watched, name):
    import trimesh

    env = made[name]
    env.reset(seed=7)
    sheet = env.mesh.areas.sum() * 0.006
    assert trimesh.Trimesh(env.surface(), env.triangles, process=False).volume == pytest.approx(sheet, rel=0.01)
    shapes = watched[name][1][1]["shapes"]
    crumpled = trimesh.Trimesh(env.surface(shapes)[-1], env.triangles, process=False)
    assert crumpled.is_watertight
    assert crumpled.is_winding_consistent
    assert crumpled.volume == pytest.approx(sheet, rel=0.25)
