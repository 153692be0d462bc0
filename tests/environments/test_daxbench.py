"""The DaXBench bridge: the real child on a fake DaXBench, the near end against a fake child, and how both end."""

import base64
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from gymnasium.utils.env_checker import check_env

from piegraph_cli import environments
from piegraph_cli.dynamics.strokes import cut_strokes, frame_pairs
from piegraph_cli.environments import daxbench, daxbench_child
from piegraph_cli.environments.recording import simulate_tracks
from piegraph_cli.errors import DataError, MissingError, UsageError

REPO = Path(__file__).parent / "fake_daxbench"
PUSH_UP = {"start": [0.05, -0.15], "end": [0.05, 0.06], "mode": 0}


def make(name, timeout=20.0, particles=50):
    return environments.make(name, particles, {"python": sys.executable, "repo": str(REPO), "timeout": timeout})


@pytest.fixture(scope="module")
def running():
    envs = [make("daxbench-rope"), make("daxbench-tshirt")]
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


@pytest.fixture
def fake_child(monkeypatch):
    """Makes a rope environment whose child has the given fault, once reset."""
    made = []

    def start(fault, timeout=20.0):
        monkeypatch.setattr(daxbench, "CHILD", REPO / "child.py")
        monkeypatch.setenv("FAULT", fault)
        made.append(make("daxbench-rope", timeout))
        return made[-1]

    yield start
    for env in made:
        env.close()


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] != "Z"


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


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
    other = make("daxbench-rope")
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
    env = make(name)
    tracks = simulate_tracks(env, seed=2, strokes=4)
    env.close()
    strokes = cut_strokes(tracks["end_effector"], tracks["contact"], 0.01)
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
    env = make("daxbench-rope")
    env.reset(seed=1)
    env.step(PUSH_UP)
    state, particles = env.get_state(), env.particles()
    with pytest.raises(DataError, match="diverged"):
        env.step({"start": [0.05, -0.3], "end": [0.05, 0.1], "mode": 0})
    assert np.array_equal(env.particles(), particles)
    assert all(np.array_equal(array, state[name]) for name, array in env.get_state().items())
    env.close()


def test_nan_in_a_stroke_is_divergence(fake_child):
    env = fake_child("nan-particles")
    env.reset(seed=0)
    before = env.particles()
    with pytest.raises(DataError, match="diverged"):
        env.step(PUSH_UP)
    assert np.array_equal(env.particles(), before)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("crash", r"crashed in 'step': exit code 3; its last words:\n    line before\n    the reason"),
        ("killed", "crashed in 'step': killed by signal 9"),
        ("garbage", r"sent b'\\x1b\[2J I am no JSON\\n', which is no message"),
        ("nesting", "no message"),
        ("two", "no message"),
        ("closes", "closed its output in 'step': it was stopped; it wrote no message"),
        ("oversize", "more than 64 MiB"),
        ("nan-tool", "not finite"),
        ("shape", "in place of floats"),
        ("short", "bytes for an array"),
        ("negative", "an array of shape"),
        ("object", "an array of type"),
        ("list-dtype", "an array of type"),
        ("base64", "broken message"),
        ("lacks", "broken message"),
        ("grasped", "neither true nor false"),
        ("id", "answers no request"),
        ("list", "answers no request"),
    ],
)
def test_whatever_the_child_does_is_a_clear_error(fake_child, fault, reason):
    env = fake_child(fault)
    env.reset(seed=0)
    pid = env._process._process.pid
    with pytest.raises(DataError, match=reason) as error:
        env.step(PUSH_UP)
    assert error.value.where == "daxbench-rope"
    assert "docs/daxbench.md" in error.value.hint
    assert not alive(pid)
    with pytest.raises(UsageError, match="reset the environment first"):
        env.step(PUSH_UP)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("early", "in 'start': exit code 1.*\n    No module named 'jax'"),
        ("protocol", "protocol 2"),
        ("nan-reset", "finite"),
    ],
)
def test_a_child_that_starts_badly_is_a_clear_error(fake_child, fault, reason):
    with pytest.raises(DataError, match=reason):
        fake_child(fault).reset(seed=0)


