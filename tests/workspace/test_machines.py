"""Machines that lack something: locks, space, a run that can be written, shared memory; and two processes on one run.

Calls fail through a library that is preloaded (`tests/attack/shim.c`), which needs a C compiler.
"""

import errno
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from piegraph_cli import process
from piegraph_cli.errors import MissingError
from piegraph_cli.workspace import parallel
from tests.attack.chains import different
from tests.attack.shim import build, environment
from tests.cli import PROGRAM, piegraph
from tests.mounts import Mounts


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """Settings of the environment, from what is to be otherwise."""
    library = build(tmp_path_factory.mktemp("shim"))
    if library is None:
        pytest.skip("no C compiler to build what lets calls fail")

    def settings(root: Path, calls: str = "none", **given: object) -> dict[str, str]:
        return environment(library, root, calls, **given)

    return settings


@pytest.fixture
def run(tiny_run, tmp_path):
    return Path(shutil.copytree(tiny_run, tmp_path / "run"))


def test_without_locks_one_word_whatever_the_workers(run, shim):
    env = shim(run, "lock", errno=errno.ENOSYS, at=1)
    done = piegraph("evaluate", "--run", run, "--force", "--jobs", 2, env=env)
    assert done.stderr.count("has no locks") == 1


@pytest.fixture
def mounts(tmp_path):
    """From a script that mounts something: commands see it, and it is gone after the test."""
    made: list[Mounts] = []

    def make(script: str) -> Mounts:
        made.append(Mounts(script, tmp_path, tmp_path))
        return made[-1]

    yield make
    for one in made:
        one.end()


def test_a_run_that_cannot_be_written_is_read_all_the_same(run, mounts, tmp_path):
    (run / "checkpoints").mkdir(exist_ok=True)
    read_only = mounts("mount --bind run run && mount -o remount,ro,bind run")
    plan, page = tmp_path / "plan.h5", tmp_path / "page"
    for words in (("status",), ("evaluate",), ("plan", "--out", plan), ("report", "--out", page)):
        read_only.piegraph(*words, "--run", run)
    assert plan.exists()
    assert (page / "index.html").exists()
    for words in (("report",), ("train", "--force"), ("dataset", "--force")):
        done = read_only.piegraph(*words, "--run", run, check=3)
        assert "cannot be written" in done.stderr
        assert "Traceback" not in done.stderr


def test_without_shared_memory_home_and_cores(run, tiny_run, mounts):
    """As in a bare container: nothing is lost but time."""
    bare = mounts("mount -t tmpfs -o ro none /dev/shm")
    homeless = {k: v for k, v in os.environ.items() if not k.startswith("XDG_")} | {"HOME": "/proc/none"}
    core = [min(os.sched_getaffinity(0))]
    done = bare.piegraph("evaluate", "--run", run, "--force", "--jobs", 8, env=homeless, cores=core)
    assert done.stderr.count("one process in place of") == 1
    assert "Traceback" not in done.stderr
    assert not different(run, tiny_run)


def test_more_jobs_than_cores(run, tiny_run):
    done = piegraph("evaluate", "--run", run, "--force", "--jobs", 4, cores=[min(os.sched_getaffinity(0))])
    assert not done.stderr
    assert not different(run, tiny_run)


def test_a_clock_that_is_set_back(run, tiny_run, shim):
    """Files are of the future then: what is fresh stays so, what changes is seen, what is made is the same."""
    days = 30
    wrong = shim(run, clock=-days * 86_400)
    assert "all is fresh" in piegraph("run", "--run", run, "--dry", env=wrong).stdout
    piegraph("evaluate", "--run", run, "--force", env=wrong)
    metrics = next((run / "metrics").iterdir())
    data = bytearray(metrics.read_bytes())
    data[-1] ^= 1
    metrics.write_bytes(data)
    os.utime(metrics, ns=(metrics.stat().st_atime_ns, metrics.stat().st_mtime_ns + days * 86_400 * 10**9))
    for now in (wrong, None):
        assert "would make" in piegraph("run", "--run", run, "--dry", env=now).stdout
    piegraph("run", "--run", run, env=wrong)
    assert "all is fresh" in piegraph("run", "--run", run, "--dry").stdout
    assert not different(run, tiny_run)


def test_without_shared_memory_one_process_does_it_and_says_so(monkeypatch, caplog):
    import joblib.externals.loky  # noqa: F401  which keeps what multiprocessing has when it is imported

    class Nothing:
        def Semaphore(self):
            raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(multiprocessing, "get_context", lambda *_: Nothing())
    assert list(parallel.in_processes([os.getpid] * 3, 2)) == [os.getpid()] * 3
    assert caplog.text.count("one process in place of 2") == 1


@pytest.mark.parametrize(
    ("free", "limit", "jobs", "said"),
    [
        (64e9, resource.RLIM_INFINITY, 8, ""),
        (2.1e9, resource.RLIM_INFINITY, 8, "0.8 GB in each of 8 processes, and 2.1 GB are free: give --jobs 2"),
        (0.5e9, resource.RLIM_INFINITY, 1, "about 0.8 GB, and 0.5 GB are free: end other programs"),
        (64e9, 2 << 30, 1, ""),
    ],
)
def test_what_will_not_fit_is_said(monkeypatch, free, limit, jobs, said):
    monkeypatch.setattr(process, "free_memory", lambda: free)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    found = process.short_of_memory(jobs)
    assert (said in found) if said else not found


