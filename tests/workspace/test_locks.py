"""Locks between processes, and file systems that have none or cannot be written."""

import errno
import fcntl
import logging

import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.workspace import locks
from piegraph_cli.workspace.locks import held


def test_a_lock_is_held_by_one_and_free_afterwards(tmp_path):
    file = tmp_path / "locks" / "a.lock"
    with held(file) as waited:
        assert not waited
        with open(file, "w") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with open(file, "w") as other:
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert [path.name for path in file.parent.iterdir()] == ["a.lock"]


@pytest.mark.parametrize("number", sorted(locks.NO_LOCKS))
def test_without_locks_everybody_passes_with_one_word(tmp_path, monkeypatch, caplog, number):
    """As on NFS without its lock daemon."""

    def none(*_: object) -> None:
        raise OSError(number, "none here")

    monkeypatch.setattr(fcntl, "flock", none)
    with caplog.at_level(logging.WARNING), held(tmp_path / "a.lock"), held(tmp_path / "b.lock") as waited:
        assert not waited
    assert caplog.text.count("this file system has no locks") == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_said(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(DataError, match="Read-only file system"), held(tmp_path / "a.lock"):
        pass
