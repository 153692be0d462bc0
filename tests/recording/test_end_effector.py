"""The path of an end-effector that others measured: what is read, at the times of frames, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.errors import DataError
from piegraph_cli.recording.end_effector import EndEffectorPath, at_frames, read_end_effector
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.recording.sequence import read_sequence
from tests.stages.make_recording import make_recording

TIMES = np.arange(21) / 20
PATH = np.column_stack([0.1 * TIMES, 0.02 - 0.1 * TIMES, 0.05 + 0 * TIMES])


def table(folder, columns, header="time,x,y,z"):
    path = folder / "end_effector.csv"
    lines = [header, *(",".join(f"{v!r}" for v in row.tolist()) for row in np.asarray(columns))]
    path.write_text("\n".join(lines) + "\n\n")
    return path


def test_a_table_is_read_and_taken_between_its_lines(tmp_path):
    path = read_end_effector(table(tmp_path, np.column_stack([TIMES, PATH, TIMES / 10]), "time,x,y,z,opening"))
    found, warnings = at_frames(path, np.array([0.025, 0.51]), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(found["end_effector"], [[0.0025, 0.0175, 0.05], [0.051, -0.031, 0.05]])
    np.testing.assert_allclose(found["opening"], [0.0025, 0.051])
    assert not warnings


def test_the_tip_lies_where_the_rotation_puts_it(tmp_path):
    turns = np.stack([Rotation.from_euler("z", 90 * t, degrees=True).as_quat() for t in TIMES])
    columns = np.column_stack([turns, TIMES, PATH])
    path = read_end_effector(table(tmp_path, columns, "qx,qy,qz,qw,time,x,y,z"))
    found, _ = at_frames(path, np.array([0.0, 1.0]), (0.03, 0.0, -0.01))
    np.testing.assert_allclose(found["end_effector"], [[0.03, 0.02, 0.04], [0.1, -0.05, 0.04]], atol=1e-9)
    with pytest.raises(DataError, match="tool_point needs rotations"):
        at_frames(EndEffectorPath(TIMES, PATH), TIMES, (0.01, 0.0, 0.0))


def test_frames_that_it_does_not_cover_are_unknown_and_said(tmp_path):
    gap = np.abs(TIMES - 0.5) > 0.3
    path = read_end_effector(table(tmp_path, np.column_stack([TIMES, PATH])[gap]))
    found, warnings = at_frames(path, np.array([-0.2, 0.0, 0.1, 0.5, 0.9, 1.0, 1.1]), (0.0, 0.0, 0.0))
    unknown = np.isnan(found["end_effector"]).all(axis=1)
    assert unknown.tolist() == [True, False, False, True, False, False, True]
    assert warnings == [f"{tmp_path}/end_effector.csv does not cover 3 of 7 frames: 0 to 0, 3 to 3, 6 to 6"]
    with pytest.raises(DataError, match=r"covers 0.00 to 1.00 s, the cameras 5.00 to 6.00 s"):
        at_frames(path, np.array([5.0, 6.0]), (0.0, 0.0, 0.0))


def spoilt(row, column, value):
    columns = np.column_stack([TIMES, PATH])
    columns[row, column] = value
    return columns


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (spoilt(3, 1, np.nan), "line 5 is not finite"),
        (spoilt(3, 0, np.inf), "line 5 is not finite"),
        (spoilt(20, 0, 1e308), "line 22 is at 1e+308 s"),
        (np.column_stack([TIMES * 1e307, PATH]), "are these nanoseconds"),
        (np.column_stack([(TIMES - 0.5) * 3e307, PATH]), "are these nanoseconds"),
        (spoilt(7, 0, 0.1), "line 9 is not later than the one before it"),
        (np.column_stack([TIMES, PATH])[::-1], "line 3 is not later"),
        (np.column_stack([TIMES, PATH * 1000]), "millimetres"),
        (np.column_stack([TIMES * 1000, PATH]), "0.02 lines a second: are these milliseconds?"),
        (np.column_stack([TIMES / 1000, PATH]), "lines a second"),
        (spoilt(7, 2, 2.0), "line 9 is 2.01 m from the one 0.050 s before it"),
        (np.column_stack([TIMES, PATH])[:1], "has 1 lines of numbers"),
    ],
)
def test_a_table_that_is_wrong_is_refused_with_its_line(tmp_path, columns, message):
    with np.errstate(over="ignore"), pytest.raises(DataError) as refused:
        at_frames(read_end_effector(table(tmp_path, columns)), TIMES, (0.0, 0.0, 0.0))
    assert message in str(refused.value)
    assert "end_effector.csv" in str(refused.value)
    assert refused.value.hint


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,x,y\n0,0,0\n1,0,0\n", "line 1: has no column z"),
        ("time,x,y,z,qx\n0,0,0,0,0\n1,0,0,0,0\n", "line 1: has no column qy"),
        ("time,x,y,z,x\n0,0,0,0,0\n1,0,0,0,0\n", "'x' is there twice"),
        ("time,x,y,z,force\n0,0,0,0,0\n1,0,0,0,0\n", "'force' is not known"),
        ("time,x,y,z\n0,0,0,0\n1,0,zero,0\n", "line 3: column y: 'zero' is no number"),
        ("time,x,y,z\n0,0,0,0\n1,0,,0\n", "line 3: column y: is empty"),
        ("time,x,y,z\n0,0,0,0\n\n1,0,0,0\n", "line 3: has 0 columns"),
        ("time,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n.1,0,0,0,0,0,0,2\n", "line 3 has a quaternion"),
        ("", "has 0 lines"),
        ("\x00\xff", "end_effector.csv"),
    ],
)
def test_text_that_is_no_table_is_refused(tmp_path, text, message):
    (tmp_path / "end_effector.csv").write_bytes(text.encode("latin1"))
    with pytest.raises(DataError) as refused:
        read_end_effector(tmp_path / "end_effector.csv")
    assert message in str(refused.value)


def test_it_lies_beside_the_cameras_of_a_sequence(tmp_path):
    sequence = make_recording(tmp_path, sequences=1) / "seq 0"
    assert "end_effector" not in read_sequence(sequence, IngestParams())[0]
    table(sequence, np.column_stack([TIMES - 0.1, PATH]))
    arrays, warnings = read_sequence(sequence, IngestParams())
    expected = 0.1 * (np.arange(4) / 5 + 0.001 + 0.1)  # the second camera is 2 ms later than the first
    np.testing.assert_allclose(arrays["end_effector"][:, 0], expected, atol=1e-9)
    assert "opening" not in arrays
    assert not warnings
