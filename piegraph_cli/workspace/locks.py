"""Locks between processes, by lock files; where the file system has none, a word, and everybody passes."""

import errno
import fcntl
import functools
import logging
import multiprocessing
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from piegraph_cli.errors import DataError
from piegraph_cli.files import MAKE_ROOM, NO_SPACE

log = logging.getLogger("piegraph")

NO_LOCKS = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}
"""What file systems without locks answer, as NFS without its lock daemon does."""


@contextmanager
def held(file: Path) -> Iterator[bool]:
    """Hold the lock of a file, which is made; tells whether another process had it, and was waited for.

    Raises `DataError` where the file cannot be made.
    """
    if not have_locks(file.parent):
        yield False
        return
    lock, waited = FileLock(file), False
    try:
        lock.acquire(timeout=0)
    except Timeout:
        log.info("waiting for another piegraph that works on %s", file)
        lock.acquire()
        waited = True
    except OSError as error:
        raise DataError(f"cannot be written: {error}", str(file), MAKE_ROOM) from None
    try:
        yield waited
    finally:
        lock.release()


def have_locks(folder: Path) -> bool:
    """Whether the file system of a folder, which is made, has locks: found out by trying, and said once where it has none."""
    return _have_locks(Path(os.path.realpath(folder)))


@functools.lru_cache(maxsize=64)
def _have_locks(folder: Path) -> bool:
    probe = folder / f".probe.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with open(probe, "w") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError as error:
        if error.errno not in NO_LOCKS:
            full = error.errno in NO_SPACE - {errno.EROFS}
            hint = MAKE_ROOM if full else "check permissions, or copy the run"
            raise DataError(f"cannot be written: {error}", str(folder), hint) from None
        if multiprocessing.current_process().name == "MainProcess":  # which says it for its workers
            log.warning(
                "%s: this file system has no locks: let only one piegraph work on this run at a time", folder.parent
            )
        return False
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
