"""Ctrl-C, SIGTERM and SIGHUP at any moment: one line and an exit code, no traceback, and nothing goes on running."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from piegraph_cli import signals

INSIDE = """
import os, signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a test under nohup inherits that it is ignored
from piegraph_cli.__main__ import main
from piegraph_cli.commands import program

def work(*arguments, **options):
{}

program.app = work
main()
"""


def inside(body: str) -> subprocess.CompletedProcess:
    """How the program ends that does this in place of a command."""
    lines = "\n".join(f"    {line}" for line in body.splitlines())
    return subprocess.run([sys.executable, "-c", INSIDE.format(lines)], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(
    ("number", "code", "said"), [("SIGINT", 130, "interrupted"), ("SIGTERM", 143, "SIGTERM"), ("SIGHUP", 129, "SIGHUP")]
)
def test_each_signal_ends_with_its_code_and_a_word(number, code, said):
    ended = inside(f"signal.raise_signal(signal.{number})")
    assert ended.returncode == code
    assert said in ended.stderr
    assert ended.stderr.strip().endswith("the same command goes on from here")
    assert len(ended.stderr.splitlines()) == 1


def test_a_signal_that_a_module_makes_into_another_error_is_no_bug():
    ended = inside(
        "try:\n    signal.raise_signal(signal.SIGINT)\nexcept KeyboardInterrupt:\n"
        "    raise ImportError('multiarray failed to import')"
    )
    assert (ended.returncode, len(ended.stderr.splitlines())) == (130, 1)
    assert "goes on from here" in ended.stderr


def test_a_signal_that_is_dropped_ends_what_counts():
    ended = inside(
        "from piegraph_cli.workspace.progress import counting\n"
        "for k in counting(lambda *_: None, 9, 'steps')(range(9)):\n"
        "    try:\n        signal.raise_signal(signal.SIGTERM)\n    except KeyboardInterrupt:\n        print(k)"
    )
    assert (ended.returncode, ended.stdout) == (143, "0\n")


def test_the_second_signal_ends_at_once_and_one_sent_twice_is_one():
    deaf = "signal.raise_signal(signal.SIGINT)\nexcept KeyboardInterrupt:\n    pass\n"
    begin = time.monotonic()
    ended = inside(f"try:\n    {deaf}time.sleep(0.5)\nsignal.raise_signal(signal.SIGINT)\ntime.sleep(40)")
    assert (ended.returncode, ended.stderr) == (130, "")
    assert time.monotonic() - begin < 30
    ended = inside(f"try:\n    {deaf}signal.raise_signal(signal.SIGINT)\nprint('on')\nreturn 0")
    assert (ended.returncode, ended.stdout) == (0, "on\n")


@pytest.mark.parametrize("module", ["typer", "piegraph_cli.commands.runs"])
def test_a_signal_while_modules_are_imported_is_a_signal(module):
    program = f"""
import signal, sys
class Falls:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Falls())
from piegraph_cli.__main__ import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (130, "interrupted\n")


def test_little_is_imported_before_signals_are_taken():
    """A signal that comes in between is Python's, with its traceback."""
    program = (
        "import sys; before = set(sys.modules); import piegraph_cli.signals; print(*(sys.modules.keys() - before))"
    )
    ended = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True, check=True)
    assert not {"typing", "re", "importlib.util", "pathlib", "logging"} & set(ended.stdout.split())


def test_what_is_ignored_stays_ignored():
    program = """
import signal
signal.signal(signal.SIGHUP, signal.SIG_IGN)
from piegraph_cli.signals import obey
obey()
signal.raise_signal(signal.SIGHUP)
print("on")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (0, "on\n"), "as under nohup"


WORKERS = """
import os, sys, time
from piegraph_cli.__main__ import main
from piegraph_cli.commands import program
from piegraph_cli.workspace.parallel import each

def sleep(item):
    print(os.getpid(), flush=True)
    time.sleep(60)

def work(*arguments, **options):
    list(each(sleep, range(2), 2, "local", None))

program.app = work
main()
"""


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return open(f"/proc/{pid}/stat").read().rpartition(")")[2].split()[0] == "Z"


def within(seconds: float, holds: Callable[[], bool]) -> bool:
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.05)
    return holds()


@pytest.mark.parametrize(("number", "code"), [("SIGTERM", 143), ("SIGINT", 130), ("SIGKILL", -9)])
def test_workers_end_with_who_started_them_however_that_ends(number, code, tmp_path):
    (tmp_path / "job.py").write_text(WORKERS)
    command = [sys.executable, "job.py"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    workers = [int(process.stdout.readline()) for _ in range(2)]
    time.sleep(0.2)
    process.send_signal(getattr(signal, number))
    _, stderr = process.communicate(timeout=60)  # ends when the last one that holds the pipe is gone
    assert process.returncode == code
    assert within(10, lambda: all(map(gone, workers)))
    assert "Traceback" not in stderr
    assert "leaked" not in stderr


def test_a_terminals_signal_does_not_reach_workers(tmp_path):
    (tmp_path / "job.py").write_text(WORKERS)
    command = [sys.executable, "job.py"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr == "interrupted; the same command goes on from here\n"


@pytest.mark.parametrize(("number", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_as_the_first_process_of_a_container(number, code, tmp_path):
    """There a signal that nobody takes does nothing, and nobody else waits for what is left."""
    alone = ["unshare", "--pid", "--fork", "--mount-proc"]
    if os.geteuid() or subprocess.run([*alone, "true"], capture_output=True).returncode:
        pytest.skip("to be the first process takes root")
    (tmp_path / "job.py").write_text(WORKERS)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([*alone, sys.executable, "job.py"], cwd=tmp_path, **pipes)
    assert process.stdout is not None
    for _ in range(2):
        process.stdout.readline()
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True).stdout
    os.kill(int(listed), getattr(signal, number))
    _, stderr = process.communicate(timeout=60)  # ends when the last one that holds the pipe is gone
    assert process.returncode == code
    assert stderr.endswith("the same command goes on from here\n")
    assert len(stderr.splitlines()) == 1


def test_nothing_is_held_back_afterwards():
    with signals.held_back():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signals.stopped() is None
