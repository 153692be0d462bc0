"""How far a stage is over all of its units: counted where they are worked on, shown on a terminal in one line."""

import contextlib
import json
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from piegraph_cli.signals import go_on

Item = TypeVar("Item")

Tell = Callable[[str, int, int, str], None]
"""Told the unit, how many are done, of how many, and what they are."""

EVERY = 0.2
"""Seconds between what is told of one unit."""
LISTENS = 0.2
"""Seconds after which who listens looks whether it is over."""


def counting(
    tell: Callable[[int, int, str], None], total: int, what: str
) -> Callable[[Iterable[Item]], Iterator[Item]]:
    """What gives the items of one or several iterables, `total` in all, and tells how many were worked through."""
    done, last = 0, 0.0
    tell(done, total, what)

    def over(items: Iterable[Item]) -> Iterator[Item]:
        nonlocal done, last
        for item in items:
            go_on()
            yield item
            done += 1
            if time.monotonic() - last > EVERY:
                last = time.monotonic()
                tell(done, total, what)

    return over


@dataclass(frozen=True)
class Sender:
    """Tells the process that listens at an address; nobody waits, and what is lost is lost."""

    address: str

    def __call__(self, unit: str, done: int, total: int, what: str) -> None:
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            out.setblocking(False)
            out.sendto(json.dumps([unit, done, total, what]).encode(), self.address)


class Meter:
    """A line on stderr: how far all units are, and the time left; of units that have not begun the mean is taken."""

    def __init__(self, stage: str, units: int, kind: str):
        from tqdm import tqdm

        self.units, self.kind, self.finished = units, kind, 0
        self.told: dict[str, tuple[int, int]] = {}
        self.lock = threading.Lock()
        self.bar = tqdm(total=units, desc=stage, unit=f" {kind}s", leave=False, delay=1)

    def tell(self, unit: str, done: int, total: int, what: str) -> None:
        """What one unit says of itself."""
        with self.lock:
            self.told[unit] = done, total
            self.bar.unit = f" {what}"
            self._draw()

    def finish(self, unit: str) -> None:
        """One unit is through."""
        with self.lock:
            self.finished += 1
            if unit in self.told:
                total = self.told[unit][1]
                self.told[unit] = total, total
            self._draw()

    def _draw(self) -> None:
        done, total = self.finished, self.units
        if self.told:
            done, known = (sum(of[k] for of in self.told.values()) for k in (0, 1))
            silent = max(0, self.finished - sum(a == b for a, b in self.told.values()))
            total = known + round(known / len(self.told) * (self.units - len(self.told) - silent))
            if self.units > 1:
                self.bar.set_postfix_str(f"{self.finished}/{self.units} {self.kind}s", refresh=False)
        self.bar.total = max(done, total)
        self.bar.update(done - self.bar.n)


@contextlib.contextmanager
def watching(
    stage: str, units: int, kind: str, processes: bool, here: bool
) -> Iterator[tuple[Tell, Callable[[str], None]]]:
    """Show how far a stage is where stderr is a terminal: what units are to tell, and who hears that one is through.

    `processes`: whether others of this machine do the work; nothing is told from another machine, not `here`.
    """
    if not sys.stderr.isatty():
        yield silent, silent
        return
    meter = Meter(stage, units, kind)
    with contextlib.closing(meter.bar):
        if here and processes:
            with _listening(meter) as sender:
                yield sender, meter.finish
        else:
            yield meter.tell if here else silent, meter.finish


@contextlib.contextmanager
def _listening(meter: Meter) -> Iterator["Sender"]:
    """Take in what other processes of this machine tell."""
    with tempfile.TemporaryDirectory(prefix="piegraph-") as folder:
        place = os.path.join(folder, "progress")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
            ear.bind(place)
            ear.settimeout(LISTENS)
            over = threading.Event()
            thread = threading.Thread(target=_listen, args=(ear, meter, over), daemon=True)
            thread.start()
            try:
                yield Sender(place)
            finally:
                over.set()
                thread.join()


def _listen(ear: socket.socket, meter: Meter, over: threading.Event) -> None:
    while not over.is_set():
        with contextlib.suppress(TimeoutError, ValueError, TypeError):
            meter.tell(*json.loads(ear.recv(4096)))


def silent(*_: Any) -> None:
    """Tells nobody."""
