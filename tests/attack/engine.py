"""Runs attacks in processes that may crash, hang or grow, and counts what became of each.

An attack changes a copy of something whole and reads it as piegraph does. It may be refused with an error for people, or read
as if nothing had happened. A fault is anything else: another exception, a process that ends, takes longer than `SLOWEST` or
grows by more than `MOST`, and where a checksum says what was written, a result that differs.
"""

import contextlib
import os
import pickle
import resource
import select
import shutil
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import PiegraphError

SLOWEST = 10.0
"""Seconds that reading may take."""
PATIENCE = 300.0
"""Seconds that damaging may take, which is no part of it."""
MOST = 1 << 30
"""Bytes."""


@dataclass(frozen=True)
class Attack:
    """One kind of attack."""

    name: str
    make: Callable[[Path], Path]
    """Makes something whole in a folder; returns what is read."""
    change: Callable[[Path, np.random.Generator], str]
    """Damages it."""
    read: Callable[[Path], Any]
    """Reads it: whatever can be pickled and compared."""
    sealed: bool = False
    """Whether reading it with another result is a fault."""
    refused: bool = False
    """Whether reading it at all is a fault."""


@dataclass
class Tally:
    """What became of the attacks of one kind."""

    counts: Counter = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def add(self, outcome: str, what: str) -> None:
        self.counts[outcome] += 1
        if outcome not in ("refused", "same", "other"):
            self.faults.append(f"{outcome}: {what}")


def run_attack(attack: Attack, seeds: Iterator[int], folder: Path, tally: Tally, until: float = float("inf")) -> None:
    """Attack with seed after seed until there are none, or until a time; a process that is lost is replaced."""
    base = folder / "whole"
    base.mkdir(parents=True)
    place = attack.make(base).relative_to(base)
    whole = _digest(attack.read(base / place))
    for seed in seeds:
        if time.monotonic() > until:
            return
        for last, outcome, what in _in_a_process(attack, [seed, *_some(seeds, 200)], folder, place, whole, until):
            tally.add(outcome, f"{attack.name} seed {last}: {what}")


def _some(seeds: Iterator[int], count: int) -> list[int]:
    return list(islice(seeds, count))


def _in_a_process(
    attack: Attack, seeds: list[int], folder: Path, place: Path, whole: bytes, until: float
) -> Iterator[tuple[int, str, str]]:
    """Outcomes of attacks, in forked processes: a new one after each that is lost."""
    while seeds and time.monotonic() < until:
        reads, writes = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reads)
            with contextlib.suppress(BaseException):
                _work(attack, seeds, folder, place, whole, writes, until)
            os._exit(0)
        os.close(writes)
        current, made, finished = None, "", False
        with os.fdopen(reads, "rb", buffering=0) as pipe:
            for message in _messages(pipe, child):
                if message[0] == "begin":
                    current, made = message[1], "the damage could not be done"
                elif message[0] == "made":
                    made = message[1]
                elif message[0] == "end":
                    finished = True
                else:
                    yield message[1:]
                    current = None
                    seeds = seeds[seeds.index(message[1]) + 1 :]
        _, status = os.waitpid(child, 0)
        if finished:
            return
        if current is not None:
            lost = "hang" if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGUSR1 else "crash"
            yield current, lost, f"{made}; status {status}"
            seeds = seeds[seeds.index(current) + 1 :]


def _messages(pipe: Any, child: int) -> Iterator[tuple]:
    """What a process tells; it is ended where it reads for too long."""
    data, reading = b"", False
    while True:
        ready, _, _ = select.select([pipe], [], [], SLOWEST if reading else PATIENCE)
        if not ready:
            os.kill(child, signal.SIGUSR1)  # whose default is to end it, and which nothing else sends
        part = pipe.read(1 << 16)
        if not part:
            return
        data += part
        while len(data) >= 4 and len(data) >= 4 + (size := int.from_bytes(data[:4], "big")):
            message = pickle.loads(data[4 : 4 + size])
            reading = message[0] == "made"
            yield message
            data = data[4 + size :]


def _work(attack: Attack, seeds: list[int], folder: Path, place: Path, whole: bytes, pipe: int, until: float) -> None:
    """In a process of its own: attack after attack, each told before and after."""
    signal.signal(signal.SIGUSR1, signal.SIG_DFL)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    resource.setrlimit(resource.RLIMIT_AS, (before + (8 << 30), before + (8 << 30)))

    def tell(*message: Any) -> None:
        data = pickle.dumps(message)
        os.write(pipe, len(data).to_bytes(4, "big") + data)

    changed = folder / f"changed.{os.getpid()}"
    for seed in seeds:
        if time.monotonic() > until:
            break
        shutil.rmtree(changed, ignore_errors=True)
        shutil.copytree(folder / "whole", changed)
        tell("begin", seed)
        what = attack.change(changed / place, np.random.default_rng(seed))
        tell("made", what)
        outcome, why = _outcome(attack, changed / place, whole)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10) - before
        if grown > MOST:
            outcome, why = "memory", f"{grown >> 20} MiB more, {outcome} {why}"
        tell("done", seed, outcome, f"{what}; {why}")
        if grown > MOST:
            break  # what it took once counts for this process from now on
    else:
        tell("end")
    shutil.rmtree(changed, ignore_errors=True)


def _outcome(attack: Attack, path: Path, whole: bytes) -> tuple[str, str]:
    try:
        same = _digest(attack.read(path)) == whole
    except PiegraphError as error:
        return "refused", str(error)
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return "traceback", f"{type(error).__name__}: {error} at {last.filename}:{last.lineno}"
    if attack.refused:
        return "accepted", "what has to be refused"
    if attack.sealed and not same:
        return "differs", "accepted with another result"
    return ("same" if same else "other"), ""


def _digest(value: Any) -> bytes:
    """What is compared: values, shapes and types."""
    import hashlib

    return hashlib.sha256(_flat(value)).digest()


def _flat(value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}".encode() + value.tobytes()
    if isinstance(value, dict):
        return b"{" + b",".join(str(key).encode() + _flat(inner) for key, inner in sorted(value.items())) + b"}"
    if isinstance(value, list | tuple):
        return b"[" + b",".join(map(_flat, value)) + b"]"
    return repr(value).encode("utf-8", "backslashreplace")
