"""`python -m tests.attack.kills SECONDS`: SIGKILL, SIGTERM and Ctrl-C at random moments of all stages, until the time is up.

A command is stopped at a drawn moment and started again, until it ends by itself; then its artifacts are to be those of a
run that nobody stopped, byte for byte. After each stop: the exit code, one line and no traceback, no artifact that is not
whole, no failure that was noted, and within ten seconds no process that goes on. Most commands are forked from this
process, which has imported PyTorch; one in ten is a program of its own, so that a stop can fall into its imports as well.
"""

import argparse
import faulthandler
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from piegraph_cli import signals
from tests.attack.chains import OF_RECORDING, SIMULATED, Chain, artifacts, broken, different, trials_of
from tests.cli import PROGRAM
from tests.forks import become, import_all

MARK = "PIEGRAPH_ATTACK"
PATIENCE = 10.0
"""Seconds in which all must have ended; those in which a process was ready and other work had its core do not count."""
SIGNALS = {"SIGKILL": -9, "SIGTERM": 143, "SIGINT": 130}
SHARES = (3, 1, 1)
"""How often each comes: 300, 100 and 100."""
OWN = 0.1
"""Share of commands that are programs of their own."""
SHORT, LONG = 4.0, 0.2
"""Most stops come within so many seconds; so large a share within half of what the whole takes, or nothing would be done."""
WHEN: dict[int | None, str] = {None: "before the program began, or without end", 0: "when all was done"}
"""What does not count as a stop, by what `stop` says."""
BOOTING = ("Fatal Python error", "<frozen importlib", "<frozen runpy", "<frozen site", "KeyboardInterrupt")


class Command:
    """A command line that runs in a session of its own, marked in the environment of all that it starts."""

    def __init__(self, arguments: tuple[str, ...], folder: Path, own: bool):
        self.mark, self.folder, self.own = uuid.uuid4().hex, folder, own
        self.logged = logged(folder)
        for name in ("stdout", "stderr"):
            (folder.parent / name).write_bytes(b"")
        environment = dict(os.environ) | {MARK: self.mark, "OMP_NUM_THREADS": "1"}
        files = {name: str(folder.parent / name) for name in ("stdout", "stderr")}
        if not own:  # until the program takes them, signals would reach what it is forked from
            signal.pthread_sigmask(signal.SIG_BLOCK, signals.ENDING)
            self.pid = os.fork()
        if own:
            with open(files["stdout"], "wb") as out, open(files["stderr"], "wb") as err:
                program = [*PROGRAM, *arguments]
                process = subprocess.Popen(
                    program, cwd=folder, env=environment, stdout=out, stderr=err, start_new_session=True
                )
                self.pid, process.returncode = process.pid, 0  # waited for here
        elif self.pid == 0:
            os.setsid()
            become({"arguments": list(arguments), "folder": str(folder), "environment": environment, **files})
            from piegraph_cli import __main__

            __main__.obey = begin
            __main__.main()
        else:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, signals.ENDING)

    def ended(self, seconds: float, more: Callable[[], float] = float) -> int | None:
        """The exit code, or None where it has not ended in time, and so many seconds `more`."""
        begin = time.monotonic()
        while True:
            found, status = os.waitpid(self.pid, os.WNOHANG)
            if found:
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() - begin > seconds + more():
                return None
            time.sleep(0.02)

    def left(self) -> list[int]:
        """Processes that it has started and that are still there."""
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    if f"{MARK}={self.mark}".encode() in (entry / "environ").read_bytes():
                        found.append(int(entry.name))
                except OSError:
                    continue
        return found

    def stderr(self) -> str:
        """What it has said."""
        return (self.folder.parent / "stderr").read_text(errors="replace")


def stop(command: Command, name: str, whole_group: bool, complete: Callable[[], bool]) -> tuple[int | None, list[str]]:
    """Stop a command; its exit code, and what is wrong about how it ended; `complete` tells whether all was made."""
    begin, before, apart = time.monotonic(), waited([command.pid]), waited(command.left())
    (os.killpg if whole_group else os.kill)(command.pid, getattr(signal, name))
    code = command.ended(PATIENCE, lambda: waited([command.pid]) - before)
    while (left := command.left()) and time.monotonic() - begin < PATIENCE + waited(left) - apart:
        time.sleep(0.1)
    wrong = [f"goes on after {PATIENCE} s: {left}"] if left or code is None else []
    if code is None and not command.own:
        os.kill(command.pid, signal.SIGUSR2)  # it says where it is
        time.sleep(1)
    for pid in {*left, *([command.pid] if code is None else [])}:
        os.kill(pid, signal.SIGKILL)
    if code is None:
        os.waitpid(command.pid, 0)
    text = command.stderr()
    if early(command, code, text):
        return None, wrong
    done = code == -getattr(signal, name) and complete()  # Python itself was ending
    if code != SIGNALS[name] and not done and not (code == 0 and complete()):
        wrong.append(f"exit code {code}: {text[-5000:]}")
    if "Traceback" in text or "leaked" in text or "bug in" in text:
        wrong.append(text[-1500:])
    return code, wrong


def waited(processes: list[int]) -> float:
    """Seconds that one of the threads of these processes, the one with most of them, has waited for a core in its life."""
    found = [0.0]
    for task in (task for pid in processes for task in Path(f"/proc/{pid}/task").glob("*/schedstat")):
        with suppress(OSError, IndexError):
            found.append(int(task.read_text().split()[1]) / 1e9)
    return max(found)


