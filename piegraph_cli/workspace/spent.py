"""On which machine an artifact is made and what time that takes: told in its attributes, in no key."""

import functools
import platform
import re
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

NANO = 1_000_000
"""Nanoseconds in a millisecond."""


@functools.cache
def machine() -> str:
    """The processor's name and how many cores of it this process may use."""
    warnings.filterwarnings("ignore", message=".*joblib will operate in serial mode")  # `--jobs` says it
    import joblib

    name = platform.processor() or platform.machine()
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(errors="replace"), re.MULTILINE)
        name = " ".join(found[1].split()) if found else name
    except OSError:
        pass
    cores = joblib.cpu_count()
    return f"{name}, {cores} core{'s' if cores > 1 else ''}"


@dataclass
class Clock:
    """Milliseconds since it was made, of the wall and of this process's threads, with those of an interrupted try before."""

    wall: int = field(default_factory=lambda: time.monotonic_ns() // NANO)
    processor: int = field(default_factory=lambda: time.process_time_ns() // NANO)

    def spent(self) -> dict[str, int]:
        """`wall_ms` and `cpu_ms`."""
        wall, processor = time.monotonic_ns() // NANO - self.wall, time.process_time_ns() // NANO - self.processor
        return {"wall_ms": wall, "cpu_ms": processor}

    def add(self, wall_ms: int, cpu_ms: int) -> None:
        """Count what was spent earlier."""
        self.wall -= wall_ms
        self.processor -= cpu_ms
