"""Clouds from files of others: round trips, and every cut, lie and bomb refused by a message that names the file."""

import contextlib
import io
import os
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piegraph_cli.errors import DataError
from piegraph_cli.recording import points as module
from piegraph_cli.recording.points import Clouds, read_points, write_points

POINTS = np.random.default_rng(0).normal(size=(60, 3))
FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")
KINDS = {"float": "f4", "double": "f8", "uchar": "u1", "short": "i2", "uint": "u4", "int8": "i1", "float64": "f8"}
XYZ = tuple((axis, "float") for axis in "xyz")
FACES = "element face 2\nproperty list uchar int vertex_indices\n"


def ply(form, points, columns=XYZ, before="", after="", rows_before=b"", rows_after=b"", ends="\n", count=None):
    """The bytes of a PLY file, written with plain numpy: x, y, z from `points`, other columns all 7."""
    header = f"ply\nformat {form} 1.0\ncomment made in Zürich\nobj_info none\n{before}"
    header += f"element vertex {len(points) if count is None else count}\n"
    header += "".join(f"property {kind} {name}\n" for name, kind in columns) + f"{after}end_header\n"
    order = ">" if form == "binary_big_endian" else "<"
    table = np.full(len(points), 7, [(name, order + KINDS[kind]) for name, kind in columns])
    for axis, values in zip("xyz", points.T, strict=True):
        table[axis] = values
    text = "".join(" ".join(str(value) for value in row) + "\n" for row in table.tolist())
    body = text.encode() if form == "ascii" else table.tobytes()
    if form == "ascii":
        body, header = body.replace(b"\n", ends.encode()), header
    return header.replace("\n", ends).encode() + rows_before + body + rows_after


