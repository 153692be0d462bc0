"""A process that answers requests, one JSON line each, and is not trusted: time limits, checked replies, a sure end.

What it says on stderr goes to a temporary file, whose last lines are shown when something is wrong.
"""

import json
import os
import selectors
import signal
import subprocess
import tempfile
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any, TypeVar

import numpy as np

from piegraph_cli.environments.daxbench_child import unpack
from piegraph_cli.errors import DataError, UsageError

Answer = TypeVar("Answer")
HELP = "docs/daxbench.md says how to set it up"
MOST_BYTES = 64 * 2**20
"""In one reply."""
_CHUNK = 2**16
_GRACE = 1.0
"""Seconds that a process which closed a pipe has to end by itself, so that its exit code is known."""
_TAIL_LINES = 8


class Process:
    """One process with its whole process group; killed by `stop`, at the exit of piegraph, and by any error in `ask`.

    Raises UsageError when the command cannot be started.
    """

    def __init__(self, command: list[str], where: str, timeout: float):
        self._where, self._timeout, self._number = where, timeout, -1
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by _stop
        try:
            # a session of its own: Ctrl-C is piegraph's to handle, and killing it takes what it started along
            self._process = subprocess.Popen(
                command,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                start_new_session=True,
            )
        except OSError as error:
            self._log.close()
            raise UsageError(f"{command[0]} cannot be started: {error.strerror}", where, HELP) from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        self.stop = weakref.finalize(self, _stop, self._process, self._log)
        """End it; does nothing the second time."""
        for pipe in (self._stdin, self._stdout):
            os.set_blocking(pipe.fileno(), False)

    @property
    def running(self) -> bool:
        """Whether it can be asked."""
        return self.stop.alive and self._process.poll() is None

    def ask(self, do: str, read: Callable[[dict[str, Any]], Answer], **fields: Any) -> Answer:
        """Send a request and return what `read` makes of the reply. The first one, "start", is the process's own.

        `read` raises ValueError, KeyError or TypeError for a reply that is not what was asked for. After any error,
        an interruption included, the process is gone: half a reply must not answer the next request.
        Raises DataError.
        """
        self._number += 1
        request = json.dumps({"id": self._number, "do": do, **fields}).encode() + b"\n"
        try:
            try:
                reply = self._parse(self._exchange(request if self._number else b""))
                return read(reply)
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                raise _Broken(f"sent a broken message ({clean(str(error))[:200]})") from None
        except _Broken as broken:
            raise self._failure(broken, do) from None
        except BaseException:
            self.stop()
            raise

    def _exchange(self, request: bytes) -> bytes:
        """Write a request while reading, since either pipe may be full, until a line has come."""
        deadline = time.monotonic() + self._timeout
        received = bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdout, selectors.EVENT_READ)
            if request:
                selector.register(self._stdin, selectors.EVENT_WRITE)
            while not received.endswith(b"\n"):
                left = deadline - time.monotonic()
                if left <= 0:
                    raise _Broken(f"did not answer within {self._timeout:g} s")
                for key, _ in selector.select(left):
                    if key.fileobj is self._stdout:
                        received += self._receive(len(received))
                        continue
                    try:
                        request = request[os.write(self._stdin.fileno(), request[:_CHUNK]) :]
                    except BrokenPipeError:
                        raise _Gone("closed its input") from None
                    if not request:
                        selector.unregister(self._stdin)
        return bytes(received)

    def _receive(self, before: int) -> bytes:
        chunk = os.read(self._stdout.fileno(), _CHUNK)
        if not chunk:
            raise _Gone("closed its output")
        if before + len(chunk) > MOST_BYTES:
            raise _Broken(f"sent more than {MOST_BYTES // 2**20} MiB in one message")
        return chunk

    def _parse(self, line: bytes) -> dict[str, Any]:
        try:
            reply = json.loads(line)
        except (ValueError, RecursionError):
            raise _Broken(f"sent {line[:60]!r}, which is no message") from None
        if not isinstance(reply, dict) or reply.get("id") != self._number:
            raise _Broken(f"sent {line[:60]!r}, which answers no request")
        return reply

    def _failure(self, broken: "_Broken", do: str) -> DataError:
        """End the process and say what it did, how it ended and what it wrote last."""
        if isinstance(broken, _Gone):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_GRACE)
        code = self._process.poll()
        what = "crashed" if isinstance(broken, _Gone) and code is not None else str(broken)
        if code is None:
            fate = "it was stopped"
        else:
            fate = f"exit code {code}" if code >= 0 else f"killed by signal {-code}, {signal.strsignal(-code)}"
        size = os.fstat(self._log.fileno()).st_size
        tail = os.pread(self._log.fileno(), 4000, max(0, size - 4000)).decode(errors="replace")
        lines = [f"    {clean(line)}" for line in tail.splitlines() if line.strip()][-_TAIL_LINES:]
        self.stop()
        last = "\n".join(["; its last words:", *lines]) if lines else "; it wrote no message"
        hint = "run again, with a larger timeout if it was only slow"
        if do == "start":
            hint = "give --daxbench-python the Python of a virtual environment with DaXBench's packages"
        return DataError(f"the DaXBench process {what} in {do!r}: {fate}{last}", self._where, f"{hint}; {HELP}")


class _Broken(Exception):
    """What the process did that it should not."""


class _Gone(_Broken):
    """It closed a pipe, as a process that ends does."""


def _stop(process: subprocess.Popen, log: IO[bytes]) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for pipe in (process.stdin, process.stdout, log):
        if pipe is not None:
            pipe.close()


def clean(text: str) -> str:
    """Text of unknown origin without what a terminal would obey."""
    return "".join(c if c.isprintable() else " " for c in text)


def whole(packed: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A packed array of floats, of that shape. Raises ValueError for any other."""
    array = unpack(packed)
    if array.shape != shape or array.dtype.kind != "f":
        raise ValueError(f"an array {array.dtype} {array.shape} in place of floats {shape}")
    return array


def finite(array: np.ndarray) -> np.ndarray:
    """The array. Raises ValueError if it holds NaN or infinity."""
    if not np.isfinite(array).all():
        raise ValueError("numbers that are not finite")
    return array
