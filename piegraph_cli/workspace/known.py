"""What earlier reads found out about files, kept in the run folder: a file that has not changed is not read again.

Of artifacts the headers are kept, and so that their bytes are those of their checksum, or that they were refused; of
recordings and other sources the hash of their content. A file counts as unchanged as long as its size, inode and times are;
one that was changed moments before it was read is read again the next time, since a later change could fall into the same
tick of the clock. Nothing else is taken from the file: without it, or with a damaged one, everything is read again.
"""

import contextlib
import functools
import hashlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from piegraph_cli.errors import DataError, InputError
from piegraph_cli.files import atomic_file
from piegraph_cli.workspace.artifact import Artifact, Header, read_artifact, read_header
from piegraph_cli.workspace.schema import SCHEMA_VERSION

NAME = ".known.json"
VERSION = f"2.{SCHEMA_VERSION}"
TICK = 2_000_000_000
"""Nanoseconds within which two changes of a file may look like one."""

Stamp = tuple[int, int, int, int]
"""Size, time of the last change of the content and of the file, inode."""

_Row = tuple[Stamp, str, Header | None]
"""Stamp, artifact and header; None of one that was refused when its values were read."""


class Known:
    """What is known in one run folder. Take it from `known_of`, so that it is read once per process."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._headers: dict[str, _Row] = {}
        self._contents: dict[str, tuple[str, str]] = {}
        self._changed = False
        self._merge = True
        self._read: Stamp | None = None
        self._add_kept()

    def forget(self) -> None:
        """Take everything again."""
        self._headers, self._contents = {}, {}
        self._changed, self._merge = True, False

    def header(self, place: str, path: str, artifact: str) -> Header | None:
        """The header of an artifact as `read_header` gives it; `place` is its path in the run, or an absolute one."""
        now = time.time_ns()
        try:
            found = os.stat(path)
        except OSError:
            return None
        kept = self._headers.get(place)
        if kept is not None and kept[0] == _stamp(found) and kept[1] == artifact:
            return kept[2]
        header = read_header(Path(path), artifact)
        if header is not None and _newest(found) < now - TICK:
            self._headers[place] = (_stamp(found), artifact, header)
            self._changed = True
        return header

    def read(self, place: str, path: Path, artifact: str) -> Artifact:
        """An artifact whose header is known; its bytes are held against the checksum unless they were since they changed.

        One that is refused is stale from now on, so that it is made again: `InputError`.
        """
        kept, stamp = self._headers.get(place), _stamp(os.stat(path))
        try:
            return read_artifact(path, artifact, verified=kept is not None and kept[2] is not None and kept[0] == stamp)
        except DataError as error:
            self._headers[place] = (stamp, artifact, None)
            self._changed = True
            self.save()
            raise InputError(error.message, error.where, "the same command again makes it again") from None

    def content(self, path: Path, take: Callable[[], str]) -> str:
        """The hash of a file's or folder's content: the one kept, or else what `take` gives."""
        now, place = time.time_ns(), os.path.abspath(path)
        try:
            fingerprint, newest = _fingerprint(place)
        except OSError:
            return take()
        kept = self._contents.get(place)
        if kept is not None and kept[0] == fingerprint:
            return kept[1]
        found = take()
        if newest < now - TICK:
            self._contents[place] = (fingerprint, found)
            self._changed = True
        return found

    def save(self) -> None:
        """Keep what is new in the run folder, together with what other processes kept there; where that can be written."""
        if not self._changed or not self.folder.is_dir():
            return
        with contextlib.suppress(OSError, DataError):
            if self._merge:
                self._add_kept()
            with atomic_file(self.folder / NAME) as temporary:
                temporary.write_text(json.dumps(self._as_json(), separators=(",", ":")))
            self._changed, self._merge = False, True
            self._read = _stamp(os.stat(self.folder / NAME))

    def _as_json(self) -> dict[str, Any]:
        """As it is kept: settings, which many headers share, once; artifacts that are gone left out."""
        settings: dict[str, int] = {}
        headers = {
            place: [
                *stamp,
                artifact,
                h.key,
                h.version,
                settings.setdefault(h.settings, len(settings)),
                h.quality,
                h.checked,
            ]
            if h
            else [*stamp, artifact]
            for place, (stamp, artifact, h) in self._headers.items()
            if os.path.exists(self.folder / place)
        }
        return {"version": VERSION, "settings": list(settings), "headers": headers, "contents": self._contents}

    def _add_kept(self) -> None:
        """Add what the run folder has, if it is another file than the last time; what this process knows is newer."""
        try:
            stamp = _stamp(os.stat(self.folder / NAME))
            if stamp == self._read:
                return
            value = json.loads((self.folder / NAME).read_text())
            if value["version"] == VERSION:
                headers = {place: _header_row(row, value["settings"]) for place, row in value["headers"].items()}
                contents = {place: _texts(row, 2) for place, row in value["contents"].items()}
                refused = {place: row for place, row in headers.items() if row[2] is None}
                same = {p: row for p, row in refused.items() if p in self._headers and self._headers[p][0] == row[0]}
                self._headers, self._contents = headers | self._headers | same, contents | self._contents
            self._read = stamp
        except (OSError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
            return


@functools.lru_cache(maxsize=64)
def _known_of(folder: str) -> Known:
    return Known(Path(folder))


def known_of(folder: Path) -> Known:
    """What is known in a run folder, read once per process."""
    return _known_of(os.path.realpath(folder))


def _header_row(row: list[Any], settings: list[Any]) -> _Row:
    stamp, artifact, of = row[:4], row[4], row[5:]
    if len(stamp) != 4 or not all(type(number) is int for number in stamp):
        raise ValueError
    if not of:
        return tuple(stamp), *_texts([artifact], 1), None  # type: ignore[return-value]
    key, version, index, quality, checked = of
    text = settings[index]
    if type(version) is not int or type(checked) is not bool:
        raise ValueError
    _texts([artifact, key, text, quality], 4)
    return tuple(stamp), artifact, Header(key, version, text, quality, checked)  # type: ignore[return-value]


def _texts(row: list[Any], count: int) -> Any:
    if len(row) != count or not all(isinstance(text, str) for text in row):
        raise ValueError
    return tuple(row)


def _stamp(found: os.stat_result) -> Stamp:
    return found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino


def _newest(found: os.stat_result) -> int:
    return max(found.st_mtime_ns, found.st_ctime_ns)


def _fingerprint(path: str) -> tuple[str, int]:
    """One hash of names and stamps of a file, or of a folder's files, and the cameras.json beside it; and the newest time."""
    files = sorted(files_below(path)) if os.path.isdir(path) else [("", os.stat(path))]
    beside = os.path.join(os.path.dirname(path), "cameras.json")
    if os.path.isfile(beside):
        files.append(("../cameras.json", os.stat(beside)))
    digest = hashlib.sha256()
    for name, found in files:
        digest.update(f"{name}\0{_stamp(found)}\0".encode("utf-8", "surrogateescape"))
    return digest.hexdigest(), max((_newest(found) for _, found in files), default=0)


def files_below(folder: str) -> list[tuple[str, os.stat_result]]:
    """The files below a folder, but for names that begin with a dot.

    Links to folders are entered, each place once, but for those in which the folder itself lies.
    """
    found, inside, root = [], [""], os.path.realpath(folder)
    entered: set[str] = set()
    while inside:
        above = inside.pop()
        with os.scandir(f"{folder}/{above}") as entries:
            for entry in sorted(entries, key=lambda one: one.name):
                if entry.name.startswith("."):
                    continue
                if entry.is_symlink():
                    place = os.path.realpath(entry.path)
                    if os.path.isfile(place):
                        found.append((above + entry.name, os.stat(place)))
                    elif os.path.isdir(place) and place not in entered and os.path.commonpath([root, place]) != place:
                        entered.add(place)
                        inside.append(f"{above}{entry.name}/")
                elif entry.is_dir(follow_symlinks=False):
                    inside.append(f"{above}{entry.name}/")
                elif entry.is_file():
                    found.append((above + entry.name, entry.stat()))
    return found