def stored(tmp_path, data, name="cloud.ply"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def read(path, frame=None):
    return read_points(path, frame, {})


def refused(path, message="."):
    with pytest.raises(DataError, match=message) as caught:
        read(path)
    assert str(path) in caught.value.where
    assert caught.value.hint
    return caught.value


LAYOUTS = {
    "plain": XYZ,
    "double": tuple((axis, "double") for axis in "xyz"),
    "normals and colours": (
        *XYZ,
        *((n, "double") for n in ("nx", "ny", "nz")),
        *((c, "uchar") for c in ("red", "green", "blue")),
    ),
    "colours first": (("red", "uchar"), ("label", "short"), *XYZ[::-1], ("id", "uint")),
    "mixed": (("x", "double"), ("s", "int8"), ("y", "float"), ("z", "float64")),
}


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_reads_back_equal_and_no_cut_passes(tmp_path, form, layout, ends):
    data = ply(form, POINTS, LAYOUTS[layout], ends=ends)
    found = read(stored(tmp_path, data))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, POINTS.astype(np.float32))
    cuts = {len(data) * share // 100 for share in (10, 50, 90, 99)} | {len(data) - lost for lost in range(1, 41)}
    cuts |= {0, 3, data.index(b"end_header") + 10 + len(ends)}
    for cut in sorted(cuts):
        refused(stored(tmp_path, data[:cut]), "cut off|no PLY|numbers each")


TEXT_FACES = b"3 0 1 2\n4 2 1 0 3\n"
BINARY_FACES = b"".join(bytes([n]) + np.arange(n, dtype="<i4").tobytes() for n in (3, 4))


@pytest.mark.parametrize(
    ("form", "rows"), [("ascii", TEXT_FACES), ("binary_little_endian", BINARY_FACES)], ids=["text", "binary"]
)
@pytest.mark.parametrize("first", [True, False])
def test_other_elements_are_measured_and_skipped(tmp_path, form, rows, first):
    place = {"before": FACES, "rows_before": rows} if first else {"after": FACES, "rows_after": rows}
    data = ply(form, POINTS, LAYOUTS["mixed"], **place)
    np.testing.assert_array_equal(read(stored(tmp_path, data)), POINTS.astype(np.float32))
    for lost in range(1, 41):
        refused(stored(tmp_path, data[:-lost]), "cut off|numbers each|does not fit")


@pytest.mark.parametrize("form", FORMATS)
def test_a_new_line_at_the_end_is_fine_and_more_is_refused(tmp_path, form):
    data = ply(form, POINTS)
    for end in (b"\n", b"\r\n"):
        np.testing.assert_array_equal(read(stored(tmp_path, data + end)), POINTS.astype(np.float32))
    for end in (b"0.1 0.2 0.3\n", b"\0", b"\n\n\0"):
        refused(stored(tmp_path, data + end), r"(bytes|lines) more|more lines|no end")
    changed = data.replace(b"element vertex 60", b"element vertex 59")
    refused(stored(tmp_path, changed), "more than its header|more lines than its header")


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("count", [61, 10**10, 10**18 - 1])
def test_more_promised_than_there_is_is_refused_before_anything_is_made(tmp_path, form, count):
    path = stored(tmp_path, ply(form, POINTS, count=count))
    tracemalloc.start()
    error = refused(path, "is cut off")
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()
    assert str(count) in error.message
    faces = FACES.replace("2", str(count)) if count > 61 else ""
    refused(stored(tmp_path, ply(form, POINTS, after=faces, count=count)), "is cut off")


HEAD = "ply\nformat ascii 1.0\n"
VERTEX = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("solid cube\n", "is no PLY file"),
        (HEAD + "comment end_header\n", "its header has no end"),
        (HEAD + "comment " + "x" * (1 << 16) + "\n" + VERTEX + "end_header\n1 2 3\n", "does not end within"),
        ("ply\n" + VERTEX + "end_header\n1 2 3\n", "no line format"),
        ("ply\nformat ascii 2.0\n" + VERTEX + "end_header\n1 2 3\n", "line 2 of its header"),
        (HEAD + HEAD[4:] + VERTEX + "end_header\n1 2 3\n", "line 3 of its header"),
        (HEAD + VERTEX.replace("1", "-1") + "end_header\n", "line 3 of its header .*'element vertex -1'"),
        (HEAD + VERTEX.replace("1", "1e3") + "end_header\n", "line 3 of its header"),
        (HEAD + VERTEX.replace("1", "²") + "end_header\n", "line 3 of its header"),
        (HEAD + VERTEX.replace("1", "9" * 5000) + "end_header\n", "line 3 of its header"),
        (HEAD + VERTEX + VERTEX + "end_header\n1 2 3\n1 2 3\n", "line 7 of its header"),
        (HEAD + VERTEX + "property float x\nend_header\n1 2 3 4\n", "line 7 of its header"),
        (HEAD + VERTEX + "property half w\nend_header\n1 2 3 4\n", "line 7 of its header"),
        (HEAD + "property float x\n" + VERTEX + "end_header\n1 2 3\n", "line 3 of its header"),
        (HEAD + VERTEX + "element face 1\nproperty list float int i\nend_header\n1 2 3\n1 1\n", "line 8 of its header"),
        (
            HEAD + VERTEX + "element face 1\nproperty list uchar int i\nend_header\n1 2 3\n3 0 1\n",
            "row 0 of face does not fit",
        ),
        (
            HEAD + VERTEX + "element face 1\nproperty list uchar int i\nend_header\n1 2 3\n2 0 1 2\n",
            "row 0 of face does not fit",
        ),
        (
            HEAD + VERTEX + "element face 1\nproperty list uchar int i\nend_header\n1 2 3\n-1 0\n",
            "row 0 of face does not fit",
        ),
        (HEAD + VERTEX + "element nothing 1000000000\nend_header\n1 2 3\n", "names no property of nothing"),
        (HEAD + "element face 0\nproperty list uchar int i\nend_header\n", "no element vertex"),
        (HEAD + VERTEX + "property list uchar int i\nend_header\n1 2 3 0\n", "list properties"),
        (HEAD + VERTEX.replace("float z", "float w") + "end_header\n1 2 3\n", "no z of type float or double"),
        (HEAD + VERTEX.replace("float y", "int y") + "end_header\n1 2 3\n", "no y of type float or double"),
        (HEAD + VERTEX + "end_header\n1 2\n5\n", "vertices cannot be read|more lines|numbers each"),
        (HEAD + VERTEX + "end_header\n1 2 3 4\n", "4 numbers each, 3 by its header"),
        (HEAD + VERTEX + "end_header\n1 2 three\n", "vertices cannot be read"),
        (HEAD + VERTEX + "end_header\n1 2 nan\n", "none of its 1 points is finite"),
        (HEAD + VERTEX + "end_header\n1 2 1e300\n", "none of its 1 points is finite"),
        (HEAD + VERTEX + "end_header\n" + " " * 30 + "\n", "is cut off: its header says 1 of vertex, it has 0"),
        (HEAD + "element vertex 0\nend_header\n", "holds no finite points"),
    ],
)
def test_headers_and_rows_that_lie_are_refused(tmp_path, text, message):
    refused(stored(tmp_path, text.encode()), message)