@pytest.mark.parametrize(
    ("own", "at", "limit", "used", "idle"),
    [
        ("0::/", "", "memory.max", "memory.current", "inactive_file"),
        ("0::/slurm/job_7", "slurm/job_7", "memory.max", "memory.current", "inactive_file"),
        ("3:cpu:/\n0::/slurm/job_7", "slurm", "memory.max", "memory.current", "inactive_file"),
        ("0::/of/another/machine", "", "memory.max", "memory.current", "inactive_file"),
        ("9:memory:/a\n0::/", "memory/a", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ],
)
def test_what_containers_and_clusters_leave_of_the_memory(tmp_path, own, at, limit, used, idle):
    """Where the limit is its group's own or that of one around it; what was read of files is given up when it is needed."""
    group = tmp_path / "groups" / at
    (tmp_path / "groups" / "slurm" / "job_7").mkdir(parents=True)
    group.mkdir(parents=True, exist_ok=True)
    (tmp_path / "own").write_text(own)
    (tmp_path / "groups" / "memory.max").write_text("max")
    for name, text in ((limit, "2000"), (used, "1500"), ("memory.stat", f"cache 9\n{idle} 100\n")):
        (group / name).write_text(text)
    assert list(process._left_by_groups(tmp_path / "own", tmp_path / "groups")) == [600.0]
    assert not list(process._left_by_groups(tmp_path / "none", tmp_path / "groups"))


def test_too_few_addresses_are_refused_before_anything_is_loaded(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1 << 30, 1 << 30))
    with pytest.raises(MissingError, match=r"may take 1\.1"):
        process.short_of_memory(1)


def test_too_little_memory_is_no_bug(run):
    command = [*PROGRAM, "dataset", "--run", str(run), "--force"]
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=little_memory)
    assert done.returncode == 4, done.stderr
    assert "ulimit -v" in done.stderr
    assert "not enough memory" in done.stderr


def little_memory() -> None:
    """For the child process: too few addresses to load PyTorch."""
    resource.setrlimit(resource.RLIMIT_AS, (600 << 20, 600 << 20))


def test_output_to_a_full_disk(run):
    with open("/dev/full", "w") as full:
        done = subprocess.run([*PROGRAM, "status", "--run", str(run)], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 3
    assert "cannot be written" in done.stderr


def test_two_trainings_with_different_settings_at_once_say_so(run):
    words = [*PROGRAM, "train", "--run", str(run), "--steps"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen([*words, str(steps)], **pipes) for steps in (60, 70)]
    said = "".join(process.communicate()[1] for process in both)
    assert [process.returncode for process in both] == [0, 0]
    assert "another piegraph has just made model otherwise (settings changed: steps)" in said
    assert "another piegraph has changed train.piegraph.steps meanwhile" in said


def test_two_at_once_on_one_stage_and_the_next(run, tiny_run):
    shutil.rmtree(run / "metrics")
    (run / "plan.h5").unlink()
    commands = [[*PROGRAM, word, "--run", str(run)] for word in ("run", "evaluate")]
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for command in commands
    ]
    said = [process.communicate() for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert not different(run, tiny_run)


def test_settings_of_another_stage_are_kept_beside_those_of_this_one(run):
    """Both commands had read the recipe before either kept its settings."""
    from piegraph_cli.stages import STAGES, open_run
    from piegraph_cli.workspace.together import keep_settings

    opened = [open_run(run), open_run(run)]
    for one, stage, values in zip(opened, ("train", "plan"), ({"seeds": [3]}, {"samples": 9}), strict=True):
        before = one.recipe
        one.recipe = before.with_values(STAGES[stage], values, "test", run)
        keep_settings(one, STAGES[stage], before)
    found = open_run(run).recipe.sections
    assert (found["train"]["seeds"], found["plan"]["samples"]) == ([3], 9)


def test_one_that_is_killed_while_it_holds_a_lock_leaves_it_free(run):
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"""
import os, signal, time
from pathlib import Path
from piegraph_cli.workspace.locks import held
with held(Path({str(run)!r}) / ".locks" / "dataset.lock"):
    print("held", flush=True)
    time.sleep(600)
""",
        ],
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    waiting = subprocess.Popen([*PROGRAM, "dataset", "--run", str(run), "--force"], stderr=subprocess.PIPE, text=True)
    assert waiting.stderr is not None
    assert "waiting for another piegraph" in waiting.stderr.readline()
    holder.kill()
    assert waiting.wait(60) == 0
    holder.wait()


def test_a_run_that_moved_is_fresh(run, tmp_path):
    run.rename(tmp_path / "elsewhere")
    assert "all is fresh" in piegraph("run", "--run", tmp_path / "elsewhere", "--dry").stdout
