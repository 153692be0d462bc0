"""An end-effector that came with the recording stands where the hand stood, from `ingest` to `fuse`."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.perception.clouds import grasped, while_closed
from piegraph_cli.perception.params import FuseParams, HandsParams
from piegraph_cli.recording.images import encode_masks, join_images
from piegraph_cli.stages import end_effectors, fuse, hands
from piegraph_cli.workspace.artifact import check_arrays, read_artifact, write_artifact
from tests.cli import piegraph_json
from tests.perception.scene import WORKSPACE, ring_camera
from tests.stages.chain import artifact, context
from tests.stages.make_recording import make_recording

FRAMES = 12


def frames(tips, **more):
    camera = ring_camera(0.4)
    arrays = {"K": camera.K[None], "time": np.arange(len(tips)) / 5, "end_effector": np.array(tips), **more}
    return artifact(arrays, {"workspace": WORKSPACE.ravel().tolist()})


def path(y=0.0):
    return np.column_stack([np.linspace(0.1, 0.0, FRAMES), np.full(FRAMES, y), np.full(FRAMES, 0.02)])


def test_the_recorded_path_becomes_the_hand(tmp_path):
    tips = path()
    tips[0] = np.nan
    out = hands.run({"frames": frames(tips, opening=np.linspace(0, 0.08, FRAMES))}, HandsParams(), context())
    np.testing.assert_array_equal(out.arrays["end_effector"], tips)
    assert out.arrays["observed"].tolist() == [False, *[True] * (FRAMES - 1)]
    assert (out.arrays["source"] == 1).all()
    assert "known in 92% of 12 frames, with its opening" in out.quality
    assert not out.warnings
    write_artifact(tmp_path / "h.h5", "hands", out.arrays, stage="hands", stage_version=1, key="", params={}, inputs={})


def test_a_path_of_another_frame_or_hardly_known_is_said():
    out = hands.run({"frames": frames(path(y=0.9))}, HandsParams(), context())
    assert "never comes into the workspace: its middle is x, y, z = +0.05, +0.90, +0.02 m" in out.warnings[0]
    tips = path()
    tips[4:] = np.nan
    assert (
        "known in 33% of the frames only" in hands.run({"frames": frames(tips)}, HandsParams(), context()).warnings[0]
    )


def test_a_recording_without_one_has_none_to_take():
    without = frames(path())
    del without.arrays["end_effector"]
    with pytest.raises(DataError, match="has no end-effector"):
        hands.run({"frames": without}, HandsParams(source="file"), context())


def test_a_gripper_holds_from_its_first_touch_to_its_last_of_each_time_it_is_closed():
    touching = np.array([0, 1, 1, 1, 0, 0, 1, 0, 1, 1, 0, 0], bool)
    opening = np.array([8, 8, 8, 3, 3, 3, 3, 3, 3, 8, 8, np.nan]) / 100
    assert np.flatnonzero(while_closed(touching, opening)).tolist() == [3, 4, 5, 6, 7, 8]
    assert while_closed(touching, opening, 0.02).sum() == 0
    np.testing.assert_array_equal(while_closed(touching, np.full(12, 0.03) + 0.001 * touching), touching)
    np.testing.assert_array_equal(while_closed(touching, np.full(12, np.nan)), touching)
    again = np.array([8, 3, 3, 8, 8, 8, 3, 3, 3, 3, 8, 8]) / 100
    assert np.flatnonzero(while_closed(touching, again)).tolist() == [1, 2, 6, 7, 8, 9]


def test_a_stick_is_found_where_the_setting_says_so_and_named_where_no_hand_is(monkeypatch):
    given = frames(path(), camera_name=np.array([b"cam"]))
    del given.arrays["end_effector"]
    seen = np.arange(FRAMES) > 2
    monkeypatch.setattr(end_effectors, "tips_by_depth", lambda *_: (np.where(seen[:, None], path(), np.nan), seen))
    out = hands.run({"frames": given}, HandsParams(source="stick"), context())
    assert (out.arrays["source"] == 2).all()
    assert out.arrays["observed"].tolist() == seen.tolist()
    assert out.quality == "tip of a stick in 75% of 12 frames, by depth alone"
    error = end_effectors.no_hand(given, HandsParams())
    assert "in 75% of the frames: take it with --source glove" in error.hint
    arrays = {"end_effector": np.where(np.arange(FRAMES)[:, None] < 6, path(y=0.01), np.nan)}
    told = end_effectors.completed(arrays, given, HandsParams())
    assert told == [
        "in 6 frames without a hand what comes in by depth is taken for it, which is 10 mm from the hand where both are known"
    ]
    np.testing.assert_array_equal(arrays["end_effector"][:, 1], [0.01] * 6 + [0.0] * 6)
    assert arrays["source"].tolist() == [0] * 6 + [2] * 6
    far = np.where(np.arange(FRAMES)[:, None] < 6, path(y=0.1), np.nan)
    assert not end_effectors.completed({"end_effector": far}, given, HandsParams())
    monkeypatch.setattr(
        end_effectors, "tips_by_depth", lambda *_: (np.full((FRAMES, 3), np.nan), np.zeros(FRAMES, bool))
    )
    assert "check that the hand is in view" in end_effectors.no_hand(given, HandsParams()).hint
    with pytest.raises(DataError, match="nothing comes in from above in frames 0 to 11"):
        hands.run({"frames": given}, HandsParams(source="glove"), context())


def test_fuse_takes_contact_from_the_opening():
    camera = ring_camera(0.4)
    mask = np.zeros((camera.height, camera.width), bool)
    mask[70:90, 95:115] = True
    depth = np.full(mask.shape, 745, np.uint16)
    masks = dict(zip(("mask", "mask_offsets"), encode_masks([mask] * FRAMES), strict=True))
    import cv2

    images = join_images([cv2.imencode(".png", depth)[1].tobytes()] * FRAMES)
    seen = frames(
        np.zeros((FRAMES, 3)),
        depth=images[0],
        depth_offsets=images[1],
        image_size=np.array([[camera.width, camera.height]]),
        distortion=camera.distortion[None],
        depth_scale=np.array([0.001]),
        T_world_camera=camera.T_world_camera[None],
        camera_name=np.array([b"cam"]),
    )
    opening = np.where((np.arange(FRAMES) > 3) & (np.arange(FRAMES) < 8), 0.01, 0.08)
    for arrays, expected in (({}, FRAMES), ({"opening": opening}, 4)):
        unseen = np.full((FRAMES, 1, 21, 2), np.nan)
        tool = artifact({"end_effector": np.zeros((FRAMES, 3)), "landmarks": unseen, **arrays})
        out = fuse.run({"frames": seen, "masks": artifact(masks), "hands": tool}, FuseParams(), context())
        assert out.arrays["contact"].sum() == expected
        assert out.arrays["mode"].sum() == (4 if arrays else 0), "it closes on the object"


def test_a_gripper_that_was_closed_before_it_touched_pushes():
    opening = np.array([8, 8, 1, 1, 1, 8, 8, 1, 1, 1, np.nan, 8]) / 100
    touching = np.array([0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1], bool)
    holds = while_closed(touching, opening)
    assert np.flatnonzero(holds).tolist() == [3, 4, 7, 8, 9, 10]
    assert np.flatnonzero(grasped(holds, opening)).tolist() == [7, 8, 9, 10]
    assert not grasped(touching, np.full(12, 0.05)).any()


def test_optional_datasets_may_be_absent_but_not_wrong():
    arrays = hands.run({"frames": frames(path())}, HandsParams(), context()).arrays
    arrays = {k: np.asarray(v).astype({"source": "u1"}.get(k, np.asarray(v).dtype)) for k, v in arrays.items()}
    arrays |= {k: arrays[k].astype(np.float32) for k in ("landmarks", "keypoints", "end_effector")}
    check_arrays("h.h5", "hands", arrays)
    check_arrays("h.h5", "hands", {k: v for k, v in arrays.items() if k != "source"})
    with pytest.raises(DataError, match="axis frame has length"):
        check_arrays("h.h5", "hands", arrays | {"opening": np.zeros(3)})
    with pytest.raises(DataError, match="end_effector is missing"):
        check_arrays("h.h5", "hands", {k: v for k, v in arrays.items() if k != "end_effector"})


def test_a_recorded_path_goes_with_the_table_to_z_0(tmp_path):
    recording = make_recording(tmp_path / "rec", sequences=1)
    lines = "".join(f"{k / 10},0.1,{k / 100},0.15\n" for k in range(-1, 9))
    (recording / "seq 0" / "end_effector.csv").write_text("time,x,y,z\n" + lines)
    given = ("ingest", "--run", tmp_path / "run", "--recording", recording, "--accept", "table,view,edges,readings")
    for table, height in (("0", 0.15), ("0.1", 0.05)):
        piegraph_json(*given, "--table", table)
        tips = read_artifact(tmp_path / "run" / "frames" / "seq 0.h5", "frames")["end_effector"]
        np.testing.assert_allclose(tips[:, 2], height)
