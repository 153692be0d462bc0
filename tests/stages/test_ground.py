"""A table that is not at z = 0: ingest makes it so, plans are handed back where the cameras and the robot have them."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.perception.look import LookSettings, look
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.told import stroke_in
from piegraph_cli.recording.ground import level, moved, rest_on
from piegraph_cli.recording.params import IngestParams, ReadParams
from piegraph_cli.stages import open_run, score
from piegraph_cli.workspace.artifact import read_artifact, write_artifact
from tests.commands.inside import piegraph, piegraph_json
from tests.recording.table_scene import BLOCK, make_views, with_poses, write_views

TILTED = (0.1, 0.02, -0.05)


def pose(vector, shift) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), shift
    return T


@pytest.fixture(scope="module")
def views():
    return make_views(camera_rig(320, 240)[:2], boxes=(BLOCK,) * 3)


def test_level_is_the_shortest_turn_that_lays_the_plane_down():
    rng = np.random.default_rng(0)
    points = np.pad(rng.normal(0, 0.3, (20, 2)), ((0, 0), (0, 1)))
    points[:, 2] = TILTED[0] + points[:, :2] @ TILTED[1:]
    T = level(TILTED)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose((points @ T[:3, :3].T + T[:3, 3])[:, 2], 0, atol=1e-12)
    np.testing.assert_allclose(T @ [0, 0, TILTED[0], 1], [0, 0, 0, 1], atol=1e-12)
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    assert turn[2] == pytest.approx(0, abs=1e-12)
    assert np.tan(np.linalg.norm(turn)) == pytest.approx(np.hypot(*TILTED[1:]))
    np.testing.assert_array_equal(level((0, 0, 0)), np.eye(4))
    assert rest_on(np.array([0, 0, 1.0]), np.array([1.0, 2, 3]))[:3, 3].tolist() == [-1, -2, -3]
    kept = np.ones((2, 3), np.float32)
    assert moved(kept, np.eye(4)) is kept
    assert moved(kept, T).dtype == np.float32


def test_a_table_is_a_height_or_a_plane_and_at_zero_it_is_no_other_setting():
    assert IngestParams(table="0.1").table == (0.1, 0, 0)
    assert IngestParams(table=0.1).table == IngestParams(table=[0.1]).table == (0.1, 0, 0)
    assert IngestParams(table="0.1,0.02,-0.05").table == TILTED
    assert IngestParams().content()["table"] == IngestParams(table="0,0,0").content()["table"] == 0.0
    assert IngestParams(table=0.1).content()["table"] == [0.1, 0.0, 0.0]
    for wrong in ("0.1,0.2", "high", "0.1,2,0", "nan"):
        with pytest.raises(ValueError, match="table"):
            IngestParams(table=wrong)
    plain = PlanParams(env="tblock").content()
    assert not {"table", "frame", "cameras"} & plain.keys()
    assert PlanParams(env="tblock", frame="robot").content() == plain
    assert PlanParams(state="a.npz", table=0.1).content()["table"] == [0.1, 0, 0]


@pytest.mark.parametrize("table", [(0.1, 0.0, 0.0), TILTED])
def test_the_run_of_a_table_elsewhere_is_that_of_the_same_table_at_zero(views, tmp_path, table):
    """All stages but `ingest` see the world through its cameras alone: where these agree, tracks do."""
    T = np.linalg.inv(level(table))
    plain = write_views(tmp_path / "plain", views)
    other = write_views(tmp_path / "other", with_poses(views, lambda k, pose: T @ pose))
    piegraph("ingest", "--recording", plain, "--run", tmp_path / "a")
    piegraph("ingest", "--recording", other, "--run", tmp_path / "b", check=3)
    to = ("ingest", "--recording", other, "--run", tmp_path / "b", "--table", ",".join(map(str, table)))
    told = piegraph_json(*to)["outcomes"][0]
    assert told["warnings"] == []
    assert told["quality"].endswith(", z = 0 is the table at z = 0.1 m of the recording, geometry good")
    one, two = (read_artifact(tmp_path / run / "frames" / "take.h5", "frames") for run in "ab")
    for name, values in one.arrays.items():
        if name == "T_world_camera":
            np.testing.assert_allclose(two[name], values, atol=1e-9)
        elif not name.startswith("check_"):
            np.testing.assert_array_equal(two[name], values)
    assert one.params["workspace"] == two.params["workspace"]


def test_inverted_poses_are_known_where_the_table_is_elsewhere(views, tmp_path):
    T = np.linalg.inv(level((0.1, 0, 0)))
    recording = write_views(tmp_path / "rec", with_poses(views, lambda k, pose: np.linalg.inv(T @ pose)))
    done = piegraph("ingest", "--recording", recording, "--run", tmp_path / "run", "--table", 0.1, check=3)
    assert "inverting T_world_camera puts the table at z = 0.1" in done.stderr


def test_truth_is_moved_with_the_recording(tmp_path):
    recording = tmp_path / "rec"
    points = np.random.default_rng(0).normal(0, 0.1, (2, 5, 3)).astype(np.float32)
    world = moved(points, np.linalg.inv(level(TILTED)))
    arrays = {"particles": world, "vertices": world, "triangles": np.array([[0, 1, 2]]), "time": np.array([0, 0.2])}
    arrays |= {"stroke": np.zeros(2, int), "contact": np.zeros(2, bool), "end_effector": world[:, 0]}
    arrays |= {"hand_keypoints": np.full((2, 21, 3), np.nan)}
    empty = np.zeros(0, np.uint8), np.zeros(3, np.int64)
    for name in ("object_mask", "hand_mask"):
        arrays[name], arrays[f"{name}_offsets"] = empty
    path = recording / "take" / "truth.h5"
    (path.parent / "c" / "color").mkdir(parents=True)
    write_artifact(path, "truth", arrays, stage="", stage_version=1, key="", params={}, inputs={}, quality="")
    run = open_run(tmp_path / "run")
    stage = run.recipe.table["ingest"]
    values = {"recording": recording, "table": TILTED}
    run.recipe = run.recipe.with_values(stage, values, "here", tmp_path)
    found = score.read_truth(run, "take")
    np.testing.assert_allclose(found["vertices"], points, atol=1e-6)
    np.testing.assert_allclose(found["end_effector"], points[:, 0], atol=1e-6)


@pytest.fixture
def planner(tmp_path):
    """A run whose recording has a table 0.1 m up and a robot, and a cloud of an object there."""
    recording = tmp_path / "rec"
    robot = pose([0.1, -0.2, 2.0], [0.5, -0.3, 0.02])
    camera = camera_rig(320, 240)[0]
    entry = {"width": 320, "height": 240, "K": camera.K.tolist(), "T_world_camera": camera.T_world_camera.tolist()}
    recording.mkdir()
    file = {"version": 1, "cameras": {"c": entry}, "T_world_robot": robot.tolist()}
    (recording / "cameras.json").write_text(json.dumps(file))
    run = tmp_path / "run"
    run.mkdir()
    (run / "recipe.toml").write_text(f'[ingest]\nrecording = "{recording}"\ntable = {list(TILTED)}\n')
    grid = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 9), np.linspace(-0.05, 0.05, 9)), -1).reshape(-1, 2)
    cloud = np.pad(grid, ((0, 0), (0, 1)), constant_values=0.01)
    np.savez(tmp_path / "here.npz", cloud)
    np.savez(tmp_path / "now.npz", moved(cloud, np.linalg.inv(level(TILTED))))
    return run, robot, tmp_path


def ask(run, *more):
    question = (
        "--goal-pose",
        "0.08,0,0",
        "--model",
        "static",
        "--samples",
        20,
        "--cem-iterations",
        1,
        "--success",
        0.001,
    )
    return ("plan", "--run", run, *question, *more)


def test_a_plan_is_made_on_the_table_and_told_in_the_frame_that_was_asked_for(planner):
    run, robot, folder = planner
    plain = piegraph_json(*ask(run, "--state", folder / "here.npz", "--table", 0))
    assert plain["frame"] == "world"
    assert [len(x) for x in (plain["strokes"][0]["start"], plain["strokes"][0]["end"])] == [2, 2]
    start, end = (np.array([*plain["strokes"][0][name], 0]) for name in ("start", "end"))
    back = np.linalg.inv(level(TILTED))
    world = piegraph_json(*ask(run, "--state", folder / "now.npz"))["strokes"][0]
    np.testing.assert_allclose(world["start"], moved(start, back), atol=1e-5)
    np.testing.assert_allclose(world["end"], moved(end, back), atol=1e-5)
    told = piegraph_json(*ask(run, "--state", folder / "now.npz", "--frame", "robot"))
    assert told["frame"] == "robot"
    there = told["strokes"][0]
    np.testing.assert_allclose(moved(np.array(there["start"]), robot), world["start"], atol=1e-6)
    np.testing.assert_allclose(moved(np.array(there["end"]), robot), world["end"], atol=1e-6)
    turn = robot[:3, :3] @ Rotation.from_quat(there["quaternion_xyzw"]).as_matrix()
    np.testing.assert_allclose(turn[:, 2], back[:3, 2], atol=1e-6)
    np.testing.assert_allclose(
        turn[:, 0], (np.array(world["end"]) - world["start"]) / np.linalg.norm(end - start), atol=1e-5
    )
    along = np.array(there["end"]) - there["start"]
    assert there["yaw"] == pytest.approx(np.arctan2(along[1], along[0]))
    lines = piegraph(*ask(run, "--state", folder / "now.npz", "--frame", "robot")).stdout
    assert f"in the robot's frame, by T_world_robot of {folder / 'rec' / 'cameras.json'}" in lines


def test_a_cloud_that_floats_is_said_and_a_robot_that_nobody_knows_is_refused(planner):
    run, _, folder = planner
    floats = piegraph(*ask(run, "--state", folder / "now.npz", "--table", 0)).stderr
    assert "the object lies" in floats
    assert "mm above the table\n  try: --table HEIGHT" in floats
    sunk = piegraph(*ask(run, "--state", folder / "here.npz")).stderr
    assert "and more below the table" in sunk
    assert piegraph(*ask(run, "--state", folder / "now.npz")).stderr == ""
    (folder / "rec" / "cameras.json").write_text(
        (folder / "rec" / "cameras.json").read_text().replace("T_world_robot", "x")
    )
    for cameras, message in (("rec/cameras.json", "x: Extra inputs"), ("none.json", "no such file")):
        to = ask(run, "--state", folder / "now.npz", "--frame", "robot", "--cameras", folder / cameras)
        assert message in piegraph(*to, check=3).stderr
    text = json.loads((folder / "rec" / "cameras.json").read_text().replace('"x"', '"T_world_robot"'))
    for T, message in (
        (None, "T_world_robot is missing"),
        (np.eye(4) * 2, "rigid"),
        (np.diag([1, 1, -1, 1]), "rotation"),
    ):
        text["T_world_robot"] = T if T is None else T.tolist()
        (folder / "rec" / "cameras.json").write_text(json.dumps(text))
        assert message in piegraph(*ask(run, "--state", folder / "now.npz", "--frame", "robot"), check=3).stderr
    wrong = piegraph("plan", "--run", run, "--env", "tblock", "--model", "static", "--frame", "robot", check=2).stderr
    assert "--env has a world of its own" in wrong


def test_a_stroke_on_the_table_of_the_world_has_two_numbers():
    ends = np.array([[0.1, 0.2], [0.1, 0.3]], np.float32)
    assert stroke_in(None, ends) == {"start": ends[0].tolist(), "end": ends[1].tolist()}
    upside = stroke_in(pose([np.pi, 0, 0], [0, 0, 1.0]), ends)
    assert upside["yaw"] == pytest.approx(-np.pi / 2)
    assert upside["start"] == pytest.approx([0.1, -0.2, 1.0])


def test_a_look_and_a_model_know_the_table_too(views):
    T = np.linalg.inv(level(TILTED))
    images = [v.color[0] for v in views], [v.depth[0] for v in views]
    plain = look(*images, [v.camera for v in views], LookSettings(ReadParams()))
    there = [v.camera for v in with_poses(views, lambda k, own: T @ own)]
    found = look(*images, there, LookSettings(ReadParams(table=TILTED)))
    assert found.verdict == plain.verdict == "good"
    np.testing.assert_allclose(found.cloud, moved(plain.cloud, T), atol=1e-4)
    np.testing.assert_allclose(found.particles, moved(plain.particles, T), atol=1e-4)
    assert look(*images, there, LookSettings(ReadParams())).verdict == "bad"
    few = PlanParams(samples=8, cem_iterations=1, success=0.001)
    one = Model("static", None, few).plan(plain.cloud, goal_pose=(0.05, 0, 0))
    two = Model("static", None, few.model_copy(update={"table": TILTED})).plan(found.cloud, goal_pose=(0.05, 0, 0))
    np.testing.assert_allclose(two.start, one.start, atol=1e-4)