@pytest.mark.parametrize("fault", ["hang", "drip"])
def test_a_child_that_does_not_answer_is_stopped_in_time(fake_child, fault):
    env = fake_child(fault, timeout=0.5)
    env.reset(seed=0)
    pid, begin = env._process._process.pid, time.monotonic()
    with pytest.raises(DataError, match=r"did not answer within 0\.5 s in 'step'"):
        env.step(PUSH_UP)
    assert time.monotonic() - begin < 5
    assert not alive(pid)


def test_a_child_that_does_not_read_is_stopped_in_time(fake_child):
    env = fake_child("deaf", timeout=0.5)
    env.reset(seed=0)
    process = env._process
    state = process.ask("get_state", daxbench._read_state)
    packed = {name: daxbench_child.pack(array) for name, array in state.items()}
    assert sum(len(array["data"]) for array in packed.values()) > 2**20  # more than a pipe holds
    with pytest.raises(DataError, match=r"did not answer within 0\.5 s in 'set_state'"):
        process.ask("set_state", lambda reply: reply, state=packed)


def test_after_an_error_reset_starts_another_child(fake_child, monkeypatch):
    env = fake_child("crash")
    env.reset(seed=0)
    with pytest.raises(DataError, match="crashed"):
        env.step(PUSH_UP)
    monkeypatch.setenv("FAULT", "")
    env.reset(seed=0)
    assert np.array_equal(env.step(PUSH_UP)[0], env.particles())


def test_an_exception_in_daxbench_shows_its_traceback(monkeypatch):
    monkeypatch.setenv("FAKE_DAXBENCH", "raise")
    with pytest.raises(
        DataError, match=r"crashed in 'start': exit code 1(.|\n)*FloatingPointError: the solver gave up"
    ):
        make("daxbench-rope").reset(seed=0)


def test_what_a_crash_writes_cannot_steer_the_terminal(monkeypatch):
    monkeypatch.setenv("FAKE_DAXBENCH", "crash")
    env = make("daxbench-tshirt")
    with pytest.raises(DataError, match=r"something  broke") as error:
        env.reset(seed=0)
    assert "\x1b" not in str(error.value)


def test_a_hung_child_takes_what_it_started_along(monkeypatch, tmp_path):
    monkeypatch.setenv("FAKE_DAXBENCH", "hang")
    monkeypatch.setenv("FAKE_DAXBENCH_PIDS", str(tmp_path / "pids"))
    with pytest.raises(DataError, match="did not answer"):
        make("daxbench-tshirt", timeout=2.0).reset(seed=0)
    child, other = map(int, (tmp_path / "pids").read_text().split())
    assert wait_until(lambda: not alive(child) and not alive(other))


HUNG_USER = """
import sys
from piegraph_cli import environments
env = environments.make("daxbench-tshirt", 50, {"python": sys.executable, "repo": sys.argv[1]})
env.reset(seed=0)
"""


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_orphan_is_left_when_piegraph_ends_in_a_step(ending, tmp_path):
    pids = tmp_path / "pids"
    settings = os.environ | {"FAKE_DAXBENCH": "hang", "FAKE_DAXBENCH_PIDS": str(pids)}
    user = subprocess.Popen([sys.executable, "-c", HUNG_USER, str(REPO)], env=settings, stderr=subprocess.DEVNULL)
    assert wait_until(lambda: pids.exists() and pids.read_text().endswith("\n"))
    child, other = map(int, pids.read_text().split())
    user.send_signal(ending)
    assert user.wait(10) != 0
    assert wait_until(lambda: not alive(child))
    if ending == signal.SIGINT:
        assert wait_until(lambda: not alive(other))
    elif alive(other):
        os.kill(other, signal.SIGKILL)


