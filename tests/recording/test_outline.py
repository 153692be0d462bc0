"""Outlines that people bring: what is read, and what is refused with its cause."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.outline import read_outline

BOX = np.array([[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]])


def written(path, corners):
    path.write_text("# x,y in metres\n" + "".join(f"{x},{y}\n" for x, y in corners))
    return path


def test_corners_come_back_and_those_on_straight_lines_are_left_out(tmp_path):
    fine = np.concatenate([np.linspace(a, b, 50) for a, b in zip(BOX, np.roll(BOX, -1, 0), strict=True)])
    for corners in (BOX, [*BOX, BOX[0]], fine):
        found = read_outline(written(tmp_path / "a b.csv", corners))
        assert len(found) == 4
        assert sorted(map(tuple, found.round(6))) == sorted(map(tuple, BOX))
    np.savez(tmp_path / "o.npz", outline=BOX, other=np.zeros(3))
    assert len(read_outline(tmp_path / "o.npz")) == 4


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (BOX[[0, 2, 1, 3]], r"crosses itself at \(0.100, 0.050\)"),
        (np.vstack([BOX, [[0.1, -0.05]]]), "crosses itself"),
        (BOX[:2], "2 corners encloses nothing"),
        ([[0, 0], [0.1, 0], [0.2, 0]], "encloses nothing"),
        ([], "0 corners"),
        (BOX * 1000, "200 m large: it is in other units"),
        (BOX / 1000, "it is in other units"),
        ([*BOX[:3], [0, np.nan]], "'nan' is not a finite number"),
    ],
)
def test_what_is_no_outline_is_refused(tmp_path, corners, message):
    file = written(tmp_path / "o.csv", corners)
    with pytest.raises(DataError, match=message) as fault:
        read_outline(file)
    assert str(file) in fault.value.where
    assert fault.value.hint


@pytest.mark.parametrize("outline", [np.zeros((4, 3)), np.zeros(8), np.array(["x"]), BOX * np.nan])
def test_arrays_that_are_no_outline_are_refused(tmp_path, outline):
    np.savez(tmp_path / "o.npz", outline=outline)
    with pytest.raises(DataError, match=r"no array \[K, 2\]|not finite"):
        read_outline(tmp_path / "o.npz")


def test_files_that_are_none_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", corners=BOX)
    for name, message in (("other.npz", "no array outline"), ("o.dxf", "cannot read"), ("gone.csv", "missing")):
        with pytest.raises(DataError, match=message):
            read_outline(tmp_path / name)
    (tmp_path / "words.csv").write_text("x,y\n0,0\n")
    with pytest.raises(DataError, match="is no number") as fault:
        read_outline(tmp_path / "words.csv")
    assert "line 1" in fault.value.where
