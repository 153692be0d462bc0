"""Ingest and geometry: what is bad stops it with the cause, what is accepted or doubtful is kept and told."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.workspace.artifact import read_artifact
from tests.cli import piegraph, piegraph_json
from tests.recording.table_scene import BLOCK, make_views, sample, with_depth, with_poses, write_views
from tests.stages.make_recording import make_recording


@pytest.fixture(scope="module")
def views():
    return make_views(camera_rig(320, 240)[:2], boxes=(BLOCK,) * 3)


def raised(by):
    T = np.eye(4)
    T[2, 3] = by
    return lambda views: with_poses(views, lambda k, pose: T @ pose)


def of_scale(scale):
    return lambda views: [replace(v, camera=replace(v.camera, depth_scale=scale)) for v in views]


TROUBLES = {
    "inverse extrinsics": (
        lambda views: with_poses(views, lambda k, T: np.linalg.inv(T)),
        "cam0 and cam1: table .*inverting T_world_camera puts the table at z = 0",
    ),
    "inverse extrinsics of one": (
        lambda views: with_poses(views, lambda k, T: np.linalg.inv(T) if k else T),
        "wrong: cam1: table .*inverting T_world_camera puts the table at z = 0",
    ),
    "depth 15 px aside": (
        lambda views: with_depth(views, lambda k, d: np.roll(d, 15, 1)),
        "edges of depth lie 1[456], .* px .*moving depth by -1[456]",
    ),
    "depth 7 px aside": (
        lambda views: with_depth(views, lambda k, d: np.roll(d, -7, 1)),
        "edges of depth lie -[678], .* px .*moving depth by [678]",
    ),
    "quarter millimetres": (
        lambda views: with_depth(views, lambda k, d: d * 4.0),
        "depth is 4 times too far: depth_scale 0.00025 puts the table at z = 0",
    ),
    "a depth scale in millimetres": (of_scale(1.0), "depth_scale 0.001 puts the table at z = 0"),
    "metres in whole numbers": (
        lambda views: with_depth(views, lambda k, d: np.ceil(d / 1000)),
        "no reading above 2 units; metres or the like, cut to whole numbers",
    ),
    "a table 15 mm too high": (raised(0.015), "the table lies 15 mm above z = 0"),
}


@pytest.mark.parametrize("trouble", TROUBLES)
def test_what_is_bad_stops_with_file_cameras_figure_cause_and_what_to_do(views, tmp_path, trouble):
    spoil, message = TROUBLES[trouble]
    recording = write_views(tmp_path / "rec", spoil(views))
    done = piegraph("ingest", "--recording", recording, "--run", tmp_path / "run", check=3)
    assert f"ingest failed on take: {recording}/cameras.json: the geometry is wrong: " in done.stderr
    assert re.search(message, done.stderr), done.stderr
    assert "\n  try: " in done.stderr
    assert not list((tmp_path / "run").glob("frames/*.h5"))


def test_what_is_bad_can_be_accepted_by_name_and_is_told(views, tmp_path):
    recording = write_views(tmp_path / "rec", raised(0.015)(views))
    to = ("--recording", recording, "--run", tmp_path / "run")
    piegraph("ingest", *to, "--accept", "edges", check=3)
    piegraph("ingest", *to, "--accept", "size", check=2)
    outcome = piegraph_json("ingest", *to, "--accept", "table,edges")["outcomes"][0]
    assert outcome["quality"].endswith("geometry bad: table of cam0, cam1")
    assert "the table lies 15 mm above z = 0" in outcome["warnings"][0]
    assert "bad: table of cam0, cam1" in piegraph("status", "--run", tmp_path / "run", "--units").stdout
    frames = read_artifact(tmp_path / "run" / "frames" / "take.h5", "frames")
    rows = [k for k, name in enumerate(frames.texts("check_name")) if name == "table"]
    assert [frames.texts("check_verdict")[k] for k in rows] == ["bad", "bad"]
    np.testing.assert_allclose(frames["check_figure"][rows], 15, atol=0.5)
    assert "the table lies 15 mm" in frames.texts("check_cause")[rows[0]]
    assert "ingest.table = 0.015" in frames.texts("check_remedy")[rows[0]]


def test_a_table_elsewhere_is_good_where_a_setting_says_so(views, tmp_path):
    recording = write_views(tmp_path / "rec", raised(0.015)(views))
    done = piegraph("ingest", "--recording", recording, "--run", tmp_path / "run", "--table", 0.015)
    assert done.stdout.rstrip().endswith("geometry good")
    assert done.stderr == ""


def test_what_is_doubtful_is_a_warning(tmp_path):
    done = piegraph("ingest", "--recording", make_recording(tmp_path / "rec", 1), "--run", tmp_path / "run")
    assert "geometry doubtful: table of front, left cam" in done.stdout
    assert "geometry: front and left cam: no table is found in depth\n  try: " in done.stderr


def test_frames_without_depth_at_the_start_are_passed_over(views, tmp_path):
    late = [replace(v, depth=[0 * v.depth[0], *v.depth], color=[v.color[0], *v.color]) for v in views]
    recording = write_views(tmp_path / "rec", late)
    done = piegraph("ingest", "--recording", recording, "--run", tmp_path / "run")
    assert done.stdout.rstrip().endswith("geometry good")


@pytest.mark.parametrize(("shift", "warned"), [(0, False), (15, True)])
def test_a_hand_seen_without_depth_is_told(tmp_path, shift, warned):
    frames = range(10, 20)
    views = with_depth(sample(0, frames)[:2], lambda k, d: np.roll(d, shift, 1))
    recording = write_views(tmp_path / "rec", views)
    piegraph("ingest", "--recording", recording, "--run", tmp_path / "run", "--accept", "edges")
    done = piegraph("hands", "--run", tmp_path / "run")
    assert ("few of its landmarks have a depth: cam0 " in done.stderr) == warned
