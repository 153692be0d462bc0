"""A rendered sequence takes the place of the one that was there only when it can."""

from pathlib import Path

import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.stages import simulate
from piegraph_cli.stages.simulate import _put_in_place, _record_sequence


def make(folder: Path, text: str) -> Path:
    folder.mkdir()
    (folder / "truth.h5").write_text(text)
    return folder


def test_the_new_one_takes_the_place_of_the_old_one(tmp_path):
    old = make(tmp_path / "s", "old")
    make(tmp_path / ".s.before", "of a process that was killed")
    _put_in_place(make(tmp_path / ".s.partial", "new"), old)
    assert {path.name: (path / "truth.h5").read_text() for path in tmp_path.iterdir()} == {"s": "new"}


def test_the_old_one_is_back_where_that_fails(tmp_path):
    old = make(tmp_path / "s", "old")
    with pytest.raises(OSError, match="No such file"):
        _put_in_place(tmp_path / "none", old)
    assert {path.name: (path / "truth.h5").read_text() for path in tmp_path.iterdir()} == {"s": "old"}


def test_a_full_disk_names_the_sequence_and_leaves_nothing(tmp_path, monkeypatch):
    def full(folder, *_):
        make(folder, "half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(simulate, "_write_images", full)
    with pytest.raises(DataError, match=r"sequence: cannot be written: .*No space left"):
        _record_sequence(tmp_path / "sequence", simulate._of_recording(simulate.SimulateParams()), 0, True)
    assert not list(tmp_path.iterdir())
