"""The process behind the DaXBench bridge: its protocol, everything that can go wrong with it, and its end."""

import base64
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from daxbench_stand_in import PUSH_UP, REPO, make_daxbench

from piegraph_cli import environments
from piegraph_cli.environments import daxbench, daxbench_child, daxbench_process
from piegraph_cli.environments.daxbench_setup import COMMIT
from piegraph_cli.errors import DataError, MissingError, UsageError
from tests.cli import PATIENCE


@pytest.fixture
def fake_child(monkeypatch):
    """Makes a rope environment whose child has the given fault, once reset."""
    made = []

    def start(fault):
        monkeypatch.setattr(daxbench, "CHILD", REPO / "child.py")
        monkeypatch.setenv("FAULT", fault)
        made.append(make_daxbench("daxbench-rope"))
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


def wait_until(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


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


@pytest.mark.parametrize(
    ("fault", "message", "hint"),
    [
        ("no-jax", "No module named 'jax'", "-m pip install jax==0.4.13; "),
        ("new-jax", "cannot import name 'KeyArray'", "-m pip install jax==0.4.13 numpy==1.26.4; "),
        ("new-python", "No module named 'jax'", "with Python 3.9, 3.10 or 3.11, this one has 3.12.1"),
        ("old-commit", "AttributeError: no FoldTshirtEnv", f"checkout {COMMIT}"),
    ],
)
def test_what_keeps_daxbench_from_starting_is_named_with_what_mends_it(fake_child, monkeypatch, fault, message, hint):
    env = fake_child(fault)
    monkeypatch.setattr(sys, "executable", "/elsewhere/python")
    for start in (env.check, lambda: env.reset(seed=0)):
        with pytest.raises(MissingError, match=message) as error:
            start()
        assert hint in error.value.hint
        assert "docs/daxbench.md" in error.value.hint
        assert "\x1b" not in str(error.value)
    assert env._process is None


def test_nobody_is_told_to_break_piegraphs_own_packages(fake_child):
    with pytest.raises(MissingError, match="No module named 'jax'") as error:
        fake_child("no-jax").check()
    assert error.value.hint.startswith("make a virtual environment")


def test_a_problem_in_no_words_is_a_broken_message(fake_child):
    with pytest.raises(DataError, match="a problem in no words"):
        fake_child("wordless").check()


def test_a_check_starts_the_process_and_leaves_none(fake_child, monkeypatch):
    env, started = fake_child(""), []
    monkeypatch.setattr(daxbench, "Process", lambda *a: started.append(daxbench_process.Process(*a)) or started[-1])
    env.check()
    assert len(started) == 1
    assert not started[0].running


@pytest.fixture
def repository(tmp_path):
    """Makes a repository whose rope's module has that text."""

    def make(text):
        folder = tmp_path / "daxbench" / "core" / "envs"
        folder.mkdir(parents=True)
        (folder / "shape_rope_env.py").write_text(text)
        options = {"python": sys.executable, "repo": str(tmp_path), "timeout": PATIENCE}
        return environments.make("daxbench-rope", 50, options)

    return make


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import a_package_that_nobody_has", "No module named 'a_package_that_nobody_has'"),
        ("MPMState = None", "has no attribute 'ShapeRopeEnv'"),
    ],
)
def test_the_child_says_what_it_does_not_find_before_anything_is_simulated(repository, text, message):
    with pytest.raises(MissingError, match=message):
        repository(text).check()


def test_an_environment_that_is_made_otherwise_is_no_crash(repository):
    env = repository("MPMState = None\nclass ShapeRopeEnv:\n    def __init__(self, size): pass")
    env.check()
    with pytest.raises(MissingError, match="unexpected keyword argument"):
        env.reset(seed=0)


def test_a_repository_without_the_task_is_told_before_anything_is_started(repository, tmp_path):
    repository("")
    options = {"python": sys.executable, "repo": str(tmp_path)}
    with pytest.raises(MissingError, match=r"has no fold_cloth_tshirt_env\.py") as error:
        environments.make("daxbench-tshirt", 50, options)
    assert f"checkout {COMMIT}" in error.value.hint


