"""Ingest: what it keeps, how it resamples, and every way in which a recording can be wrong."""

import json
import shutil
import struct
import zlib

import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
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


def remove_frames(folder, *frames, stamps=True):
    for frame in frames:
        for kind, suffix in (("color", "jpg"), ("depth", "png")):
            (folder / kind / f"{frame:06d}.{suffix}").unlink()
    if stamps:
        lines = (folder / "timestamps.txt").read_text().split()
        (folder / "timestamps.txt").write_text("\n".join(t for k, t in enumerate(lines) if k not in frames))


def a_time_too_many(folder):
    path = folder / "left cam" / "timestamps.txt"
    path.write_text(path.read_text() + "0.8\n0.9\n")


def same_number_twice(folder):
    (folder / "front" / "color" / "2.jpg").write_bytes((folder / "front" / "color" / "000002.jpg").read_bytes())


def no_number_in_the_name(folder):
    (folder / "front" / "color" / "000002.jpg").rename(folder / "front" / "color" / "two.jpg")


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


def unknown_camera(folder):
    shutil.copytree(folder / "front", folder / "right")


def depth_of_floats(folder):
    for path in (folder / "front" / "depth").iterdir():
        path.unlink()
        np.save(path.with_suffix(".npy"), np.ones((48, 64), np.float32))


def exchanged_bytes(folder):
    import cv2

    for frame, path in enumerate(sorted((folder / "front" / "depth").iterdir())):
        smooth = np.linspace(500 + frame, 900, 64 * 48).reshape(48, 64).astype(np.uint16)
        cv2.imwrite(str(path), smooth.byteswap())


def cut_image(folder):
    path = folder / "front" / "color" / "000002.jpg"
    path.write_bytes(path.read_bytes()[:-200])


def late_camera(folder):
    path = folder / "left cam" / "timestamps.txt"
    path.write_text("".join(f"{float(t) + 0.09}\n" for t in path.read_text().split()))


def backward_time(folder):
    (folder / "front" / "timestamps.txt").write_text("0\n0.2\n0.1\n0.6\n")


def times(*lines):
    def write(folder):
        (folder / "front" / "timestamps.txt").write_text("\n".join(lines))

    write.__name__ = "times " + " ".join(lines)
    return write


def large_depth(folder):
    import cv2

    for path in (folder / "front" / "depth").iterdir():
        cv2.imwrite(str(path), np.full((96, 128), 700, np.uint16))


def other_clock(folder):
    path = folder / "left cam" / "timestamps.txt"
    path.write_text("".join(f"{float(t) + 1.7e9}\n" for t in path.read_text().split()))


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
    (unknown_camera, "camera right has a folder but is not in cameras.json"),
    (depth_of_floats, "front/depth: holds 000000.npy, and no .png files"),
    (exchanged_bytes, "camera front: the two bytes of depth are exchanged (big-endian), frame 0"),
    (cut_image, "camera front, frame 000002 cannot be decoded"),
    (a_time_too_many, "camera left cam has 4 frames and 6 time stamps"),
    (same_number_twice, "000002.jpg and 2.jpg are the same frame"),
    (no_number_in_the_name, "image two.jpg has no number in its name"),
    (drop_depth, "4 colour and 3 depth images; first unpaired frame 000002"),
    (break_image, "camera front, frame 000001 cannot be decoded"),
    (empty_image, "camera front, frame 000001 cannot be decoded"),
    (zero_depth, "every depth image of camera front is zero, from frame 0"),
    (shrink_image, "image is 10 x 10, cameras.json says 64 x 48"),
    (eight_bit_depth, "16-bit PNG"),
    (late_camera, "front and left cam are 92 ms apart in frame 0"),
    (backward_time, "time stamps must increase: line 3"),
    (times("0", "0.2", "nan", "0.6"), "timestamps.txt, line 3: 'nan' is not a finite number"),
    (times("0", "0.2", "0.2", "0.6"), "time stamps must increase: line 3"),
    (times("0", "200", "400", "600"), "0.005 frames a second: are these milliseconds?"),
    (times("0", "33333", "66667", "99999"), "3e-05 frames a second: are these microseconds?"),
    (times("17e17", "1700000000200000000", "17000000004e8", "17000000006e8"), "are these nanoseconds?"),
    (times("0", "0.2", "0.4", "3600.6"), "time stamps leap 3600.2 s ahead at line 4"),
    (times("0", "1e-5", "2e-5", "3e-5"), "1e+05 frames a second"),
    (other_clock, "share no time: front 0.00 to 0.60 s and left cam 1700000000.00 to"),
    (large_depth, "depth image is 128 x 96, colour 64 x 48: depth must be registered to colour"),
    (no_number, "timestamps.txt, line 3: 'soon' is no number"),
    (one_frame, "one frame"),
    (no_frames, "camera front has no frames"),
    (no_extrinsic, "camera front: T_world_camera is missing"),
    (change_camera(T_world_camera=SINGULAR), "camera front: the rotation in T_world_camera is singular"),
    (change_camera(T_world_camera=[[1, 0], [0, 1]]), "4 x 4"),
    (change_camera(K=[[0, 0, 0]] * 3), "positive focal lengths"),
    (change_camera(distortion=[0.1]), "4, 5, 8, 12 or 14 finite numbers"),
    (change_camera(typo=1), "cameras.front.typo"),
    (change_camera(width=32), "image is 64 x 48, cameras.json says 32 x 48"),
    (change_camera(depth_width=32), "depth_width without depth_K"),
    (change_camera(depth_K=[[30, 0, 16], [0, 30, 12], [0, 0, 1]]), "depth_K without T_color_depth"),
    (change_camera(depth_K=[[30, 0], [0, 30]], T_color_depth=np.eye(4).tolist()), "depth_K must be a finite 3 x 3"),
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


