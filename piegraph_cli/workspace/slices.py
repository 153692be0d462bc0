"""Reading an artifact by parts: what is looked at, when it is looked at; `artifact` reads whole ones."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from piegraph_cli.errors import DataError
from piegraph_cli.workspace.artifact import open_artifact
from piegraph_cli.workspace.values import check_values

if TYPE_CHECKING:
    import numpy as np

CACHE_BYTES = 16 << 20
"""Unpacked chunks of one dataset that are kept, so that the next frame costs no unpacking."""

Stamp = tuple[int, int, int]


class Slices:
    """An artifact that stays open. Names, types and axes are checked at once, values when they are read.

    Artifacts are replaced whole: one that is made anew meanwhile leaves this one as it was, and `changed` tells.
    Raises `DataError` for a file that is no such artifact, as `read_artifact` does.
    """

    def __init__(self, path: Path, name: str):
        self.path, self.name = path, name
        self._stamp = stamp_of(path)
        self._file, attributes, self._found, self.lengths = open_artifact(path, name, CACHE_BYTES)
        self._hint = f"make it again: `piegraph {attributes['stage']} --force`"
        self.key, self.quality, self.settings = attributes["key"], attributes["quality"], attributes["params"]

    def __contains__(self, dataset: str) -> bool:
        return dataset in self._found

    def __len__(self) -> int:
        """Frames; 0 of what has none."""
        return self.lengths.get("frame", 0)

    def __getitem__(self, dataset: str) -> "np.ndarray":
        """A whole dataset, checked."""
        value = self._read(dataset, slice(None) if self._found[dataset].shape else ())
        check_values(str(self.path), self.name, {dataset: value}, self._found, self.lengths, self._hint)
        return value

    def rows(self, dataset: str, first: int, end: int) -> "np.ndarray":
        """Rows `first` to `end` of a dataset, checked but for offsets, which mean something only as a whole."""
        value = self._read(dataset, slice(first, end))
        check_values(str(self.path), self.name, {dataset: value}, self._found, self.lengths, self._hint, part=True)
        return value

    def row(self, dataset: str, index: int) -> "np.ndarray":
        """One row of a dataset."""
        return self.rows(dataset, index, index + 1)[0]

    def texts(self, dataset: str) -> list[str]:
        """A text dataset as Python strings."""
        return [value.decode() for value in self[dataset]]

    def _read(self, dataset: str, where: "slice | tuple[()]") -> "np.ndarray":
        import h5py

        item = self._found[dataset].item
        assert item is not None
        try:
            return h5py.Dataset(item)[where]
        except (OSError, ValueError, MemoryError) as error:
            raise DataError(f"dataset {dataset} is damaged: {error}", str(self.path), self._hint) from None

    def changed(self) -> bool:
        """Whether another file lies there now, or none."""
        return stamp_of(self.path) != self._stamp

    def close(self) -> None:
        """Close the file; nothing can be read after."""
        self._file.close()


def stamp_of(path: Path) -> Stamp | None:
    """What tells a file from another one at its place; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
