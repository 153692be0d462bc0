"""The robot's base from tables beside a recording: drawn images of a board on a gripper, points that a tip touched."""

import csv
import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.recording.robot_files import read_robot
from tests.commands.inside import piegraph, piegraph_json
from tests.recording.board_scene import BLANK, BOARD, RIG, apart, picture, pose, record

SMALL = ("--square", 0.06, "--marker", 0.045)
BASE = pose([0.05, -0.1, 1.2], [-0.45, 0.3, 0.01])
MOUNT = pose([0.1, 0.05, -0.4], [0.01, 0.02, 0.06])


def held() -> list[np.ndarray]:
    """Places of the board in the world, turned to all sides."""
    rng = np.random.default_rng(2)
    turns = [(0.4, 0, 0), (-0.4, 0.1, 0.5), (0, 0.45, 1.0), (0.1, -0.45, 1.4), (0.3, 0.3, -0.6), (-0.3, 0.3, 0.2)]
    return [pose(turn, [*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.05, 0.15)]) for turn in turns]


GRIPPER = [np.linalg.inv(BASE) @ T @ np.linalg.inv(MOUNT) for T in held()]


def table(path, header, rows):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header.split(","), *rows])
    return path


def poses(path, gripper=GRIPPER, names=None, vectors=False, scale=1.0):
    turns = Rotation.from_matrix(np.array(gripper)[:, :3, :3])
    numbers = turns.as_rotvec() if vectors else turns.as_quat()
    header = "image,x,y,z,rx,ry,rz" if vectors else "image,x,y,z,qx,qy,qz,qw"
    names = names or [f"{k:06d}" for k in range(len(gripper))]
    return table(path, header, [[n, *(T[:3, 3] * scale), *q] for n, T, q in zip(names, gripper, numbers, strict=True)])


@pytest.fixture(scope="module")
def images():
    """Two cameras; the last image shows nothing."""
    return [[*(picture(RIG[c], BOARD, T) for T in held()), BLANK] for c in (0, 1)]


@pytest.fixture
def recording(tmp_path, images):
    return record(tmp_path / "rec", images, (0, 1), "hand", posed=True)


def test_the_base_is_found_from_images_kept_and_its_sequence_left_out(recording, tmp_path):
    told = piegraph_json("calibrate", recording, "--sequence", "hand", *SMALL, "--robot", poses(tmp_path / "p.csv"))
    millimetres, degrees = apart(read_robot(recording / "cameras.json"), BASE)
    assert millimetres < 3
    assert degrees < 0.3
    assert list(told["methods"]) == ["tsai", "park", "daniilidis", "shah", "refined"]
    assert told["methods"]["refined"]["residual_mm"] < 2
    assert list(told["off_mm"]) == [f"{k:06d}" for k in range(6)]
    assert told["notes"] == []
    assert json.loads((recording / "cameras.json").read_text())["calibration_sequence"] == "hand"
    vectors = poses(tmp_path / "v.csv", vectors=True, names=[f"{k}.jpg" for k in range(6)])
    lines = piegraph("calibrate", recording, "--sequence", "hand", *SMALL, "--robot", vectors).stdout
    assert "refined " in lines
    assert "T_world_robot is in cameras.json" in lines


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": 1000}, r"line [2-7]: the gripper is \d+ m from the base: are these millimetres"),
        ({"names": [*"012345"[:5], "77"]}, "line 7: no image is called '77'"),
        ({"gripper": GRIPPER[:2]}, "2 poses in which the board is seen, 3 are needed"),
        ({"gripper": [np.linalg.inv(T) for T in GRIPPER]}, "contradict each other.*\n.*write their inverses"),
    ],
)
def test_tables_that_cannot_be_right_are_refused_and_nothing_is_kept(recording, tmp_path, change, message):
    before = (recording / "cameras.json").read_text()
    done = piegraph("calibrate", recording, *SMALL, "--robot", poses(tmp_path / "p.csv", **change), check=3)
    assert re.search(message, done.stderr), done.stderr
    assert "p.csv" in done.stderr
    assert (recording / "cameras.json").read_text() == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no line below the names"),
        ("image,x,y,z,qx,qy,qz\n0,0,0,0,0,0,0\n", "line 1: has no column qw"),
        ("x,y,z,rx,ry,rz\n0,0,0,0,0,0\n", "line 1: has no column image"),
        (
            "image,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,0.5\n",
            "line 3: the quaternion's length is 0.5, not 1",
        ),
        ("image,x,y,z,rx,ry,rz\n0,0,0,0,0,0,90\n", "line 2: the rotation vector is 90 long: are these degrees"),
        ("image,x,y,z,rx,ry,rz\n0,0,nan,0,0,0,0\n", "line 2: column y: 'nan' is not a finite"),
        ("image,x,y,z,rx,ry,rz\n0,0,0\n", "line 2: has 3 columns, the first line has 7"),
    ],
)
def test_the_table_of_poses_is_checked_line_by_line(recording, tmp_path, text, message):
    (tmp_path / "p.csv").write_text(text)
    assert message in piegraph("calibrate", recording, *SMALL, "--robot", tmp_path / "p.csv", check=3).stderr


