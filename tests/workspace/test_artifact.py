"""Artifacts: round trip, atomic write, and what a reader refuses."""

import re
from unittest import mock

import h5py
import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.workspace import artifact
from piegraph_cli.workspace.artifact import (
    CHECKED_FROM,
    CHUNK_BYTES,
    Header,
    read_artifact,
    read_header,
    read_key,
    write_artifact,
)
from piegraph_cli.workspace.schema import SCHEMA_VERSION
from piegraph_cli.workspace.sealed import BLOCK
from piegraph_cli.workspace.spent import machine
from tests.hdf5 import edited, reseal, unsealed


def tracks(frames: int = 3, particles: int = 4) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "positions": rng.normal(size=(frames, particles, 3)).astype(np.float32),
        "residual": np.zeros(frames, np.float32),
        "visibility": np.ones((frames, particles), np.float32),
        "mode": np.zeros(frames, np.uint8),
        "end_effector": np.full((frames, 3), np.nan, np.float32),
        "contact": np.zeros(frames, bool),
        "time": np.arange(frames, dtype=float),
    }


def write(path, arrays, key="k"):
    write_artifact(
        path, "tracks", arrays, stage="track", stage_version=1, key=key, params={"a": 1}, inputs={}, quality="q"
    )


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "with space" / "s.h5"
    write(path, tracks())
    return path


def test_round_trip_keeps_values_types_and_attributes(stored):
    artifact = read_artifact(stored, "tracks")
    for name, value in tracks().items():
        np.testing.assert_array_equal(artifact[name], value)
        assert artifact[name].dtype == value.dtype
    assert (artifact.key, artifact.params, artifact.quality) == ("k", {"a": 1}, "q")
    with h5py.File(stored) as file:
        assert file["positions"].attrs["units"] == "m"
        assert file["positions"].attrs["axes"] == "frame,particle,xyz"
        assert file["positions"].compression == "gzip"
        assert file["positions"].fletcher32


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_behind(stored):
    before = stored.read_bytes()
    with pytest.raises(DataError, match="not finite"):
        write(stored, tracks() | {"positions": np.full((3, 4, 3), np.nan)}, key="new")
    with pytest.raises(RuntimeError), atomic_file(stored) as temporary:
        temporary.write_bytes(b"half")
        raise RuntimeError
    assert stored.read_bytes() == before
    assert [p.name for p in stored.parent.iterdir()] == [stored.name]


def test_a_full_disk_is_named_and_keeps_the_old_file(stored):
    before = stored.read_bytes()
    with pytest.raises(DataError, match="No space left"), atomic_file(stored) as temporary:
        temporary.write_bytes(b"half")
        raise OSError(28, "No space left on device")
    assert stored.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.__delitem__("contact"), "dataset contact is missing"),
        (lambda f: f.create_dataset("other", data=[1]), "not a dataset"),
        (lambda f: f["positions"].__setitem__((0, 1, 2), np.inf), r"positions.*not finite at index \(0, 1, 2\)"),
        (lambda f: f.attrs.__setitem__("schema_version", SCHEMA_VERSION + 1), "newer than this piegraph"),
        (lambda f: f.attrs.__delitem__("key"), "not an artifact of this version"),
        (lambda f: f.attrs.__setitem__("artifact", "masks"), "holds masks, expected tracks"),
        (lambda f: f.attrs.__setitem__("params", "{"), "params or inputs attribute is damaged"),
    ],
)
def test_a_reader_names_file_and_dataset(stored, change, message):
    with edited(stored) as file:
        change(file)
    with pytest.raises(DataError, match=message) as caught:
        read_artifact(stored, "tracks")
    assert str(stored) in str(caught.value)
    assert caught.value.hint


def test_unequal_axes_are_refused(tmp_path):
    with pytest.raises(DataError, match="axis frame has length 4, expected 3"):
        write(tmp_path / "a.h5", tracks() | {"time": np.zeros(4)})


@pytest.mark.parametrize("keep", [0, 100, 2000, -200])
def test_a_truncated_file_is_refused_and_made_again(stored, keep):
    stored.write_bytes(stored.read_bytes()[:keep])
    with pytest.raises(DataError):
        read_artifact(stored, "tracks")