def kept(folder, sequence="seq 0"):
    return read_artifact(folder / "frames" / f"{sequence}.h5", "frames")


def test_images_go_by_the_number_in_their_names(tmp_path):
    recording = make_recording(tmp_path / "rec", sequences=1, frames=12)
    run = tmp_path / "run"
    ingest(recording, run)
    padded = [color_of(kept(run)).color(f, c) for f in range(12) for c in range(2)]
    for path in [p for p in (recording / "seq 0").rglob("0*") if p.is_file()]:
        path.rename(path.with_name(f"left_{int(path.stem)}{path.suffix}"))
    ingest(recording, run)
    plain = [color_of(kept(run)).color(f, c) for f in range(12) for c in range(2)]
    np.testing.assert_array_equal(plain, padded)


def test_names_that_begin_with_a_dot_are_nobodys(recording, tmp_path):
    run = tmp_path / "run"
    ingest(recording, run)
    for path in [p for p in recording.rglob("*") if p.is_file()]:
        (path.parent / f"._{path.name}").write_bytes(b"\0\5\26\7")
    (recording / "seq 0" / ".trash" / "color").mkdir(parents=True)
    (recording / "notes" / ".trash" / "color").mkdir(parents=True)
    assert [(o.unit, o.state) for o in ingest(recording, run)] == [("seq 0", "cached"), ("seq 1", "cached")]
    assert [o.state for o in ingest(recording, tmp_path / "run2")] == ["done", "done"]


def test_frames_without_a_partner_are_left_out_and_said(tmp_path, caplog):
    recording = make_recording(tmp_path / "rec", sequences=1, frames=10)
    remove_frames(recording / "seq 0" / "front", 4)
    remove_frames(recording / "seq 0" / "left cam", 6, 7)
    ingest(recording, tmp_path / "run")
    frames = kept(tmp_path / "run")
    assert frames["source_frame"].tolist() == [[k, k] for k in (0, 1, 2, 3, 5, 8, 9)]
    np.testing.assert_allclose(frames["time"], np.array([0, 1, 2, 3, 5, 8, 9]) / 5, atol=1e-9)
    assert "left out: front 2 of 9, left cam 1 of 8; first: frame 5 of front" in caplog.text
    assert "no image between 000003 and 000005: images and time stamps, 9 each, are paired in order" in caplog.text


def test_time_stamps_without_an_image_go_by_number(tmp_path, caplog):
    recording = make_recording(tmp_path / "rec", sequences=1, frames=10)
    remove_frames(recording / "seq 0" / "front", 4, 5, stamps=False)
    ingest(recording, tmp_path / "run")
    frames = kept(tmp_path / "run")
    assert frames["source_frame"].tolist() == [[k, k] for k in (0, 1, 2, 3, 6, 7, 8, 9)]
    np.testing.assert_allclose(np.diff(frames["time"]), [0.2] * 3 + [0.6] + [0.2] * 3, atol=1e-9)
    assert "2 time stamps without an image, left out" in caplog.text