def test_an_image_without_the_board_is_left_out_and_said(recording, tmp_path):
    file = poses(tmp_path / "p.csv", gripper=[*GRIPPER, np.eye(4)])
    told = piegraph_json("calibrate", recording, *SMALL, "--robot", file)
    assert told["notes"] == ["image 000006: no camera sees enough of the board, left out"]
    assert apart(read_robot(recording / "cameras.json"), BASE)[0] < 3


def to_robot(points) -> np.ndarray:
    return (np.asarray(points) - BASE[:3, 3]) @ BASE[:3, :3]


def test_touched_corners_pixels_and_points_give_the_same_base(recording, tmp_path):
    corners, world = [0, 5, 18, 23], BOARD.corners()[[0, 5, 18, 23]]
    pixels = RIG[1].project(world)[0]
    for header, columns in (
        ("x,y,z,corner", [[c] for c in corners]),
        ("x,y,z,camera,column,row", [["cam1", *p] for p in pixels]),
        ("x,y,z,world_x,world_y,world_z", world.tolist()),
    ):
        file = table(tmp_path / "t.csv", header, [[*p, *c] for p, c in zip(to_robot(world), columns, strict=True)])
        told = piegraph_json("calibrate", recording, *SMALL, "--touched", file)
        assert apart(read_robot(recording / "cameras.json"), BASE) == pytest.approx((0, 0), abs=1e-3)
        assert max(told["off_mm"].values()) < 1e-3
        assert told["notes"] == []
    for robot in (to_robot(world)[:, [1, 0, 2]], to_robot(world) * [1, -1, 1]):
        rows = [[*p, c] for p, c in zip(robot, corners, strict=True)]
        wrong = table(tmp_path / "t.csv", "x,y,z,corner", rows)
        assert "z would point down" in piegraph("calibrate", recording, *SMALL, "--touched", wrong).stdout
    three = table(
        tmp_path / "t.csv", "x,y,z,corner", [[*p, c] for p, c in zip(to_robot(world)[:3], corners, strict=False)]
    )
    assert "touch a fourth" in piegraph("calibrate", recording, *SMALL, "--touched", three).stdout


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        ("x,y,z,corner", [[0, 0, 0, 24]], "line 2: corner 24: the board has corners 0 to 23"),
        ("x,y,z,corner", [[0.1, 0, 0, 0], [0.2, 0, 0, 1], [0.3, 0, 0, 2]], "the points lie in a line"),
        ("x,y,z,camera,column,row", [[0, 0, 0, "cam9", 1, 1]], "line 2: no camera 'cam9'"),
        ("x,y,z,camera,column,row", [[0, 0, 0, "cam0", 900, 1]], "line 2: camera cam0 sees no table at 900, 1"),
        ("x,y,z", [[0, 0, 0]], "line 1: has no column world_x"),
        ("x,y,z,corner", [[400, 0, 0, 0], [0, 300, 0, 5], [0, 0, 0, 23]], "give metres, not millimetres"),
    ],
)
def test_points_that_cannot_be_right_are_refused(recording, tmp_path, header, rows, message):
    before = (recording / "cameras.json").read_text()
    file = table(tmp_path / "t.csv", header, rows)
    done = piegraph("calibrate", recording, *SMALL, "--touched", file, check=3)
    assert message in done.stderr
    assert (recording / "cameras.json").read_text() == before


def test_a_robot_needs_cameras_that_stand_somewhere(recording, tmp_path):
    file = json.loads((recording / "cameras.json").read_text())
    del file["cameras"]["cam0"]["T_world_camera"]
    (recording / "cameras.json").write_text(json.dumps(file))
    done = piegraph("calibrate", recording, *SMALL, "--robot", poses(tmp_path / "p.csv"), check=3)
    assert "camera cam0: T_world_camera is missing\n  try: run `piegraph calibrate`" in done.stderr
