"""Artifacts changed by hand, with a checksum that fits again: what a reader has to notice beside it."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import h5py

from piegraph_cli.workspace.sealed import BLOCK, sealed


def reseal(path: Path) -> None:
    """Give a changed artifact the checksum of its bytes."""
    path.write_bytes(b"".join(sealed(path.read_bytes()[BLOCK:])))


@contextlib.contextmanager
def edited(path: Path) -> Iterator[h5py.File]:
    """An artifact opened to be changed, then sealed again."""
    with h5py.File(path, "a") as file:
        yield file
    reseal(path)


def unsealed(path: Path, version: int) -> None:
    """Make an artifact one of that schema version without a checksum."""
    path.write_bytes(path.read_bytes()[BLOCK:])
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = version
