"""Artifacts that are read by parts: what is read is what was written, what is damaged is refused when it is read."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.workspace.slices import Slices
from tests.hdf5 import edited
from tests.viewer import made


@pytest.fixture
def stored(tmp_path):
    return made.write(tmp_path, "tracks")


def spoil(path, dataset, where, value):
    """Write a value into the file behind the writer's back."""
    with edited(path) as file:
        whole = file[dataset][()]
        whole[where] = value
        attributes = dict(file[dataset].attrs)
        del file[dataset]
        file.create_dataset(dataset, data=whole).attrs.update(attributes)


def test_rows_are_those_that_were_written(stored):
    held = Slices(stored, "tracks")
    assert len(held) == made.FRAMES
    np.testing.assert_array_equal(held.rows("positions", 2, 4), made.positions()[2:4])
    np.testing.assert_array_equal(held.row("positions", 5), made.positions()[5])
    np.testing.assert_array_equal(held["residual"], np.full(made.FRAMES, np.float32(0.002)))
    assert "trust/doubt" in held
    assert "color" not in held


def test_nothing_is_read_before_it_is_asked_for(stored):
    spoil(stored, "positions", (3, 0, 0), np.nan)
    held = Slices(stored, "tracks")
    held.row("positions", 2)
    with pytest.raises(DataError, match="not finite") as error:
        held.row("positions", 3)
    assert "positions" in str(error.value)
    assert "--force" in error.value.hint


def test_offsets_are_checked_as_a_whole(tmp_path):
    path = made.write(tmp_path, "clouds")
    spoil(path, "offsets", 2, 99)
    held = Slices(path, "clouds")
    with pytest.raises(DataError, match="offsets"):
        held["offsets"]


def test_an_artifact_that_is_made_anew_stays_as_it_was_and_is_told(tmp_path, stored):
    held = Slices(stored, "tracks")
    assert not held.changed()
    made.write(tmp_path, "tracks", positions=made.positions() + 1)
    assert held.changed()
    np.testing.assert_array_equal(held.row("positions", 0), made.positions()[0])
    stored.unlink()
    assert held.changed()


def test_what_is_no_such_artifact_is_refused_before_anything_is_read(tmp_path, stored):
    with pytest.raises(DataError, match="no such clouds"):
        Slices(tmp_path / "none.h5", "clouds")
    with pytest.raises(DataError, match="holds tracks"):
        Slices(stored, "clouds")
    with edited(stored) as file:
        file.attrs["schema_version"] = 0
    with pytest.raises(DataError, match="of this version"):
        Slices(stored, "tracks")
    stored.write_bytes(stored.read_bytes()[:-500])
    with pytest.raises(DataError, match="the checksum differs"):
        Slices(stored, "tracks")


def test_axes_that_disagree_are_refused_at_once(stored):
    with edited(stored) as file:
        del file["residual"]
        file.create_dataset("residual", data=np.zeros(3, np.float32))
    with pytest.raises(DataError, match="axis frame"):
        Slices(stored, "tracks")
