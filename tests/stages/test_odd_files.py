"""Ingest of recordings whose files were written otherwise: what is read all the same, and what is told of the rest."""

import codecs
import json
import os

import cv2
import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.checks import check_images
from piegraph_cli.recording.folders import calibration_sequences, list_sequences
from piegraph_cli.stages.hands import _is_grey
from piegraph_cli.stages.images import depth_of
from piegraph_cli.stages.look import read_scene
from piegraph_cli.workspace.artifact import read_artifact
from tests.stages.make_recording import make_cameras, make_recording
from tests.stages.test_ingest import ingest


@pytest.fixture
def recording(tmp_path):
    return make_recording(tmp_path / "rec", sequences=1, frames=8)


def failure(recording, run):
    (outcome,) = ingest(recording, run)
    assert isinstance(outcome.error, DataError)
    return str(outcome.error)


def frames_of(recording, run):
    (outcome,) = ingest(recording, run)
    assert outcome.state == "done", outcome.error
    return read_artifact(run / "frames" / "seq 0.h5", "frames")


def test_texts_in_utf_16_are_read(recording, tmp_path):
    before = frames_of(recording, tmp_path / "before")
    for path in (recording / "cameras.json", recording / "seq 0" / "front" / "timestamps.txt"):
        path.write_bytes(codecs.BOM_UTF16_LE + path.read_text().replace("\n", "\r\n").encode("utf-16-le"))
    after = frames_of(recording, tmp_path / "after")
    np.testing.assert_array_equal(after["time"], before["time"])
    np.testing.assert_array_equal(after["K"], before["K"])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_the_sequence_of_the_board_is_known_whatever_the_encoding(recording, encoding):
    path = recording / "cameras.json"
    entries = json.loads(path.read_text()) | {"calibration_sequence": "seq 0"}
    path.write_bytes(json.dumps(entries).encode(encoding))
    assert calibration_sequences(list_sequences(recording)) == {"seq 0"}


def test_the_largest_depth_is_no_reading(recording, tmp_path):
    places = sorted((recording / "seq 0" / "front" / "depth").iterdir())
    images = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in places]
    for path, image in zip(places, images, strict=True):
        image[:20, :30] = 65535
        cv2.imwrite(str(path), image)
    depth = depth_of(frames_of(recording, tmp_path / "run"))
    for frame, image in enumerate(images):
        assert not depth.depth(frame, 0)[:20, :30].any()
        np.testing.assert_array_equal(depth.depth(frame, 0)[20:], image[20:])
    assert not read_scene(recording / "seq 0:0").depth[0][:20, :30].any()


STAMPS = [
    (lambda t: "\n".join(f"{x:.0f}" for x in t), "6 of 8 time stamps repeat the one before: were they rounded?"),
    (lambda t: "\n".join(f"{np.float32(1.7e9 + x)}" for x in t), "7 of 8 time stamps repeat the one before"),
    (lambda t: "\n".join(f"{k} {x}" for k, x in enumerate(t)), "timestamps.txt, line 1: has 2 numbers"),
    (lambda t: "\n".join(f"{x:.3f}".replace(".", ",") for x in t), "'0,000' is no number: its decimal comma"),
    (lambda t: "\n".join(f"{int(1.34e17 + x * 1e7)}" for x in t), "are these ticks of 100 ns?"),
    (lambda t: "\n".join(f"12:00:{x:06.3f}" for x in t), "line 1: '12:00:00.000' is no number"),
]


@pytest.mark.parametrize(("write", "message"), STAMPS)
def test_what_is_odd_about_time_stamps_is_named(recording, tmp_path, write, message):
    (recording / "seq 0" / "front" / "timestamps.txt").write_text(write([k / 5 for k in range(8)]) + "\n")
    assert message in failure(recording, tmp_path / "run")


def test_time_stamps_in_one_line_are_time_stamps(recording, tmp_path):
    path = recording / "seq 0" / "front" / "timestamps.txt"
    path.write_text(path.read_text().replace("\n", " "))
    assert len(frames_of(recording, tmp_path / "run")["time"]) == 8