def test_binary_lists_of_negative_length_are_refused(tmp_path):
    faces = FACES.replace("uchar", "char").replace("2", "1")
    data = ply("binary_little_endian", POINTS, after=faces, rows_after=b"\xff" * 9)
    refused(stored(tmp_path, data), "list of face 0 has the length -1")


def test_points_that_are_not_finite_are_left_out_and_counted(tmp_path, caplog):
    """As organised clouds have them, where the camera saw nothing."""
    points = POINTS.copy()
    points[3, 1], points[5] = np.nan, np.inf
    path = stored(tmp_path, ply("binary_little_endian", points))
    np.testing.assert_array_equal(read_points(path, None, {}), np.delete(points, [3, 5], 0).astype(np.float32))
    assert f"{path}, frame 0: 2 of 60 points are not finite: left out" in caplog.text


def test_only_regular_files_of_bounded_size_are_read(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe.ply")
    refused(tmp_path / "pipe.ply", "not a regular file")
    (tmp_path / "folder.npz").mkdir()
    refused(tmp_path / "folder.npz", "not a regular file")
    refused(tmp_path / "none.ply", "no such file")
    refused(stored(tmp_path, b"", "words.txt"), "cannot read clouds from .txt")
    for name in ("large.ply", "large.npz"):
        with open(tmp_path / name, "wb") as file:
            file.truncate(module.MAX_BYTES + 1)
        refused(tmp_path / name, "bytes, clouds of at most")


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("rich", [True, False])
def test_what_open3d_and_trimesh_write_reads_back_equal(tmp_path, text, rich):
    import open3d as o3d
    import trimesh

    path = tmp_path / "cloud.ply"
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
    if rich:
        cloud.colors = o3d.utility.Vector3dVector(np.full_like(POINTS, 0.5))
        cloud.normals = o3d.utility.Vector3dVector(POINTS)
    o3d.io.write_point_cloud(str(path), cloud, write_ascii=text)
    np.testing.assert_array_equal(read(path), np.asarray(o3d.io.read_point_cloud(str(path)).points, np.float32))
    np.testing.assert_allclose(read(path), POINTS, rtol=1e-5, atol=1e-6)
    written = trimesh.PointCloud(POINTS, colors=np.full((60, 4), 9, np.uint8) if rich else None)
    written.export(path, encoding="ascii" if text else "binary")
    np.testing.assert_allclose(read(path), POINTS, rtol=1e-6, atol=1e-8)
    box = trimesh.creation.box()
    box.export(path, encoding="ascii" if text else "binary")
    np.testing.assert_array_equal(read(path), box.vertices.astype(np.float32))


finite = st.floats(-1e6, 1e6, width=32)
rows = st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=8)
extra = st.lists(st.sampled_from([*KINDS]), max_size=3)
shared = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@shared
@given(rows, extra, st.integers(0, 3), st.sampled_from(FORMATS), st.sampled_from(["float", "double"]), st.data())
def test_reading_is_the_inverse_of_writing_and_any_cut_is_refused(tmp_path, rows, extra, shift, form, kind, data):
    columns = [(f"extra{i}", other) for i, other in enumerate(extra)]
    for i, axis in enumerate("xyz"):
        columns.insert(min(len(columns), shift * i), (axis, kind))
    points = np.array(rows)
    written = ply(form, points, columns)
    np.testing.assert_array_equal(read(stored(tmp_path, written)), points.astype(np.float32))
    refused(stored(tmp_path, written[: data.draw(st.integers(0, len(written) - 1))]))