def test_flipped_bytes_in_data_are_noticed(stored):
    with h5py.File(stored) as file:
        start = file["positions"].id.get_chunk_info(0).byte_offset
    data = bytearray(stored.read_bytes())
    data[start + 20] ^= 0xFF
    stored.write_bytes(bytes(data))
    with pytest.raises(DataError, match="the checksum differs"):
        read_artifact(stored, "tracks")
    assert read_header(stored, "tracks") is None
    reseal(stored)
    with pytest.raises(DataError, match="dataset positions: is damaged"):
        read_artifact(stored, "tracks")


def test_key_of_a_missing_or_broken_file_is_none(stored):
    assert read_key(stored, "tracks") == "k"
    assert read_key(stored.with_name("none.h5"), "tracks") is None
    stored.write_bytes(b"no hdf5")
    assert read_key(stored, "tracks") is None


def test_objects_are_refused(stored):
    with edited(stored) as file:
        del file["contact"]
        file.create_dataset("contact", data=["text", "of", "any length"], dtype=h5py.string_dtype())
    with pytest.raises(DataError, match="type that is not allowed"):
        read_artifact(stored, "tracks")


def clouds(frames: int = 3, points: int = 10) -> dict[str, np.ndarray]:
    return {
        "points": np.zeros((points, 3), np.float32),
        "offsets": np.linspace(0, points, frames + 1).astype(np.int64),
        "end_effector": np.zeros((frames, 3), np.float32),
        "contact": np.zeros(frames, bool),
        "time": np.arange(frames, dtype=float),
    }


def frames(count: int = 2, cameras: int = 3) -> dict[str, np.ndarray]:
    images = count * cameras
    return {
        "color": np.zeros(4 * images, np.uint8),
        "color_offsets": np.arange(images + 1) * 4,
        "depth": np.zeros(2 * images, np.uint8),
        "depth_offsets": np.arange(images + 1) * 2,
        "time": np.arange(count, dtype=float),
        "source_frame": np.zeros((count, cameras), np.int64),
        "stamp": np.zeros((count, cameras)),
        "camera_name": np.array([b"a", b"b", b"c"], "S128")[:cameras],
        "image_size": np.ones((cameras, 2), np.int64),
        "K": np.zeros((cameras, 3, 3)),
        "distortion": np.zeros((cameras, 5)),
        "depth_scale": np.ones(cameras),
        "T_world_camera": np.tile(np.eye(4), (cameras, 1, 1)),
        "check_figure": np.zeros(1),
        "check_threshold": np.zeros(1),
        **{f"check_{name}": np.array([b"a"], "S128") for name in ("name", "unit", "verdict")},
        **{f"check_{name}": np.array([b"a"], "S512") for name in ("camera", "text", "cause", "remedy")},
    }


@pytest.mark.parametrize(
    ("name", "arrays", "changes", "message"),
    [
        ("clouds", clouds(), {"offsets": [0, 3, 6, 9]}, "dataset offsets: offsets into points do not rise from 0 to"),
        ("clouds", clouds(), {"offsets": [1, 3, 6, 10]}, "offsets into points"),
        ("clouds", clouds(), {"offsets": [0, 6, 3, 10]}, "offsets into points"),
        ("clouds", clouds(), {"offsets": [0, -6, 3, 10]}, "offsets into points"),
        ("clouds", clouds(), {"offsets": [0, 1 << 62, 3, 10]}, "offsets into points"),
        ("clouds", clouds(), {"offsets": [0, 3, 10]}, "axis frame"),
        ("clouds", clouds(), {"offsets": []}, "offsets: offsets into points|axis frame"),
        ("clouds", clouds(), {"points": np.float32(1)}, "offsets into points|shape"),
        ("clouds", clouds(), {"time": np.arange(4.0)}, "axis time|axis frame"),
        ("frames", frames(), {"color": np.zeros(23, np.uint8)}, "offsets into color do not rise"),
        ("frames", frames(), {"depth_offsets": [0, 2, 4, 6, 8, 6, 12]}, "offsets into depth do not rise"),
        ("frames", frames(), {"depth_offsets": [0, 2, 4, 6, 8, 12]}, "axis image_edge has length 6, expected 7"),
        (
            "frames",
            frames(),
            {"color_offsets": [0, 8, 16, 24], "depth_offsets": [0, 4, 8, 12]},
            "3 images, expected 2 frames of 3 cameras",
        ),
    ],
)
def test_offsets_that_contradict_what_they_cut_are_refused_by_writer_and_reader(
    tmp_path, name, arrays, changes, message
):
    path = tmp_path / "a.h5"
    rest = {"stage": "s", "stage_version": 1, "key": "k", "params": {}, "inputs": {}}
    changed = arrays | {k: np.asarray(v, arrays[k].dtype) for k, v in changes.items()}
    with pytest.raises(DataError, match=message):
        write_artifact(path, name, changed, **rest)
    write_artifact(path, name, arrays, **rest)
    read_artifact(path, name)
    with edited(path) as file:
        for dataset in changes:
            del file[dataset]
            file[dataset] = changed[dataset]
    with pytest.raises(DataError, match=message):
        read_artifact(path, name)