def test_an_interpreter_that_is_none_is_told(tmp_path):
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho no Python >&2\nexit 5\n")
    program.chmod(0o755)
    options = {"python": str(program), "repo": str(REPO)}
    with pytest.raises(DataError, match=r"in 'start': exit code 5(.|\n)*no Python") as error:
        environments.make("daxbench-rope", 50, options).check()
    assert error.value.hint.startswith("give --daxbench-python")


@pytest.mark.parametrize("fault", ["hang", "drip"])
def test_a_child_that_does_not_answer_is_stopped_in_time(fake_child, fault):
    env = fake_child(fault)
    env.reset(seed=0)
    env._process._timeout = 3  # the state is asked for first, which a busy machine may take a while for
    pid, begin = env._process._process.pid, time.monotonic()
    with pytest.raises(DataError, match=r"did not answer within 3 s in 'step'"):
        env.step(PUSH_UP)
    assert time.monotonic() - begin < PATIENCE / 2
    assert not alive(pid)


def test_a_child_that_does_not_read_is_stopped_in_time(fake_child):
    env = fake_child("deaf")
    env.reset(seed=0)
    process = env._process
    state = process.ask("get_state", daxbench._read_state)
    packed = {name: daxbench_child.pack(array) for name, array in state.items()}
    assert sum(len(array["data"]) for array in packed.values()) > 2**20  # more than a pipe holds
    process._timeout = 0.5
    process._stdin.write(b" ")  # no whole chunk fits: a write that waits would wait for ever
    with pytest.raises(DataError, match=r"did not answer within 0\.5 s in 'set_state'"):
        process.ask("set_state", lambda reply: reply, state=packed)


def test_an_interrupted_request_ends_the_child(fake_child):
    env = fake_child("hang")
    env.reset(seed=0)
    pid = env._process._process.pid
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)  # as Ctrl-C
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    with pytest.raises(KeyboardInterrupt):
        env.step(PUSH_UP)
    signal.signal(signal.SIGALRM, before)
    assert not alive(pid)


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
        DataError, match=r"crashed in 'reset': exit code 1(.|\n)*FloatingPointError: the solver gave up"
    ):
        make_daxbench("daxbench-rope").reset(seed=0)


def test_what_a_crash_writes_cannot_steer_the_terminal(monkeypatch):
    monkeypatch.setenv("FAKE_DAXBENCH", "crash")
    env = make_daxbench("daxbench-tshirt")
    with pytest.raises(DataError, match=r"something  broke") as error:
        env.reset(seed=0)
    assert "\x1b" not in str(error.value)


def test_a_hung_child_takes_what_it_started_along(monkeypatch, tmp_path):
    monkeypatch.setenv("FAKE_DAXBENCH", "hang")
    monkeypatch.setenv("FAKE_DAXBENCH_PIDS", str(tmp_path / "pids"))
    pids = tmp_path / "pids"

    def clock():
        """It stands until the child hangs, however long that takes."""
        return 1e9 if pids.exists() and pids.read_text().endswith("\n") else 0.0

    monkeypatch.setattr(daxbench_process, "time", SimpleNamespace(monotonic=clock))
    with pytest.raises(DataError, match="did not answer"):
        make_daxbench("daxbench-tshirt", timeout=0.1).reset(seed=0)
    child, other = map(int, pids.read_text().split())
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
    assert user.wait() != 0
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
    assert child.wait() == 0
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


def test_a_file_that_cannot_be_started_is_refused(tmp_path):
    (tmp_path / "text").write_text("no program")
    env = environments.make("daxbench-rope", 50, {"python": str(tmp_path / "text"), "repo": str(REPO)})
    with pytest.raises(UsageError, match="cannot be started"):
        env.reset()


def test_a_closed_environment_leaves_no_process_and_starts_again():
    tshirt = make_daxbench("daxbench-tshirt")
    tshirt.reset(seed=1)
    process = tshirt._process
    pid = process._process.pid
    tshirt.close()
    assert not process.running
    assert not alive(pid)
    tshirt.reset(seed=1)
    assert tshirt.particles().shape == (50, 3)
    tshirt.close()