@shared
@given(st.binary(max_size=80), st.sampled_from(FORMATS), st.integers(0, 400))
def test_no_bytes_end_in_anything_but_points_or_a_message(tmp_path, noise, form, place):
    written = ply(form, POINTS[:9], LAYOUTS["colours first"], after=FACES, rows_after=BINARY_FACES)
    archive = io.BytesIO()
    np.savez_compressed(archive, points=POINTS[:9], offsets=[0, 4, 9], time=[0.0, 1.0])
    for data, name in ((written, "cloud.ply"), (archive.getvalue(), "cloud.npz")):
        broken = data[:place] + noise + data[place + len(noise) :]
        path = stored(tmp_path, broken, name)
        with contextlib.suppress(DataError):
            assert np.isfinite(read(path)).all()


def archive(path, members, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, data in members:
            file.writestr(name, data)
    return path


def npy(array, shape=None, descr=None, fortran=False, version=(1, 0)):
    """The bytes of a .npy file whose header may say something else than what follows."""
    file = io.BytesIO()
    header = {"descr": descr or array.dtype.str, "fortran_order": fortran, "shape": shape or array.shape}
    write = {(1, 0): np.lib.format.write_array_header_1_0, (2, 0): np.lib.format.write_array_header_2_0}[version]
    write(file, header)
    return file.getvalue() + array.tobytes()


FRAMES = np.arange(30.0).reshape(2, 5, 3)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_of_npz_files_read_back_equal(tmp_path, save):
    path = tmp_path / "cloud.npz"
    for array in (POINTS, np.asfortranarray(POINTS), POINTS.astype(">f4"), np.arange(12).reshape(4, 3)):
        save(path, array, normals=array, time=0.0)
        np.testing.assert_array_equal(read(path), array.astype(np.float32))
    save(path, positions=FRAMES, time=[0.0, 0.1], words="beside")
    np.testing.assert_array_equal(read(path), FRAMES[1])
    np.testing.assert_array_equal(read(path, 0), FRAMES[0])
    np.testing.assert_array_equal(read(path, -2), FRAMES[0])
    with pytest.raises(DataError, match="has 2 frames, no frame 2"):
        read(path, 2)
    save(path, points=POINTS, offsets=[0, 10, 10, 60])
    np.testing.assert_array_equal(read(path), POINTS[10:].astype(np.float32))
    np.testing.assert_array_equal(read(path, 0), POINTS[:10].astype(np.float32))
    with pytest.raises(DataError, match="holds no finite points"):
        read(path, 1)
    data = path.read_bytes()
    for lost in [*range(1, 60), len(data) // 2, len(data) - 1]:
        refused(stored(tmp_path, data[:-lost], "cut.npz"), "not a readable .npz file")
    place = data.index(b"points.npy") + (300 if save is np.savez else 100)
    refused(stored(tmp_path, data[:place] + bytes([data[place] ^ 8]) + data[place + 1 :], "flip.npz"), "not a readable")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"points": POINTS, "offsets": [0, 10, 59]}, "offsets must rise from 0 to the 60 points"),
        ({"points": POINTS, "offsets": [1, 60]}, "offsets must rise"),
        ({"points": POINTS, "offsets": [0, 50, 40, 60]}, "offsets must rise"),
        ({"points": POINTS, "offsets": np.array([0, 50, 40, 60], np.uint64)}, "offsets must rise"),
        ({"points": POINTS, "offsets": [0.0, 60.0]}, "offsets must be integers"),
        ({"points": POINTS, "offsets": [[0, 60]]}, "offsets must be integers"),
        ({"points": POINTS, "offsets": [0]}, "offsets must be integers"),
        ({"positions": FRAMES, "offsets": [0, 1, 2]}, "offsets must be integers"),
        ({"positions": FRAMES, "time": [0.0, 0.1, 0.2]}, r"array time \[3\] contradicts the points \[2, 5, 3\]"),
        ({"positions": FRAMES, "visibility": np.ones((3, 5))}, "array visibility"),
        ({"points": POINTS, "offsets": [0, 10, 60], "time": [0.0]}, "array time"),
        ({"points": POINTS, "colors": np.zeros((59, 3))}, "array colors"),
        ({"time": [0.0, 0.1]}, r"its array time is float64 \[2\], not points"),
        ({"points": POINTS[:, :2]}, "not points"),
        ({"points": POINTS + 0j}, "not points"),
        ({"points": POINTS.astype("U8")}, "not points"),
        ({"points": np.zeros((0, 3))}, "holds no finite points"),
        ({"points": np.zeros((0, 5, 3))}, "has 0 frames"),
        ({"points": np.array([[None] * 3])}, "holds Python objects"),
        ({"points": POINTS, "note": np.array({"a": 1})}, "note holds Python objects"),
        ({}, "holds no array"),
    ],
)
def test_arrays_that_contradict_each_other_or_are_no_points_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "cloud.npz", **arrays)
    refused(tmp_path / "cloud.npz", message)


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ([("points.npy", npy(POINTS, (10**10, 3)))], "needs .* bytes, it has"),
        ([("points.npy", npy(POINTS, (59, 3)))], "needs .* bytes, it has"),
        ([("points.npy", npy(POINTS, (-60, -3)))], "needs .* bytes, it has|not a readable"),
        ([("points.npy", npy(POINTS) + b"\0")], "needs .* bytes, it has"),
        ([("points.npy", npy(POINTS)), ("time.npy", npy(POINTS, (7,)))], "array time of .* needs"),
        ([("points.npy", npy(POINTS)[:60])], "not a readable"),
        ([("points.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(1 << 20))], "not a readable"),
        ([("points.npy", b"\x93NUMPY\x03\x00" + npy(POINTS, version=(2, 0))[8:])], "unknown version"),
        ([("points.npy", b"points")], "not a readable"),
        ([("points.txt", b"1 2 3")], "as no array"),
        ([("points.npy", npy(POINTS)), ("points.npy", npy(POINTS))], "twice"),
        ([("points.npy", npy(np.zeros(0), (10**12, 0, 3)))], "holds no finite points"),
        ([("points.npy", npy(np.zeros(0), (10**10, 3), "|V0"))], "not points|not a readable"),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_npz_headers_that_lie_are_refused_and_cost_nothing(tmp_path, members, message):
    path = archive(tmp_path / "cloud.npz", members)
    tracemalloc.start()
    refused(path, message)
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()


def test_npz_bombs_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, file.open("points.npy", "w") as member:
        member.write(npy(np.zeros(0), (100_000_000, 3)))
        for _ in range(16):
            member.write(bytes(4 << 20))
    refused(path, "needs .* bytes, it has")
    monkeypatch.setattr(module, "MAX_BYTES", 4 << 20)
    tracemalloc.start()
    refused(path, "unpacks to [0-9]+ bytes")
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()
    refused(archive(tmp_path / "lzma.npz", [("points.npy", npy(POINTS))], zipfile.ZIP_LZMA), "unknown way")


def test_clouds_of_several_frames_are_cut_on_demand():
    clouds = Clouds(POINTS, np.array([0, 20, 60]))
    assert len(clouds) == 2
    np.testing.assert_array_equal(clouds[-2], POINTS[:20])
    np.testing.assert_array_equal(clouds[1], POINTS[20:])


def test_a_further_kind_is_read_by_its_reader(tmp_path):
    path = stored(tmp_path, b"", "cloud.h5")
    np.testing.assert_array_equal(read_points(path, 0, {".h5": lambda path: FRAMES}), FRAMES[0])
    with pytest.raises(DataError, match=r"use \.ply, \.npz, \.h5"):
        read_points(stored(tmp_path, b"", "cloud.xyz"), 0, {".h5": lambda path: FRAMES})


def test_an_array_of_an_npz_may_be_named(tmp_path):
    path = tmp_path / "all.npz"
    np.savez(path, one=FRAMES[0], name=np.zeros(3), more=np.stack([FRAMES[0], FRAMES[0] + 1]))
    np.testing.assert_array_equal(read_points(path, None, {}, "one"), FRAMES[0])
    np.testing.assert_array_equal(read_points(path, 1, {}, "more"), FRAMES[0] + 1)
    for key, message in (("name", r"its array name is float64 \[3\], not points"), ("none", "has no array none")):
        with pytest.raises(DataError, match=message):
            read_points(path, None, {}, key)


@pytest.mark.parametrize(
    "beside",
    [
        {"colors": np.random.default_rng(0).random((5, 3)), "points": FRAMES[0]},
        {"normals": np.ones((5, 3)), "xyz": FRAMES[0]},
        {"faces": np.zeros((9, 3), np.int32), "Vertices": FRAMES[0]},
        {"R": np.eye(3), "cloud": FRAMES[0]},
        {"time": np.zeros(2), "anything": FRAMES[0]},
        {"rgb": np.zeros((5, 3)), "anything": FRAMES[0]},
    ],
)
def test_of_several_arrays_the_points_are_read(tmp_path, beside):
    np.savez(tmp_path / "all.npz", **beside)
    np.testing.assert_array_equal(read_points(tmp_path / "all.npz", None, {}), FRAMES[0])


@pytest.mark.parametrize(
    "arrays",
    [
        {"R": np.eye(3), "goal": FRAMES[0]},
        {"arr_0": FRAMES[0], "arr_1": FRAMES[1]},
        {"points": FRAMES[0], "vertices": FRAMES[1]},
    ],
)
def test_which_of_several_arrays_is_meant_is_asked(tmp_path, arrays):
    np.savez(tmp_path / "all.npz", **arrays)
    with pytest.raises(DataError, match=f"which of its arrays are the points: {', '.join(arrays)}") as told:
        read_points(tmp_path / "all.npz", None, {})
    assert "FILE:KEY" in str(told.value)


def test_pixels_without_depth_and_what_git_lfs_left_are_told(tmp_path, caplog):
    points = np.random.default_rng(0).uniform(0.1, 0.2, (100, 3)).astype(np.float32)
    path = tmp_path / "cloud.PLY"
    write_points(tmp_path / "cloud.ply", np.concatenate([points, np.zeros((40, 3), np.float32)]))
    (tmp_path / "cloud.ply").rename(path)
    np.testing.assert_array_equal(read_points(path, None, {}), points)
    assert "40 of 140 points are 0, 0, 0" in caplog.text
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(DataError, match="pointer of Git LFS"):
        read_points(path, None, {})


def picture(rows=120, columns=160):
    """Points [H, W, 3] (m) of the pixels of a camera that looks down on a box."""
    row, column = np.mgrid[:rows, :columns]
    depth = np.where((row > 20) & (row < 60) & (column > 30) & (column < 60), 0.75, 0.8)
    return np.stack([(column - 80) * depth / 150, (60 - row) * depth / 150, 0.8 - depth], -1)


@pytest.mark.parametrize("nothing", [None, np.nan, 0.0])
def test_a_point_per_pixel_is_one_cloud(tmp_path, nothing, caplog):
    points = picture()
    if nothing is not None:
        points[points[..., 2] < 0.01] = nothing
    np.savez(tmp_path / "image.npz", points)
    found = read(tmp_path / "image.npz")
    assert len(found) == (120 * 160 if nothing is None else 39 * 29)
    assert "taken for one organised cloud" in caplog.text
    assert len(read(tmp_path / "image.npz", 30)) == (160 if nothing is None else 29), "a frame that is named is one"


def test_frames_of_particles_are_no_image(tmp_path, caplog):
    rope = np.stack([np.linspace(0, 0.4, 50), np.zeros(50), np.zeros(50)], 1)
    pushed = rope + np.linspace(0, 0.08, 40)[:, None, None] * [0.0, 1, 0]
    lost = pushed.copy()
    lost[10:13] = np.nan
    for frames in (pushed, lost, np.random.default_rng(0).normal(0, 0.1, (40, 50, 3))):
        np.savez(tmp_path / "frames.npz", frames)
        assert len(read(tmp_path / "frames.npz")) == 50
    assert not caplog.records


def test_a_picture_is_no_cloud(tmp_path):
    np.savez(tmp_path / "colors.npz", np.zeros((60, 80, 3), np.uint8))
    refused(tmp_path / "colors.npz", "uint8")