def test_offsets_are_checked_when_they_are_read_alone(tmp_path):
    path = tmp_path / "a.h5"
    write_artifact(path, "clouds", clouds(), stage="s", stage_version=1, key="k", params={}, inputs={})
    read_artifact(path, "clouds", ("offsets",))
    with edited(path) as file:
        file["offsets"][1] = 20
    with pytest.raises(DataError, match="do not rise from 0"):
        read_artifact(path, "clouds", ("offsets",))


def test_what_a_file_says_of_itself_and_what_it_holds(stored):
    artifact = read_artifact(stored)
    assert (artifact.name, artifact.path, artifact.inputs) == ("tracks", stored, {})
    field = artifact.field("time")
    assert (field.axes, field.units, field.dtype) == ("frame", "s", "float64")
    for absent in ("points", "color"):
        with pytest.raises(DataError, match=f"has no dataset {absent}"):
            artifact.field(absent)
    part = read_artifact(stored, "tracks", ("time",))
    assert list(part.arrays) == ["time"]
    with pytest.raises(DataError, match="has no dataset mode"):
        part.field("mode")
    with h5py.File(stored) as file:
        assert {name: file.attrs[name] for name in ("artifact", "stage", "stage_version", "schema_version")} == {
            "artifact": "tracks",
            "stage": "track",
            "stage_version": 1,
            "schema_version": SCHEMA_VERSION,
        }
        assert file.attrs["software"].startswith("piegraph ")


@pytest.mark.parametrize(("key", "value"), [("params", "{"), ("inputs", "{"), ("stage_version", "one"), ("key", 3)])
def test_a_header_that_is_damaged_is_none(stored, key, value):
    assert read_header(stored, "tracks") == Header("k", 1, '{"a": 1}', "q")
    assert read_header(stored, "masks") is None
    with edited(stored) as file:
        file.attrs[key] = value
    assert read_header(stored, "tracks") is None
    if key != "stage_version":
        with pytest.raises(DataError):
            read_artifact(stored, "tracks")


def test_text_is_kept_and_images_are_packed_lightly(tmp_path):
    path = tmp_path / "a.h5"
    of = frames(2, 2) | {"camera_name": np.array(["vorn", "links ü"]), "color": np.zeros(3 << 20, np.uint8)}
    of["color_offsets"] = np.array([0, 1, 2, 3, 3 << 20])
    write_artifact(path, "frames", of, stage="s", stage_version=1, key="k", params={}, inputs={})
    assert read_artifact(path).texts("camera_name") == ["vorn", "links ü"]
    with h5py.File(path) as file:
        assert (file["color"].chunks, file["color"].compression_opts) == ((CHUNK_BYTES,), 1)
        assert (file["depth"].compression_opts, file["time"].compression_opts) == (1, 4)
        assert all(file[name].shuffle and file[name].fletcher32 for name in ("color", "K", "time"))


