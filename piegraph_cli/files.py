"""Files that are at every moment absent, the old ones, or the whole new ones."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from piegraph_cli.errors import DataError

NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}
"""How a file system says that nothing more can be written: full, without inodes too, beyond a quota or a limit, read-only."""
MAKE_ROOM = "free disk space or check permissions, then rerun"


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
