"""Files that are at every moment absent, the old ones, or the whole new ones."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from piegraph_cli.errors import DataError, PiegraphError, UsageError

NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}
"""How a file system says that nothing more can be written: full, without inodes too, beyond a quota or a limit, read-only."""
MAKE_ROOM = "free disk space or check permissions, then rerun"
NOT_OURS = {errno.EACCES, errno.EPERM, errno.ELOOP, errno.EIO, errno.ESTALE}
"""How it says that a file is there and cannot be used: no right to, links round and round, a disk or a server that fails."""


def refused(error: Exception, where: str) -> PiegraphError | None:
    """What people can mend about an error that nobody foresaw, of a file without another name `where`; else None."""
    if not isinstance(error, OSError):
        return None
    file = str(error.filename or where)
    if error.errno in NO_SPACE:
        return DataError(f"cannot be written: {error}", file, MAKE_ROOM)
    if error.errno in NOT_OURS:
        return DataError(f"cannot be used: {error.strerror}", file, "give yourself the right to it; look at the disk")
    if error.errno == errno.ENAMETOOLONG:
        return UsageError(f"cannot be a file: {error.strerror}", f"{file:.80}", "a shorter name")
    return None


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder; on success sync it and rename it to `path`, on failure remove it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise DataError(f"cannot be written: {error}", str(path), MAKE_ROOM) from error
    finally:
        with contextlib.suppress(OSError):  # where nothing can be written, nothing was
            temporary.unlink(missing_ok=True)
    with contextlib.suppress(
        OSError
    ):  # the whole new file is there; where folders are not synced, a power cut may undo it
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def remove_leftovers(path: Path) -> None:
    """Remove temporary files of `path` that a killed process left behind; call with the artifact's lock held."""
    for leftover in path.parent.glob(f".{path.name}.*.tmp"):
        leftover.unlink(missing_ok=True)