def test_chunks_are_whole_rows_of_a_megabyte_at_most(tmp_path):
    path = tmp_path / "a.h5"
    many = tracks(40, 5000)
    write(path, many)
    with h5py.File(path) as file:
        assert file["positions"].chunks == (CHUNK_BYTES // (5000 * 12), 5000, 3)
        assert file["time"].chunks == (40,)
    one = {"points": np.zeros((0, 3), np.float32), "offsets": np.zeros(2, np.int64)}
    write_artifact(path, "clouds", clouds(1) | one, stage="s", stage_version=1, key="k", params={}, inputs={})
    with h5py.File(path) as file:
        assert file["points"].chunks is None
    assert read_artifact(path)["points"].shape == (0, 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": np.zeros((3, 4, 2))}, "axis xyz has length 2, expected 3"),
        ({"positions": np.zeros((3, 4))}, r"shape \(3, 4\), expected axes frame,particle,xyz"),
        ({"visibility": np.ones((3, 5))}, "axis particle has length 5, expected 4"),
        ({"time": np.array([0, np.nan, 1])}, r"time: value that is not finite at index \(1,\)"),
        ({"colour": np.zeros(3)}, "artifact tracks has no dataset colour"),
    ],
)
def test_arrays_that_do_not_fit_are_named(tmp_path, changes, message):
    path = tmp_path / "a.h5"
    with pytest.raises(DataError, match=message) as caught:
        write(path, tracks() | changes)
    assert str(path) in str(caught.value)
    assert not path.exists()
    write(path, tracks() | {"residual": np.full(3, np.nan), "mode": np.zeros(3), "contact": np.zeros(3, int)})
    read = read_artifact(path)
    assert np.isnan(read["residual"]).all()
    assert (read["mode"].dtype, read["contact"].dtype) == (np.uint8, bool)


def test_a_reader_refuses_another_type(stored):
    with edited(stored) as file:
        del file["time"]
        file["time"] = np.arange(3, dtype=np.float32)
    with pytest.raises(DataError, match="type float32, expected float64") as caught:
        read_artifact(stored, "tracks")
    assert caught.value.hint == "make it again: `piegraph track --force`"


def test_images_are_those_of_every_frame_and_camera(tmp_path):
    path = tmp_path / "a.h5"
    for count, cameras in ((2, 3), (3, 2), (1, 1), (4, 1)):
        of = frames(count, cameras)
        write_artifact(path, "frames", of, stage="s", stage_version=1, key="k", params={}, inputs={})
        assert len(read_artifact(path)["color_offsets"]) == count * cameras + 1
    with pytest.raises(DataError, match="6 images, expected 3 frames of 3 cameras"):
        of = frames(2, 3) | {"time": np.arange(3.0), "source_frame": np.zeros((3, 3), int), "stamp": np.zeros((3, 3))}
        write_artifact(path, "frames", of, stage="s", stage_version=1, key="k", params={}, inputs={})


