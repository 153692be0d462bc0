"""Layouts of others: the same push written in each of them is read as the same, and what is wrong is named."""

import shutil

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.errors import DataError
from piegraph_cli.recording.folders import SIGNS, layout_of, list_sequences
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.recording.params import LAYOUT_HELP, IngestParams
from piegraph_cli.recording.readers import read_films
from piegraph_cli.recording.sequence import read_sequence
from tests.cli import piegraph_json
from tests.perception.scene import ring_camera
from tests.stages.make_recording import make_recording

CAMERAS = [ring_camera(0.4, "camera_0", 64, 48), ring_camera(2.5, "camera_1", 64, 48)]
FRAMES = 12


def images(frame: int, camera: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([frame, camera])
    return rng.integers(0, 255, (48, 64, 3), np.uint8), rng.integers(500, 900, (48, 64)).astype(np.uint16)


def write_gbnd(folder):
    """Two cameras; their world has z down."""
    for c, camera in enumerate(CAMERAS):
        place = folder / "episode" / f"camera_{c}"
        (place / "seg").mkdir(parents=True)
        for f in range(FRAMES):
            color, depth = images(f, c)
            cv2.imwrite(str(place / f"{f:06d}.png"), color[:, :, ::-1])
            cv2.imwrite(str(place / f"{f:06d}_depth.png"), depth)
            cv2.imwrite(str(place / "seg" / f"seg_{f:06d}.png"), depth)
        np.save(place / "camera_params.npy", camera.K[[0, 1, 0, 1], [0, 1, 2, 2]])
        down = np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.T_world_camera
        np.save(place / "camera_extrinsics.npy", np.linalg.inv(down))
    return folder / "episode"


def write_tum(folder):
    """One camera; depth is 7 ms later, in a five-thousandth of a metre, and lacks its third image."""
    place = folder / "rgbd_dataset_freiburg3_push"
    for kind in ("rgb", "depth"):
        (place / kind).mkdir(parents=True)
    lists, poses = {"rgb": "# color images\n", "depth": "# depth\n"}, "# time tx ty tz qx qy qz qw\n"
    quaternion = Rotation.from_matrix(CAMERAS[0].T_world_camera[:3, :3]).as_quat()
    for f in range(FRAMES):
        color, depth = images(f, 0)
        time = 1305031102.1 + f / 5
        for kind, image, late in (("rgb", color[:, :, ::-1], 0), ("depth", depth * 5, 0.007)):
            name = f"{kind}/{time + late:.6f}.png"
            if (kind, f) != ("depth", 2):
                cv2.imwrite(str(place / name), image)
                lists[kind] += f"{time + late:.6f} {name}\n"
        poses += " ".join(map(str, [time, *CAMERAS[0].T_world_camera[:3, 3], *quaternion])) + "\n"
    for kind, text in lists.items():
        (place / f"{kind}.txt").write_text(text)
    (place / "groundtruth.txt").write_text(poses)
    return place


def test_the_tables_of_layouts_agree():
    assert list(SIGNS) == list(LAYOUT_HELP)
    assert list(piegraph_json("list", "layouts")["layouts"]) == list(SIGNS)


@pytest.mark.parametrize("write", [write_gbnd, write_tum])
def test_a_recording_of_others_is_told_by_its_folders(tmp_path, write):
    sequence = write(tmp_path)
    name = write.__name__.removeprefix("write_")
    assert list_sequences(tmp_path) == [sequence]
    assert layout_of(sequence) == name
    with pytest.raises(DataError, match="no sequence found in the layout piegraph"):
        list_sequences(tmp_path, "piegraph")
    with pytest.raises(DataError, match="one sequence, not a recording") as refused:
        list_sequences(sequence)
    assert str(tmp_path) in refused.value.hint
    told = piegraph_json("ingest", "--run", tmp_path / "run", "--recording", tmp_path, "--layout", name)
    assert [(o["unit"], o["state"]) for o in told["outcomes"]] == [(sequence.name, "done")]


def test_our_layout_is_told_first(tmp_path):
    recording = make_recording(tmp_path / "rec")
    assert {layout_of(sequence) for sequence in list_sequences(recording)} == {"piegraph"}


def test_gbnd(tmp_path):
    arrays, warnings = read_sequence(write_gbnd(tmp_path), IngestParams(fps=30))
    assert [name.item() for name in arrays["camera_name"]] == ["camera_0", "camera_1"]
    for c, camera in enumerate(CAMERAS):
        np.testing.assert_allclose(arrays["T_world_camera"][c], camera.T_world_camera, atol=1e-12)
        np.testing.assert_allclose(arrays["K"][c], camera.K)
    np.testing.assert_allclose(arrays["time"], np.arange(FRAMES) / 30)
    color, depth = images(3, 1)
    stacks = [ImageStack(arrays[k], arrays[f"{k}_offsets"], 2, k) for k in ("color", "depth")]
    np.testing.assert_array_equal(stacks[0].color(3, 1), color)
    np.testing.assert_array_equal(stacks[1].depth(3, 1), depth)
    assert any("30 frames a second" in text for text in warnings)
    assert any("turned about x" in text for text in warnings)


def test_tum(tmp_path):
    arrays, warnings = read_sequence(write_tum(tmp_path), IngestParams())
    kept = [0, 1, *range(3, FRAMES)]
    np.testing.assert_allclose(arrays["T_world_camera"][0], CAMERAS[0].T_world_camera, atol=1e-4)
    np.testing.assert_allclose(arrays["K"][0], [[535.4, 0, 320.1], [0, 539.2, 247.6], [0, 0, 1]])
    np.testing.assert_allclose(arrays["time"], np.array(kept) / 5, atol=1e-5)
    depth = ImageStack(arrays["depth"], arrays["depth_offsets"], 1, "depth")
    np.testing.assert_allclose(depth.depth(2, 0) * arrays["depth_scale"][0], images(3, 0)[1] * 5 / 5000)
    assert "1 colour images without a depth image" in " ".join(warnings)


def test_intrinsics_of_tum_from_a_file_or_nowhere(tmp_path):
    place = write_tum(tmp_path)
    other = place.rename(place.parent / "mine")
    with pytest.raises(DataError, match="intrinsics are missing"):
        read_films(other, "tum")
    (other / "calibration.txt").write_text("60 61 32 24 0.1 -0.2 0 0\n")
    camera = read_films(other, "tum")[0][0].camera
    np.testing.assert_allclose(camera.K, [[60, 0, 32], [0, 61, 24], [0, 0, 1]])
    np.testing.assert_allclose(camera.distortion, [0.1, -0.2, 0, 0, 0])


def moved(place):
    lines = (place / "groundtruth.txt").read_text().splitlines()
    words = lines[-1].split()
    words[1] = str(float(words[1]) + 0.05)
    (place / "groundtruth.txt").write_text("\n".join([*lines[:-1], " ".join(words)]))


def write(name, text):
    def change(place):
        (place / name).write_text(text)

    change.__name__ = name
    return change


def late_depth(place):
    lines = (place / "depth.txt").read_text().splitlines()[1:]
    late = [f"{float(line.split()[0]) + 0.06} {line.split()[1]}" for line in lines]
    (place / "depth.txt").write_text("\n".join(late))


@pytest.mark.parametrize(
    ("breaks", "message"),
    [
        (moved, "the camera moves by 50 mm"),
        (late_depth, "0 of 12 colour images have a depth image"),
        (write("rgb.txt", "1.0 ../../secret.png\n"), "image secret.png is not in the sequence"),
        (write("rgb.txt", "1.0 rgb/none.png\n"), "image none.png is not in the sequence"),
        (write("rgb.txt", "rgb/1.png\n"), "lines must be: time file"),
        (write("depth.txt", ""), "lines must be: time file"),
        (write("groundtruth.txt", "1 2 3\n"), "lines must be 8 numbers"),
        (write("groundtruth.txt", "1 0 0 0 0 0 0 1\n"), "no pose at the time"),
        (write("calibration.txt", "60 60 32\n"), "must hold fx fy cx cy"),
        (lambda place: shutil.rmtree(place / "depth"), "is not in the sequence"),
        (lambda place: (place / "groundtruth.txt").unlink(), "groundtruth.txt: cannot be read"),
    ],
)
def test_what_is_wrong_with_a_tum_recording_is_named(tmp_path, breaks, message):
    place = write_tum(tmp_path)
    breaks(place)
    with pytest.raises(DataError) as refused:
        read_films(place, "tum")
    assert message in str(refused.value)
    assert str(place) in str(refused.value)


class Malicious:
    def __reduce__(self):
        return print, ("code of others runs",)


def pickled(place):
    np.save(place / "camera_params.npy", np.array([Malicious()], object), allow_pickle=True)


@pytest.mark.parametrize(
    ("breaks", "message"),
    [
        (pickled, "camera_params.npy: cannot be read"),
        (lambda c: (c / "camera_params.npy").write_bytes(b""), "camera_params.npy: cannot be read"),
        (lambda c: (c / "camera_params.npy").write_bytes(b"\0" * 70000), "too large"),
        (lambda c: np.save(c / "camera_params.npy", np.ones(3)), "holds an array (3,)"),
        (lambda c: np.save(c / "camera_params.npy", np.array([-1.0, 1, 1, 1])), "focal lengths must be positive"),
        (lambda c: np.save(c / "camera_extrinsics.npy", np.ones((4, 4))), "the pose"),
        (lambda c: (c / "camera_extrinsics.npy").unlink(), "camera_extrinsics.npy: cannot be read"),
        (lambda c: (c / "000002_depth.png").unlink(), "first unpaired 000002.png"),
        (lambda c: (c / "000000.png").write_bytes(b"no"), "image of camera camera_0, frame 000000 cannot be decoded"),
    ],
)
def test_what_is_wrong_with_a_gbnd_recording_is_named(tmp_path, breaks, message, capsys):
    place = write_gbnd(tmp_path)
    breaks(place / "camera_0")
    with pytest.raises(DataError) as refused:
        read_films(place, "gbnd")
    assert message in str(refused.value)
    assert "camera_0" in str(refused.value)
    assert "code of others" not in capsys.readouterr().out