def test_the_child_speaks_the_documented_protocol_and_ends_with_its_input():
    command = [sys.executable, str(daxbench.CHILD), "rope", str(REPO)]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    def ask(**request):
        if request:
            child.stdin.write(json.dumps(request).encode() + b"\n")
            child.stdin.flush()
        return json.loads(child.stdout.readline())

    assert ask() == {"id": 0, "protocol": 1, "task": "rope"}
    reply = ask(id=1, do="reset", seed=4)
    assert reply.keys() == {"id", "rest", "particles"}
    assert (reply["rest"]["dtype"], reply["rest"]["shape"]) == ("<f4", [160, 3])
    assert len(base64.b64decode(reply["rest"]["data"])) == 160 * 3 * 4
    reply = ask(id=2, do="step", start=[0.5, 0, 0.4], end=[0.5, 0, 0.6], frames=5)
    assert reply.keys() == {"id", "frames", "tool", "grasped"}
    assert (reply["frames"]["shape"], reply["tool"]["shape"]) == ([6, 160, 3], [6, 3])
    state = ask(id=3, do="get_state")["state"]
    assert {"x", "v", "key", "cur_step", "primitives.0.position"} <= state.keys()
    assert ask(id=4, do="set_state", state=state) == {"id": 4, "particles": state["x"] | {"shape": [160, 3]}}
    child.stdin.close()
    assert child.wait(10) == 0
    child.stdout.close()


def test_the_child_imports_only_the_standard_library_at_first():
    code = (
        "import runpy, sys; runpy.run_path(sys.argv[1], run_name='child');"
        "print({'numpy', 'jax', 'daxbench', 'piegraph_cli'} & sys.modules.keys())"
    )
    command = [sys.executable, "-S", "-c", code, daxbench_child.__file__]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("dtype", daxbench_child.DTYPES)
def test_arrays_survive_packing_bit_for_bit(dtype):
    array = np.frombuffer(np.random.default_rng(0).bytes(240), dtype).reshape(2, 1, -1)
    back = daxbench_child.unpack(json.loads(json.dumps(daxbench_child.pack(array[:, :, ::2]))))
    assert back.dtype.str == dtype
    assert back.tobytes() == array[:, :, ::2].tobytes()
    scalar = np.array(3, dtype)
    assert daxbench_child.unpack(daxbench_child.pack(scalar)).shape == ()


def test_what_is_missing_is_named(tmp_path):
    python, repo = sys.executable, str(REPO)
    for options, flag in [
        ({}, "--daxbench-python"),
        ({"python": python}, "--daxbench-repo"),
        ({"repo": repo}, "--daxbench-python"),
        ({"python": str(tmp_path / "none"), "repo": repo}, "--daxbench-python"),
        ({"python": python, "repo": str(tmp_path)}, "--daxbench-repo"),
    ]:
        with pytest.raises(MissingError) as error:
            environments.make("daxbench-rope", 50, options)
        assert flag in error.value.hint
        assert "docs/daxbench.md" in error.value.hint


def test_a_file_that_cannot_be_started_is_refused(tmp_path):
    (tmp_path / "text").write_text("no program")
    env = environments.make("daxbench-rope", 50, {"python": str(tmp_path / "text"), "repo": str(REPO)})
    with pytest.raises(UsageError, match="cannot be started"):
        env.reset()


def test_wrong_uses_are_refused(tshirt):
    with pytest.raises(UsageError, match="knows no push"):
        tshirt.step({"start": [0, 0], "end": [0.1, 0], "mode": 0})
    with pytest.raises(UsageError, match="cannot be rendered"):
        tshirt.surface()
    with pytest.raises(UsageError, match="reset the environment first"):
        make("daxbench-rope").particles()
    many = make("daxbench-rope", particles=161)
    with pytest.raises(DataError, match="fewer particles"):
        many.reset(seed=0)
    many.close()


def test_a_closed_environment_leaves_no_process_and_starts_again(tshirt):
    process = tshirt._process
    pid = process._process.pid
    tshirt.close()
    assert not process.running
    assert not alive(pid)
    tshirt.reset(seed=1)
    assert tshirt.particles().shape == (50, 3)
