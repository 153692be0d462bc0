"""Signals that end the program: Ctrl-C, SIGTERM and SIGHUP end it alike, whenever they come, with all that it has started.

The first one raises `KeyboardInterrupt` in the main thread. Python code, and more often a module in C that is being imported,
may drop that or turn it into another error: it is therefore kept that a signal came, and who goes on asks `stopped`.
"""

import atexit
import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

TYPE_CHECKING = False  # of Python's own: importing it takes as long as all the rest here, and signals come meanwhile
if TYPE_CHECKING:
    from typing import NoReturn

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
SAME = 0.3
"""Seconds in which a signal that comes again is the same one: a terminal and a wrapper may both send it."""
PATIENCE = 3.0
"""Seconds that what is registered for the end may take."""
WATCHED = 0.5
"""Seconds between looks whether the process that started this one is still there."""

_came: tuple[int, float] | None = None
_over = False


def obey() -> None:
    """Let the signals end this process: once as an interruption, the second time at once. What is ignored stays ignored."""
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)
    sys.unraisablehook = _again


def stopped() -> int | None:
    """The signal that shall end this process, or None."""
    return _came[0] if _came else None


def over() -> None:
    """Say that the program is done but for its end, which no exception is to disturb: a signal then ends it at once."""
    global _over
    _over = True


def leave(code: int) -> "NoReturn":
    """End the process that a signal was to end: what is registered for the end is done, and threads are not waited for.

    Python would wait for those of native code; and where an interruption went through `exec`, as in imports, end by SIGINT.
    """
    late = threading.Timer(PATIENCE, os._exit, (code,))
    late.daemon = True
    late.start()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def go_on() -> None:
    """Raises `KeyboardInterrupt` where a signal came, whatever became of it then."""
    if _came:
        raise KeyboardInterrupt


def _end(number: int, frame: FrameType | None) -> None:
    global _came
    if _came is None:
        _came = number, time.monotonic()
        if not _over:
            raise KeyboardInterrupt
        os._exit(128 + number)
    if time.monotonic() - _came[1] > SAME:
        os._exit(128 + number)


def _again(unraisable: "sys.UnraisableHookArgs") -> None:
    """An interruption that falls into a destructor, where Python drops exceptions, comes once more."""
    if unraisable.exc_type is KeyboardInterrupt:
        threading.Timer(0.1, _repeat).start()
    else:
        sys.__unraisablehook__(unraisable)


def _repeat() -> None:
    global _came
    if _over:
        return
    number, _came = stopped() or signal.SIGINT, None
    os.kill(os.getpid(), number)


@contextmanager
def held_back() -> Iterator[None]:
    """Signals of a terminal wait meanwhile, and do not reach the processes that are started: who started them ends them."""
    kept = signal.pthread_sigmask(signal.SIG_BLOCK, {n for n in ENDING if n != signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, kept)


@functools.cache
def end_with(parent: int) -> None:
    """End this process soon after the one that has started it, however that ends; called as soon as it runs."""
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCHED)
    os._exit(1)