T = np.eye(4)
T[:3, :3], T[:3, 3] = np.diag([1.0, -1, -1]), (0.1, 0.2, 0.8)
ENTRIES = [
    ("K", [60, 0, 32, 0, 60, 24, 0, 0, 1], "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"),
    ("K", {"fx": 60, "fy": 60}, "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"),
    ("K", np.eye(4).tolist(), "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"),
    ("T_world_camera", T.ravel().tolist(), "give 4 rows of 4 numbers"),
    ("T_world_camera", T[:3].tolist(), "the last one 0, 0, 0, 1"),
    ("T_world_camera", [0.1, 0.2, 0.8, 1, 0, 0, 0], "of a quaternion or a rotation vector make the matrix first"),
    ("T_world_camera", T.T.tolist(), "T_world_camera is transposed: it has the translation in its last row"),
    ("T_world_camera", (np.diag([1.0, -1, 1, 1]) @ T).tolist(), "the rotation in T_world_camera is mirrored"),
    ("depth_scale", "", "see docs/formats.md for the fields"),
    ("distortion", [[0, 0, 0, 0, 0]], "give one list of 4, 5, 8, 12 or 14 numbers"),
]


@pytest.mark.parametrize(("field", "value", "message"), ENTRIES)
def test_how_a_field_of_cameras_json_is_written_is_told(recording, tmp_path, field, value, message):
    path = recording / "cameras.json"
    entries = json.loads(path.read_text())
    entries["cameras"]["front"][field] = value
    path.write_text(json.dumps(entries))
    said = failure(recording, tmp_path / "run")
    assert message in said
    assert "front" in said
    assert field in said


def test_a_name_that_is_twice_in_cameras_json_is_refused(recording, tmp_path):
    path = recording / "cameras.json"
    path.write_text(path.read_text().replace('"width"', '"depth_scale": 0.001, "width"', 1))
    assert "cameras.json: depth_scale is there twice" in failure(recording, tmp_path / "run")


def test_intrinsics_of_smaller_images_are_told_where_the_lens_folds_by_them(recording, tmp_path):
    path = recording / "cameras.json"
    entries = json.loads(path.read_text())
    entries["cameras"]["front"] |= {"K": [[20, 0, 8], [0, 20, 6], [0, 0, 1]], "distortion": [-0.4, 0.1, 0, 0, 0]}
    path.write_text(json.dumps(entries))
    assert "K has its middle at 8, 6 px, far from that of 64 x 48" in failure(recording, tmp_path / "run")


@pytest.mark.parametrize("names", [("color_{}", "depth16_{}"), ("{}_rgb8", "{}"), ("{}_64x48", "{}_64x48")])
def test_numbers_that_are_the_same_in_all_names_count_nothing(recording, tmp_path, names):
    before = frames_of(recording, tmp_path / "before")
    for camera in ("front", "left cam"):
        for kind, name in zip(("color", "depth"), names, strict=True):
            for path in sorted((recording / "seq 0" / camera / kind).iterdir()):
                path.rename(path.with_name(name.format(int(path.stem)) + path.suffix))
    after = frames_of(recording, tmp_path / "after")
    for array in ("color", "depth", "source_frame"):
        np.testing.assert_array_equal(after[array], before[array])


def test_folders_of_the_system_are_nobodys(recording, tmp_path):
    for name in ("@eaDir", "__MACOSX", "lost+found"):
        (recording / "seq 0" / name / "color").mkdir(parents=True)
        (recording / name / "front" / "color").mkdir(parents=True)
    assert len(frames_of(recording, tmp_path / "run")["time"]) == 8


@pytest.mark.parametrize(("folder", "entry"), [("Front", "front"), ("gro\u0308n", "gr\xf6n")])
def test_a_folder_that_is_spelled_otherwise_than_its_camera_is_told(recording, tmp_path, folder, entry):
    path = recording / "cameras.json"
    entries = json.loads(path.read_text())
    entries["cameras"][entry] = entries["cameras"].pop("front")
    path.write_text(json.dumps(entries))
    (recording / "seq 0" / "front").rename(recording / "seq 0" / folder)
    said = failure(recording, tmp_path / "run")
    assert f"rename the folder: cameras.json has {entry!a}, the folder is called {folder!a}" in said