def test_every_byte_counts(stored):
    whole = stored.read_bytes()
    for place in (0, 5, BLOCK - 1, BLOCK, BLOCK + 9, len(whole) // 2, len(whole) - 1):
        stored.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert read_header(stored, "tracks") is None
        with pytest.raises(DataError, match=r"checksum differs|no HDF5 signature"):
            read_artifact(stored, "tracks")
    for other in (whole + b"\0", whole[:-1], whole[BLOCK:], b"\n" * BLOCK + whole[BLOCK:], b""):
        stored.write_bytes(other)
        assert read_header(stored, "tracks") is None
    stored.write_bytes(whole)
    assert read_header(stored, "tracks").checked


def test_the_same_arrays_are_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(artifact, "datetime", mock.Mock(**{"datetime.now.return_value.isoformat.return_value": "now"}))
    for name in "ab":
        write(tmp_path / name, tracks())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_an_artifact_of_before_there_were_checksums_is_read_unchecked_and_no_other_is(stored):
    whole = stored.read_bytes()
    unsealed(stored, CHECKED_FROM - 1)
    assert read_header(stored, "tracks") == Header("k", 1, '{"a": 1}', "q", checked=False)
    assert not read_artifact(stored, "tracks").checked
    with h5py.File(stored, "a") as file:
        del file["contact"]
    assert read_header(stored, "tracks") is None, "its structure is looked at"
    stored.write_bytes(whole)
    unsealed(stored, SCHEMA_VERSION)
    assert read_header(stored, "tracks") is None
    with pytest.raises(DataError, match="lost its checksum"):
        read_artifact(stored, "tracks")
    stored.write_bytes(whole)
    with edited(stored) as file:
        file.attrs["schema_version"] = CHECKED_FROM - 1
    with pytest.raises(DataError, match="checksum that it cannot have"):
        read_artifact(stored, "tracks")


@pytest.mark.parametrize(
    ("dataset", "value", "message"),
    [
        ("positions", np.full((3, 4, 3), 100.5), r"100.5 at index \(0, 0, 0\), expected -100 to 100 m"),
        ("residual", np.array([0, 0, -1e-3]), r"-0.001 at index \(2,\), expected 0 to 100 m"),
        ("residual", np.array([0, np.inf, np.nan]), r"inf at index \(1,\)"),
        ("visibility", np.full((3, 4), 1.5), "1.5 at index"),
        ("mode", np.array([0, 2, 0]), "2 at index"),
        ("time", np.array([0.0, 1, 1]), "does not rise at index 2"),
        ("time", np.array([0, 1, 1e12]), "expected -1e"),
    ],
)
def test_values_that_cannot_be_are_refused_by_writer_and_reader(stored, dataset, value, message):
    with pytest.raises(DataError, match=message):
        write(stored.with_name("b.h5"), tracks() | {dataset: value})
    with edited(stored) as file:
        file[dataset][...] = value
    with pytest.raises(DataError, match=rf"dataset {dataset}: .*{message}"):
        read_artifact(stored, "tracks")
    read_artifact(stored, "tracks", ("contact",))


def test_flags_poses_and_texts_that_are_none_are_refused(tmp_path):
    path = tmp_path / "a.h5"
    rest = {"stage": "s", "stage_version": 1, "key": "k", "params": {}, "inputs": {}}
    turned = np.tile(np.eye(4), (3, 1, 1))
    turned[1, 0, 0] = -1
    with pytest.raises(DataError, match="no rotation and shift at index 1"):
        write_artifact(path, "frames", frames() | {"T_world_camera": turned}, **rest)
    with pytest.raises(DataError, match="no text at index 2"):
        write_artifact(path, "frames", frames() | {"camera_name": np.array([b"a", b"b", b"\xff"])}, **rest)
    with pytest.raises(DataError, match="longer than 128 bytes"):
        write_artifact(path, "frames", frames() | {"camera_name": np.array(["a", "b", "c" * 129])}, **rest)
    write_artifact(path, "frames", frames() | {"check_text": np.array(["a" * 511 + "ü"])}, **rest)
    assert read_artifact(path).texts("check_text") == ["a" * 511]
    with pytest.raises(DataError, match="neither true nor false"):
        write(path, tracks() | {"contact": np.full(3, 2, np.uint8).view(bool)})


def test_indices_stay_within_what_they_name(tmp_path):
    path, frames_of = tmp_path / "d.h5", 5
    data = {
        "positions": np.zeros((frames_of, 4, 3)),
        "seen": np.ones((frames_of, 4), bool),
        "end_effector": np.zeros((frames_of, 2)),
        "strokes": np.array([[0, 4]]),
        "stroke_sequence": np.zeros(1, int),
        "stroke_mode": np.zeros(1),
        "stroke_follows": np.zeros(1, bool),
        "pairs": np.array([[0, 2], [2, 4]]),
        "pair_stroke": np.zeros(2, int),
        "sequence_name": np.array(["s"]),
        "sequence_start": np.zeros(1, int),
        "sequence_split": np.zeros(1),
    }
    rest = {"stage": "s", "stage_version": 1, "key": "k", "params": {}, "inputs": {}}
    write_artifact(path, "dataset", data, **rest)
    for name, value in (("strokes", [[0, 5]]), ("pairs", [[0, 2], [-1, 4]]), ("pair_stroke", [0, 1])):
        with pytest.raises(DataError, match=f"dataset {name}: .* expected 0 to"):
            write_artifact(path, "dataset", data | {name: np.array(value)}, **rest)


def test_an_artifact_says_where_it_was_made_and_what_it_took(tmp_path):
    path = tmp_path / "model.h5"
    rest = {"stage": "train", "stage_version": 1, "key": "k", "params": {}, "inputs": {}}
    write_artifact(path, "checkpoint", {"state/a": np.zeros(2)}, **rest, spent={"wall_ms": 1500, "cpu_ms": 900})
    made = read_artifact(path, "checkpoint").made
    assert (made["wall_ms"], made["cpu_ms"], made["machine"]) == (1500, 900, machine())
    assert re.fullmatch(r".+, \d+ cores?", made["machine"])
    assert made["software"].startswith("piegraph ")
    write_artifact(path, "checkpoint", {"state/a": np.zeros(2)}, **rest)
    assert "wall_ms" not in read_artifact(path, "checkpoint").made
