"""Ingest: what it keeps, how it resamples, and every way in which a recording can be wrong."""

import json
import shutil

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.timing import align_frames
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.images import cameras_of, color_of, depth_of
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_stage
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.cli import piegraph, piegraph_json
from tests.stages.make_recording import make_recording


def ingest(recording, folder, **settings):
    run = Run(folder, Recipe(STAGES, {"ingest": {"recording": str(recording), **settings}}))
    run.save_recipe()
    return run_stage(run, STAGES["ingest"], Options())


@pytest.fixture
def recording(tmp_path):
    return make_recording(tmp_path / "a recording")


def test_cameras_and_images_come_through_unchanged(recording, tmp_path):
    outcomes = ingest(recording, tmp_path / "run")
    assert [o.state for o in outcomes] == ["done", "done"]
    frames = read_artifact(tmp_path / "run" / "frames" / "seq 1.h5", "frames")
    cameras = cameras_of(frames)
    assert [c.name for c in cameras] == ["front", "left cam"]
    assert cameras[0].T_world_camera[2, 3] == 0.8
    import cv2

    depth = cv2.imread(str(recording / "seq 1" / "left cam" / "depth" / "000002.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(depth_of(frames).depth(2, 1), depth)
    color = cv2.imread(str(recording / "seq 1" / "front" / "color" / "000003.jpg"))[:, :, ::-1]
    np.testing.assert_array_equal(color_of(frames).color(3, 0), color)
    np.testing.assert_allclose(frames["time"], [0, 0.2, 0.4, 0.6], atol=1e-9)


def remove_camera(folder):
    shutil.rmtree(folder / "left cam")


def drop_frame(folder):
    for kind, suffix in (("color", "jpg"), ("depth", "png")):
        (folder / "left cam" / kind / f"000003.{suffix}").unlink()
    path = folder / "left cam" / "timestamps.txt"
    path.write_text("\n".join(path.read_text().split()[:3]))


def drop_depth(folder):
    (folder / "front" / "depth" / "000002.png").unlink()


def break_image(folder):
    (folder / "front" / "color" / "000001.jpg").write_bytes(b"not an image")


def empty_image(folder):
    (folder / "front" / "depth" / "000001.png").write_bytes(b"")


def zero_depth(folder):
    import cv2

    for path in (folder / "front" / "depth").iterdir():
        cv2.imwrite(str(path), np.zeros((48, 64), np.uint16))


def shrink_image(folder):
    import cv2

    path = folder / "front" / "color" / "000001.jpg"
    cv2.imwrite(str(path), np.zeros((10, 10, 3), np.uint8))


def eight_bit_depth(folder):
    import cv2

    cv2.imwrite(str(folder / "front" / "depth" / "000001.png"), np.zeros((48, 64), np.uint8))


def late_camera(folder):
    path = folder / "left cam" / "timestamps.txt"
    path.write_text("".join(f"{float(t) + 0.09}\n" for t in path.read_text().split()))


def backward_time(folder):
    (folder / "front" / "timestamps.txt").write_text("0\n0.2\n0.1\n0.6\n")


def no_number(folder):
    (folder / "front" / "timestamps.txt").write_text("0\n0.2\nsoon\n0.6\n")


def one_frame(folder):
    for camera in ("front", "left cam"):
        for kind in ("color", "depth"):
            for path in sorted((folder / camera / kind).iterdir())[1:]:
                path.unlink()
        (folder / camera / "timestamps.txt").write_text("0\n")


def no_frames(folder):
    one_frame(folder)
    for camera in ("front", "left cam"):
        for kind in ("color", "depth"):
            for path in (folder / camera / kind).iterdir():
                path.unlink()
        (folder / camera / "timestamps.txt").write_text("")


def change_camera(**changes):
    def change(folder):
        entries = json.loads((folder.parent / "cameras.json").read_text())
        entries["cameras"]["front"] |= changes
        (folder / "cameras.json").write_text(json.dumps(entries))

    change.__name__ = "_".join(changes)
    return change


def no_extrinsic(folder):
    entries = json.loads((folder.parent / "cameras.json").read_text())
    del entries["cameras"]["front"]["T_world_camera"]
    (folder / "cameras.json").write_text(json.dumps(entries))


SINGULAR = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
BAD = [
    (remove_camera, "left cam is in cameras.json but has no folder"),
    (drop_frame, "cameras differ in frames: front 4, left cam 3"),
    (drop_depth, "4 colour and 3 depth images; first unpaired frame 000002"),
    (break_image, "camera front, frame 000001 cannot be decoded"),
    (empty_image, "camera front, frame 000001 cannot be decoded"),
    (zero_depth, "every depth image of camera front is zero, from frame 0"),
    (shrink_image, "image is 10 x 10, cameras.json says 64 x 48"),
    (eight_bit_depth, "16-bit PNG"),
    (late_camera, "front and left cam are 92 ms apart in frame 0"),
    (backward_time, "time stamps must increase: line 3"),
    (no_number, "a line is not a number"),
    (one_frame, "one frame"),
    (no_frames, "no frames"),
    (no_extrinsic, "camera front: T_world_camera is missing"),
    (change_camera(T_world_camera=SINGULAR), "camera front: the rotation in T_world_camera is singular"),
    (change_camera(T_world_camera=[[1, 0], [0, 1]]), "4 x 4"),
    (change_camera(K=[[0, 0, 0]] * 3), "positive focal lengths"),
    (change_camera(distortion=[0.1]), "five finite numbers"),
    (change_camera(typo=1), "cameras.front.typo"),
    (change_camera(width=32), "cameras differ in image size: front 32 x 48, left cam 64 x 48"),
]


@pytest.mark.parametrize(("breaks", "message"), BAD, ids=[b.__name__ for b, _ in BAD])
def test_a_broken_sequence_is_named_and_the_other_is_still_read(recording, tmp_path, breaks, message):
    breaks(recording / "seq 0")
    failed, done = ingest(recording, tmp_path / "run")
    assert (failed.state, done.state) == ("failed", "done")
    assert isinstance(failed.error, DataError)
    assert message in str(failed.error)
    assert "seq 0" in str(failed.error)
    assert open_run(tmp_path / "run").state(STAGES["ingest"], "seq 0") == "failed"


def test_missing_recording_and_cameras(recording, tmp_path):
    with pytest.raises(DataError, match="no such"):
        ingest(tmp_path / "none", tmp_path / "run")
    (recording / "cameras.json").unlink()
    assert "cameras.json is missing" in str(ingest(recording, tmp_path / "run")[0].error)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="no sequence found"):
        ingest(tmp_path / "empty", tmp_path / "run2")


def test_a_repaired_sequence_is_no_failure_any_more(recording, tmp_path):
    stamps = recording / "seq 0" / "front" / "timestamps.txt"
    kept = stamps.read_text()
    backward_time(recording / "seq 0")
    ingest(recording, tmp_path / "run")
    stamps.write_text(kept)
    assert [o.state for o in ingest(recording, tmp_path / "run")] == ["done", "cached"]
    assert open_run(tmp_path / "run").failure(STAGES["ingest"], "seq 0") is None


def test_resampling_takes_the_nearest_frames_once_each():
    fast = {"a": np.arange(31) / 30, "b": np.arange(31) / 30 + 0.004}
    time, source = align_frames(fast, 5.0, 0.05, "here")
    np.testing.assert_allclose(np.diff(time), 0.2, atol=1e-6)
    assert source[:, 0].tolist() == [0, 6, 12, 18, 24, 30]
    slow = {"a": np.arange(5) * 0.5}
    time, source = align_frames(slow, 5.0, 0.05, "here")
    assert source[:, 0].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("fps", [1.0, 2.0, 2.5, 3.0, 4.0])
def test_resampling_keeps_the_cameras_together(fps):
    times = {"a": np.arange(50) / 5, "b": np.arange(50) / 5 + 0.003}
    time, source = align_frames(times, fps, 0.05, "here")
    assert (source[:, 0] == source[:, 1]).all()
    assert (np.diff(source[:, 0]) > 0).all()
    assert np.diff(time).mean() == pytest.approx(1 / fps, rel=0.05)


def test_later_stages_say_what_was_left_out_and_why(recording, tmp_path):
    break_image(recording / "seq 0")
    piegraph("ingest", "--run", tmp_path / "run", "--recording", recording, check=3)
    done = piegraph("hands", "--run", tmp_path / "run", check=3)
    assert "seq 0: left out, since it failed before" in done.stderr
    assert "no camera sees a hand" in done.stderr, "seq 1 was tried"
    rows = piegraph_json("status", "--run", tmp_path / "run")["artifacts"]
    assert [r["state"] for r in rows if r["stage"] == "hands"] == ["failed", "failed"]