def test_a_camera_whose_folder_is_a_copy_is_told(recording, tmp_path):
    (outcome,) = ingest(recording, tmp_path / "as it was")
    assert "same images" not in " ".join(outcome.warnings)
    for kind in ("color", "depth"):
        for path in sorted((recording / "seq 0" / "front" / kind).iterdir()):
            (recording / "seq 0" / "left cam" / kind / path.name).write_bytes(path.read_bytes())
    (outcome,) = ingest(recording, tmp_path / "run")
    assert "cameras front and left cam have the same images" in " ".join(outcome.warnings)


def test_images_that_are_turned_are_told_from_such_of_another_size(recording, tmp_path):
    for path in (recording / "seq 0" / "front" / "color").iterdir():
        cv2.imwrite(str(path), np.rot90(cv2.imread(str(path))))
    assert "turn the images back (their EXIF orientation counts)" in failure(recording, tmp_path / "run")


def test_a_list_of_cameras_is_told_how_to_write_it(recording, tmp_path):
    path = recording / "cameras.json"
    entries = json.loads(path.read_text())
    path.write_text(json.dumps({"cameras": list(entries["cameras"].values())}))
    assert "an object that has each camera under its name" in failure(recording, tmp_path / "run")


def test_files_and_folders_that_are_no_recording_are_told_apart(recording, tmp_path):
    (tmp_path / "rec.zip").write_bytes(b"PK")
    for place, message in (
        (tmp_path / "rec.zip", "is packed\n  try: unpack it"),
        (recording / "cameras.json", "is a file, no recording folder"),
        (tmp_path, f"no sequence found, but 1 recordings: rec\n  try: .*--recording {recording}"),
    ):
        with pytest.raises(DataError, match=message):
            list_sequences(place)


@pytest.mark.parametrize("name", [b"s\xe9q", b"s" * 240, b"s\n1"], ids=["latin-1", "long", "line break"])
def test_names_that_no_file_can_have_are_refused(recording, name):
    try:
        os.rename(os.fsencode(recording / "seq 0"), os.fsencode(recording) + b"/" + name)
    except OSError as error:
        pytest.skip(f"this file system has no such names: {error}")
    with pytest.raises(DataError, match=r"(no UTF-8 text|too long|a line break)[^\n]*\n  try: rename"):
        list_sequences(recording)


def told(depth=None, color=None):
    camera = make_cameras()[0]
    rng = np.random.default_rng(0)
    depth = rng.integers(600, 900, (48, 64)).astype(np.uint16) if depth is None else depth
    color = rng.integers(0, 255, (48, 64, 3), np.uint8) if color is None else color
    found = check_images(camera, [depth] * 4, [color] * 4)
    return {(check.name, check.verdict): check.text for check in found if check.verdict != "good"}


def test_depth_in_even_steps_is_told():
    depth = np.random.default_rng(0).integers(600, 1400, (48, 64)).astype(np.uint16)
    assert told(depth) == {}
    assert told(depth // 4 * 4) == {}, "as fine as many cameras are"
    assert told(depth // 6 * 6) == {("readings", "doubtful"): "depth comes in steps of 6 mm"}
    assert told(depth // 16 * 16) == {("readings", "bad"): "depth comes in steps of 16 mm"}
    scaled = np.rint(np.rint(depth * 255 / 4000) * 4000 / 255).astype(np.uint16)
    assert told(scaled) == {("readings", "bad"): "depth comes in steps of 16 mm"}


def test_depth_of_stereo_cameras_has_wider_steps_far_away():
    disparity = np.random.default_rng(0).integers(40, 200, (48, 64))
    assert told((40_000 / disparity * 5).astype(np.uint16)) == {}
    levels = np.full((48, 64), 700, np.uint16)
    levels[10:20] = 650
    assert told(levels) == {}, "a table and a box seen from straight above have two depths"


def test_colour_of_few_bits_is_told():
    color = np.random.default_rng(0).integers(0, 16, (48, 64, 3), np.uint8)
    assert list(told(color=color)) == [("exposure", "doubtful")]
    assert told(color=color * 8) == {}


def test_images_without_colours_are_told():
    rng = np.random.default_rng(0)
    grey = [np.repeat(rng.integers(0, 255, (48, 64, 1), np.uint8), 3, 2) for _ in range(8)]
    assert _is_grey(grey)
    grey[4][:, ::8] += np.uint8(0)
    grey[4][::8, ::8, 0] = 255 - grey[4][::8, ::8, 0]
    assert not _is_grey(grey)
