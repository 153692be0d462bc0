"""HDF5 files whose bytes nobody vouches for are read in a process of their own first: there a crash or a hang is an error.

`python -m piegraph_cli.workspace.probe` is that process: a line of JSON for each file, answered by one.
"""

import atexit
import contextlib
import importlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from piegraph_cli.errors import DataError

SECONDS, BYTES_A_SECOND = 5.0, 20e6
"""How long a file may take: so long, and for its bytes."""
MEMORY, TIMES = 1 << 29, 4
"""Bytes that reading a file may take: so many, and its size so many times."""
START = 60.0
"""Seconds that starting may take."""

_running: list[tuple[int, subprocess.Popen]] = []
"""Processes that wait for a file, each with the one that started it: a fork of that has to start its own."""


def probe(path: Path, hint: str, **how: Any) -> None:
    """Read a file elsewhere, as `read_artifact` does it with `how`, or the datasets `at` the root of any file.

    Raises `DataError` where that is refused, or ends the process, takes too long or too much memory.
    """
    owner, process = _running.pop() if _running else (0, None)
    if process is None or owner != os.getpid():
        process = _start()
    answer = None
    with contextlib.suppress(OSError, ValueError):
        _tell(process, {"path": str(path.absolute()), "hint": hint, **how})
        answer = _answer(process, SECONDS + path.stat().st_size / BYTES_A_SECOND)
    if answer is None:
        process.kill()
        status = process.wait()
        why = "takes too long to read" if status == -9 else "breaks what reads it"
        raise DataError(f"is no whole HDF5 file: it {why}", str(path), hint)
    _running.append((os.getpid(), process))
    if answer:
        raise DataError(answer["message"], answer["where"].replace(str(path.absolute()), str(path)), answer["hint"])


def _start() -> subprocess.Popen:
    command = [sys.executable, "-m", __name__]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    atexit.register(process.kill)
    if _answer(process, START) is None:
        raise DataError("a process to read files in did not start", "", "is there memory left?")
    return process


def _tell(process: subprocess.Popen, request: Mapping[str, Any]) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps(request).encode() + b"\n")
    process.stdin.flush()


def _answer(process: subprocess.Popen, seconds: float) -> dict[str, Any] | None:
    """The next line that a process writes; None where it writes none in time, or ends."""
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], seconds)
    line = process.stdout.readline() if ready else b""
    return json.loads(line) if line.endswith(b"\n") else None


def _serve() -> None:
    """Answer requests until there are none: with nothing where a file can be read, else with what is wrong."""
    import resource
    import signal

    import h5py  # noqa: F401 - so that what it takes is in `taken`
    import numpy as np  # noqa: F401

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asked gets it too, and ends this
    print("{}", flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        limit = taken + MEMORY + TIMES * Path(request["path"]).stat().st_size
        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (limit if most < 0 else min(limit, most), most))
        try:
            _read(**request)
            answer = {}
        except DataError as error:
            answer = {"message": error.message, "where": error.where, "hint": error.hint}
        print(json.dumps(answer), flush=True)


def _read(path: str, hint: str, name: str | None = None, at: list[str] | None = None) -> None:
    module, reader = ("structure", "read_datasets") if at else ("artifact", "read_artifact")
    read = getattr(importlib.import_module(f"piegraph_cli.workspace.{module}"), reader)
    try:
        read(Path(path), *([at, hint] if at else [name]), probed=True)
    except MemoryError:
        raise DataError("is no whole HDF5 file: it takes too much memory to read", path, hint) from None


if __name__ == "__main__":
    _serve()
