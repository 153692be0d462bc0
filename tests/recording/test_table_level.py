"""`calibrate --table`: cameras off by a tilt and a height are put right by the table in depth; a camera alone gets a pose."""

import json
import re

import numpy as np
import pytest

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.ground import level
from piegraph_cli.recording.layout import read_cameras
from piegraph_cli.recording.planes import Plane
from piegraph_cli.recording.robot_files import read_robot
from piegraph_cli.recording.table import pose_over
from tests.commands.inside import piegraph, piegraph_json
from tests.recording.board_scene import apart, pose
from tests.recording.table_scene import ARM, BLOCK, make_views, with_depth, with_poses, write_views

RIG = camera_rig(320, 240)[:3]


@pytest.fixture(scope="module")
def views():
    return make_views(RIG, boxes=(BLOCK, (*BLOCK, ARM), BLOCK))


def changed(recording, change):
    file = json.loads((recording / "cameras.json").read_text())
    change(file)
    (recording / "cameras.json").write_text(json.dumps(file))


def test_tilt_and_height_are_taken_out_of_all_cameras_as_one(views, tmp_path):
    T = np.linalg.inv(level((0.06, 0.08, -0.05)))
    recording = write_views(tmp_path / "rec", with_poses(views, lambda k, own: T @ own))
    robot = pose([0.1, 0.2, 1], [0.5, 0.1, 0])
    changed(recording, lambda file: file.update(T_world_robot=(T @ robot).tolist(), calibration_sequence="board"))
    to = ("ingest", "--recording", recording, "--run", tmp_path / "run")
    refused = piegraph(*to, check=3).stderr
    assert "the table is tilted by 5.4 deg alike in all cameras" in refused
    assert "`piegraph calibrate RECORDING --table`" in refused
    plane = re.search(r"ingest.table = ([-0-9.,]+);", refused).group(1)
    np.testing.assert_allclose([float(x) for x in plane.split(",")], (0.06, 0.08, -0.05), atol=0.004)
    assert piegraph(*to, "--table", plane).stderr == ""
    told = piegraph_json("calibrate", recording, "--table")
    assert told["tilt_deg"] == pytest.approx(np.degrees(np.arctan(np.hypot(0.08, 0.05))), abs=0.1)
    assert told["height_mm"] == pytest.approx(60, abs=8)
    assert max(one["off_mm"] for one in told["cameras"].values()) < 2
    assert told["notes"] == ["T_world_robot is moved along"]
    for camera, truth in zip(read_cameras(recording / "take"), RIG, strict=True):
        millimetres, degrees = apart(camera.T_world_camera, truth.T_world_camera)
        assert millimetres < 8, "x, y are as they were, but for the tilt"
        assert degrees < 0.2
        assert camera.T_world_camera[2, 3] == pytest.approx(truth.T_world_camera[2, 3], abs=0.002)
    assert apart(read_robot(recording / "cameras.json"), robot)[1] < 0.2
    assert json.loads((recording / "cameras.json").read_text())["calibration_sequence"] == "board"
    assert piegraph(*to, "--table", 0).stderr == ""
    again = piegraph_json("calibrate", recording, "--table")
    assert again["tilt_deg"] < 0.01
    assert abs(again["height_mm"]) < 0.01


def test_a_world_that_is_one_cameras_own_is_laid_on_the_table(views, tmp_path):
    lens = np.linalg.inv(RIG[1].T_world_camera)
    recording = write_views(tmp_path / "rec", with_poses(views, lambda k, T: np.eye(4) if k == 1 else lens @ T))
    to = ("ingest", "--recording", recording, "--run", tmp_path / "run")
    assert "the world is that of cam1, whose T_world_camera is the identity" in piegraph(*to, check=3).stderr
    piegraph("calibrate", recording, "--table")
    assert piegraph(*to).stderr == ""


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda v: with_poses(v, lambda k, T: T @ pose([0.06, 0, 0], [0, 0, 0]) if k == 1 else T), "cam1 .* deg"),
        (lambda v: with_poses(v, lambda k, T: np.linalg.inv(T)), "do not see the same table"),
        (lambda v: with_poses(v, lambda k, T: pose([np.pi, 0, 0], [0, 0, 0]) @ T), "tilted by 180 deg"),
        (lambda v: with_poses(v, lambda k, T: pose([0.8, 0, 0], [0, 0, 0]) @ T), "tilted by 46 deg"),
        (lambda v: with_depth(v, lambda k, d: d * (k != 2)), "camera cam2: no table is found in depth"),
    ],
)
def test_cameras_that_one_motion_cannot_put_right_are_refused(views, tmp_path, spoil, message):
    recording = write_views(tmp_path / "rec", spoil(views))
    before = (recording / "cameras.json").read_text()
    done = piegraph("calibrate", recording, "--table", check=3)
    assert re.search(message, done.stderr), done.stderr
    assert "\n  try: " in done.stderr
    assert (recording / "cameras.json").read_text() == before


def test_a_camera_alone_gets_a_pose_over_the_middle_of_its_view(views, tmp_path):
    recording = write_views(tmp_path / "rec", views[:1])
    changed(recording, lambda file: file["cameras"]["cam0"].pop("T_world_camera"))
    done = piegraph("calibrate", recording, "--table")
    assert "the world begins on the table in the middle of the view: x right, y away" in done.stdout
    (camera,) = read_cameras(recording / "take")
    pixels, depth = camera.project(np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]]))
    np.testing.assert_allclose(pixels[0], [160, 120], atol=1e-6)
    assert pixels[1, 0] > 170
    assert depth[2] > depth[0] + 0.02
    assert pixels[3, 1] < 115
    assert piegraph("ingest", "--recording", recording, "--run", tmp_path / "run").stderr == ""
    two = write_views(tmp_path / "two", views[:2])
    changed(two, lambda file: file["cameras"]["cam0"].pop("T_world_camera"))
    assert "several cameras need a board" in piegraph("calibrate", two, "--table", check=3).stderr


def test_straight_down_the_top_of_the_image_is_y():
    camera = Camera("c", 64, 48, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.zeros(5), np.eye(4))
    T = pose_over(Plane(np.array([0, 0, 1.0]), 0.8, np.array([0, 0, 0.8]), 1.0), camera, "")
    np.testing.assert_allclose(T[:3, :3], np.diag([1, -1, -1]), atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], [0, 0, 0.8], atol=1e-9)


def test_one_calibration_at_a_time(tmp_path):
    for words in (("--table", "--robot", "a.csv"), ("--intrinsics", "--table")):
        piegraph("calibrate", tmp_path, *words, check=2)