def test_a_faster_camera_is_paired_without_a_word(tmp_path, caplog):
    recording = make_recording(tmp_path / "rec", sequences=1, frames=12)
    slow, fast = recording / "seq 0" / "front", recording / "seq 0" / "left cam"
    remove_frames(slow, *range(6, 12))
    (fast / "timestamps.txt").write_text("".join(f"{k / 10 + 0.02}\n" for k in range(12)))
    ingest(recording, tmp_path / "run")
    assert kept(tmp_path / "run")["source_frame"].tolist() == [[k, 2 * k] for k in range(6)]
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert not [text for text in said if "geometry" not in text], "noise has no table"


def test_a_sound_recording_is_read_in_silence(recording, tmp_path, caplog):
    ingest(recording, tmp_path / "run")
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert not [text for text in said if "geometry" not in text], "noise has no table"


def test_a_clock_in_milliseconds_is_no_matter_of_skew(recording, tmp_path):
    for path in recording.rglob("timestamps.txt"):
        path.write_text("".join(f"{float(t) * 1000}\n" for t in path.read_text().split()))
    assert "are these milliseconds?" in str(ingest(recording, tmp_path / "run", max_skew=10.0)[0].error)


def test_sequences_are_left_out(recording, tmp_path):
    run = tmp_path / "run"
    ingest(recording, run)
    assert [(o.unit, o.state) for o in ingest(recording, run, exclude=["seq 0"])] == [("seq 1", "cached")]
    with pytest.raises(UsageError, match="no sequence seq 7"):
        ingest(recording, run, exclude=["seq 7"])
    with pytest.raises(DataError, match="every sequence is left out"):
        ingest(recording, run, exclude=["seq 0", "seq 1"])
    ingest(recording, run, exclude=["seq 0"])
    shutil.rmtree(recording)
    assert open_run(run).units(STAGES["ingest"]) == ["seq 1"]


def test_the_sequence_of_the_board_is_left_out_and_said_once(recording, tmp_path, caplog):
    entries = json.loads((recording / "cameras.json").read_text())
    (recording / "cameras.json").write_text(json.dumps(entries | {"calibration_sequence": "seq 0"}))
    shutil.copytree(recording / "seq 1", recording / "seq 2")
    assert [o.unit for o in ingest(recording, tmp_path / "run")] == ["seq 1", "seq 2"]
    assert caplog.text.count("seq 0 is left out: by cameras.json it shows the calibration board") == 1


def test_resampling_takes_the_nearest_frames_once_each():
    fast = {"a": np.arange(31) / 30, "b": np.arange(31) / 30 + 0.004}
    time, source, _ = align_frames(fast, 5.0, 0.05, "here")
    np.testing.assert_allclose(np.diff(time), 0.2, atol=1e-6)
    assert source[:, 0].tolist() == [0, 6, 12, 18, 24, 30]
    slow = {"a": np.arange(5) * 0.5}
    time, source, _ = align_frames(slow, 5.0, 0.05, "here")
    assert source[:, 0].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("fps", [1.0, 2.0, 2.5, 3.0, 4.0])
def test_resampling_keeps_the_cameras_together(fps):
    times = {"a": np.arange(50) / 5, "b": np.arange(50) / 5 + 0.003}
    time, source, _ = align_frames(times, fps, 0.05, "here")
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


def test_an_image_that_promises_too_many_pixels_is_an_error_with_its_name(tmp_path):
    recording = make_recording(tmp_path / "rec")
    image = next(iter(sorted((recording / "seq 0").rglob("depth/*.png"))))
    data = bytearray(image.read_bytes())
    data[16:24] = struct.pack(">II", 100_000, 100_000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    image.write_bytes(data)
    error = ingest(recording, tmp_path / "run")[0].error
    assert isinstance(error, DataError)
    assert image.name in error.where


def test_times_that_are_no_file_are_named(tmp_path):
    recording = make_recording(tmp_path / "rec")
    times = next(iter(sorted((recording / "seq 0").rglob("timestamps.txt"))))
    times.unlink()
    times.mkdir()
    error = ingest(recording, tmp_path / "run")[0].error
    assert isinstance(error, DataError)
    assert "timestamps.txt" in str(error)
