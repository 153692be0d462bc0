"""How this process treats its threads, its memory and what native code writes to stderr."""

import contextlib
import ctypes
import gc
import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

from piegraph_cli.errors import MissingError


def set_up_torch() -> None:
    """One thread, since the arrays are small; and freed memory stays with the process.

    glibc gives it back to the system after every operation and gets it again for the next, which took 40 % of the time
    of planning, and stops all threads of the process while it does.
    """
    import torch

    torch.set_num_threads(1)
    if sys.platform == "linux":
        trim_threshold, mmap_threshold = -1, -3
        with contextlib.suppress(AttributeError):  # another C library
            mallopt = ctypes.CDLL(None).mallopt
            mallopt(trim_threshold, 2**31 - 1)
            mallopt(mmap_threshold, 2**25)  # the most that glibc accepts


def choose_device(name: str) -> str:
    """`cuda` or `cpu` from `auto`, `cuda` or `cpu`. Raises `MissingError` for an absent GPU."""
    import torch

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise MissingError("PyTorch finds no CUDA device", "--device cuda", "leave --device out, or use --device cpu")
    return name


def free_memory() -> float | None:
    """Bytes that this machine, or the container that the process is in, has for more processes; None where it does not say."""
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = 1024.0 * int(next(line for line in lines if line.startswith("MemAvailable:")).split()[1])
        return min([free, *_left_by_groups(Path("/proc/self/cgroup"), Path("/sys/fs/cgroup"))])
    return None


def _left_by_groups(own: Path, groups: Path) -> Iterator[float]:
    """Bytes that each control group leaves which this process is in, as containers and clusters make them, of both versions.

    Files that were read and are no longer used count as used there, and are given up when memory is needed.
    """
    for line in own.read_text().splitlines() if own.exists() else ():
        kinds, place = line.split(":", 2)[1:]
        if kinds == "":
            base, limit, used = groups, "memory.max", "memory.current"
        elif "memory" in kinds.split(","):
            base, limit, used = groups / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        inner = base / place.lstrip("/")
        for group in (inner, *(parent for parent in inner.parents if parent.is_relative_to(base))):
            with contextlib.suppress(OSError, ValueError):  # "max" is no number
                most, now = (int((group / name).read_text()) for name in (limit, used))
                yield float(most - now + _idle_files(group / "memory.stat"))


def _idle_files(stat: Path) -> int:
    rows = dict(line.split() for line in stat.read_text().splitlines())
    return int(rows.get("total_inactive_file", rows.get("inactive_file", 0)))


NEED, SPACE = 0.8e9, 1.6e9
"""Bytes of memory and of addresses that a process with a small recording takes, most of them PyTorch's and OpenCV's."""
NO_MEMORY = ("cannot allocate memory", "failed to map segment", "out of memory", "bad alloc", "std::bad_alloc")
"""What libraries say where there is none left."""


def short_of_memory(processes: int) -> str:
    """What will not fit where so many processes work at a time; empty where nothing is known to be short.

    Raises `MissingError` where a process may not have the addresses that libraries take: in C they crash for want of them.
    """
    free, limit = free_memory(), resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < SPACE:
        takes = f"each process takes about {SPACE / 1e9:.1f} GB of addresses, and may take {limit / 1e9:.1f}"
        raise MissingError(f"there is not enough memory: {takes}", hint="raise `ulimit -v`")
    if free is None or free >= processes * NEED:
        return ""
    what = (
        f"about {NEED / 1e9:.1f} GB in each of {processes} processes" if processes > 1 else f"about {NEED / 1e9:.1f} GB"
    )
    fewer = f"give --jobs {max(1, int(free / NEED))}, or " if processes > 1 else ""
    return f"this takes {what}, and {free / 1e9:.1f} GB are free: {fewer}end other programs"


def out_of_memory(error: Exception) -> bool:
    """Whether an error says that there is no memory left."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(said in text for said in NO_MEMORY)


@contextlib.contextmanager
def imports_at_once() -> Iterator[None]:
    """Import heavy modules without collecting garbage meanwhile: all that they make stays, and looking through it again and
    again takes a third of the time that PyTorch needs to be there."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        if collecting:
            gc.enable()


@contextlib.contextmanager
def quiet_native() -> Iterator[None]:
    """Drop what native code writes to stderr: libraries report their start-up there, whatever the log level."""
    saved = os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(sink)
        os.close(saved)