def early(command: Command, code: int | None, text: str) -> bool:
    """Whether Python itself was stopped, before piegraph took signals."""
    silent = logged(command.folder) == command.logged and "interrupted" not in text and "ended by" not in text
    of_python = code in (-signal.SIGTERM, -signal.SIGINT) or (code == 1 and any(word in text for word in BOOTING))
    return command.own and silent and of_python and "piegraph_cli/commands" not in text


def logged(folder: Path) -> int:
    """Bytes that the logs of a folder's runs have."""
    return sum(path.stat().st_size for path in folder.rglob("run.log"))


def fresh(folder: Path, chain: Chain) -> Path:
    """An empty folder in which a chain can begin."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    chain.prepare(folder)
    return folder


def begin() -> None:
    """What a forked program does first: only from then on signals reach it, as those that come before reach Python alone."""
    signals.obey()
    faulthandler.register(signal.SIGUSR2)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signals.ENDING)


class Campaign:
    """What was done and found."""

    def __init__(self, work: Path, seed: int):
        self.work, self.until, self.rng = work, 0.0, np.random.default_rng(seed)
        self.stops: Counter = Counter()
        self.stages: Counter = Counter()
        self.runs: Counter = Counter()
        self.faults: list[str] = []

    def reference(self, chain: Chain) -> tuple[Path, float]:
        """The run that nobody stops, and its seconds."""
        folder, begin = fresh(self.work / f"{chain.name} reference" / "in", chain), time.monotonic()
        command = Command(chain.arguments, folder, own=False)
        code = command.ended(3600)
        assert code == 0, command.stderr()
        return folder / chain.run, time.monotonic() - begin

    def attack(self, chain: Chain, expected: Path, span: float) -> None:
        """Stop one chain again and again until it ends by itself."""
        folder = fresh(self.work / chain.name / "in", chain)
        wanted = sum(1 for _ in artifacts(expected))
        while True:
            name = str(self.rng.choice(list(SIGNALS), p=np.array(SHARES) / sum(SHARES)))
            jobs, own = int(self.rng.integers(1, 3)), bool(self.rng.random() < OWN)
            delay = float(self.rng.uniform(0, span if self.rng.random() < LONG else SHORT))
            last = time.monotonic() > self.until
            command = Command((*chain.arguments, "--jobs", str(jobs)), folder, own and not last)
            code = command.ended(3600 if last else delay)
            if code is not None:
                self.finish(chain, folder, expected, code, command)
                return
            where = self.stage(folder / chain.run)
            group = name == "SIGINT" and bool(self.rng.random() < 0.5)
            code, wrong = stop(command, name, group, lambda: not different(folder / chain.run, expected))
            wrong += broken(folder / chain.run)
            self.stops[f"{name} {WHEN.get(code, f'--jobs {jobs}')}"] += 1
            self.stages[where] += 1
            self.faults += [f"{chain.name}, {name}, --jobs {jobs}, {where}: {text}" for text in wrong]
            for text in wrong:
                print("FAULT", self.faults[-1] if text in self.faults[-1] else text, flush=True)
            if sum(1 for _ in artifacts(folder / chain.run)) > 2 * wanted:
                raise AssertionError("more artifacts than there can be")

    def finish(self, chain: Chain, folder: Path, expected: Path, code: int, command: Command) -> None:
        """A run that ended by itself is to be as one that nobody stopped."""
        wrong = [f"exit code {code}: {command.stderr()[-800:]}"] if code else different(folder / chain.run, expected)
        self.runs[chain.name] += 1
        self.faults += [f"{chain.name}, at the end: {text}" for text in wrong]
        for text in wrong:
            print("FAULT at the end", chain.name, text, flush=True)

    def stage(self, run: Path) -> str:
        """What is being made: the artifact of the newest lock."""
        locks = [path for path in run.glob(".locks/*.lock") if path.name.split(".")[0] not in ("failures", "warnings")]
        newest = max(locks, key=lambda path: path.stat().st_mtime_ns, default=None)
        return newest.name.split(".")[0] if newest else "start"


def main() -> int:
    """Attack, print, and end with 1 where there was a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack.kills", description=__doc__)
    parser.add_argument("seconds", type=float, help="how long; the runs that are under way then are finished")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    # a shell's background jobs ignore it, and so would every command that is stopped here
    signal.signal(signal.SIGINT, signal.default_int_handler)
    import_all()
    gc.collect()
    gc.freeze()
    work = Path(tempfile.mkdtemp(prefix="kills"))  # no context: what is forked would leave it, too
    campaign = Campaign(work, given.seed)
    chains: list[Chain] = [SIMULATED, OF_RECORDING]
    references = {chain.name: campaign.reference(chain) for chain in chains}
    chains.append(trials_of(references[SIMULATED.name][0]))
    references["trials"] = campaign.reference(chains[-1])
    print({name: f"{seconds:.1f} s" for name, (_, seconds) in references.items()}, flush=True)
    campaign.until = time.monotonic() + given.seconds
    while time.monotonic() < campaign.until:
        for chain in chains:
            expected, seconds = references[chain.name]
            campaign.attack(chain, expected, 0.5 * seconds)
        _tell(campaign)
    _tell(campaign)
    shutil.rmtree(work)
    return int(bool(campaign.faults))


def _tell(campaign: Campaign) -> None:
    kinds = {name: sum(n for how, n in campaign.stops.items() if how.startswith(f"{name} --jobs")) for name in SIGNALS}
    print(f"{sum(kinds.values())} stops: {kinds}; with others: {dict(sorted(campaign.stops.items()))}")
    print(f"  while this was made: {dict(campaign.stages.most_common())}")
    print(f"  finished: {dict(campaign.runs)}; {len(campaign.faults)} faults", flush=True)


if __name__ == "__main__":
    sys.exit(main())
