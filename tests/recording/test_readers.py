"""Layouts of others: the same push written in each of them is read as the same, and what is wrong is named."""

import json
import pickle
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.errors import DataError
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.recording.folders import SIGNS, layout_of, list_sequences
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.recording.layout import write_cameras
from piegraph_cli.recording.params import LAYOUT_HELP, ReadParams
from piegraph_cli.recording.plain import load_pickle
from piegraph_cli.recording.readers import read_films
from piegraph_cli.recording.sequence import read_sequence
from piegraph_cli.stages import segment
from piegraph_cli.workspace.artifact import Artifact
from tests.cli import piegraph, piegraph_json
from tests.perception.scene import ring_camera
from tests.stages.make_recording import make_recording

CAMERAS = [ring_camera(0.4, "camera_0", 64, 48), ring_camera(2.5, "camera_1", 64, 48)]
FRAMES = 12
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns a world with z up into one with z down, and back."""


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
        np.save(place / "camera_extrinsics.npy", np.linalg.inv(DOWN @ camera.T_world_camera))
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


def write_phystwin(folder, video=False, raw=True):
    """Two cameras whose world has z down; unpadded steps, the third camera time missing nothing."""
    place = folder / "double_lift"
    recording = {}
    for c in range(2):
        for kind in ("color", "depth"):
            (place / kind / str(c)).mkdir(parents=True)
        recording[str(c)] = {}
        for f in range(FRAMES):
            color, depth = images(f, c)
            cv2.imwrite(str(place / "color" / str(c) / f"{f}.png"), color[:, :, ::-1])
            np.save(place / "depth" / str(c) / f"{f}.npy", depth)
            recording[str(c)][str(f)] = 1700000000.0 + f / 5 + 0.004 * c
    about = {"intrinsics": [c.K.tolist() for c in CAMERAS], "WH": [64, 48], "fps": 30, "serial_numbers": ["a", "b"]}
    about |= {"recording": recording} if raw else {"frame_num": FRAMES}
    (place / "metadata.json").write_text(json.dumps(about))
    (place / "calibrate.pkl").write_bytes(pickle.dumps([DOWN @ camera.T_world_camera for camera in CAMERAS]))
    return place


def write_pgnd(folder):
    """Two cameras whose world has z down, calibrated for all sequences of the folder, and a robot."""
    place = folder / "1700000000.0"
    for c in range(2):
        for kind in ("rgb", "depth"):
            (place / f"camera_{c}" / kind).mkdir(parents=True)
    lines = []
    (place / "robot").mkdir()
    for f in range(FRAMES):
        for c in range(2):
            color, depth = images(f, c)
            cv2.imwrite(str(place / f"camera_{c}" / "rgb" / f"{f:06d}.jpg"), color[:, :, ::-1])
            cv2.imwrite(str(place / f"camera_{c}" / "depth" / f"{f:06d}.png"), depth)
        time = 1700000000 + f / 5
        lines.append(f"{f} {f} {f / 5} {f / 5 + 0.003} {time} {time + 0.003}")
        pose = np.vstack([[0.1, -0.2 + 0.01 * f, -0.3], np.diag([1.0, -1, -1])])
        rows = [" ".join(map(str, row)) for row in pose] + ["0.05"]
        (place / "robot" / f"{time:.3f}.txt").write_text("\n".join(rows))
    (place / "timestamps.txt").write_text("\n".join(lines) + "\n")
    (folder / "calibration").mkdir()
    poses = [np.linalg.inv(DOWN @ camera.T_world_camera) for camera in CAMERAS]
    np.save(folder / "calibration" / "intrinsics.npy", np.stack([camera.K for camera in CAMERAS]))
    np.save(folder / "calibration" / "rvecs.npy", Rotation.from_matrix([T[:3, :3] for T in poses]).as_rotvec())
    np.save(folder / "calibration" / "tvecs.npy", np.stack([T[:3, 3:] for T in poses]))
    return place


def test_the_tables_of_layouts_agree():
    assert list(SIGNS) == list(LAYOUT_HELP)
    assert list(piegraph_json("list", "layouts")["layouts"]) == list(SIGNS)


@pytest.mark.parametrize("write", [write_gbnd, write_tum, write_phystwin, write_pgnd])
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
    noise = ("--accept", "table,clouds,edges,outlines")  # in depth too: there is no table
    told = piegraph_json("ingest", "--run", tmp_path / "run", "--recording", tmp_path, *noise)
    assert [(o["unit"], o["state"]) for o in told["outcomes"]] == [(sequence.name, "done")]


def test_our_layout_is_told_first(tmp_path):
    recording = make_recording(tmp_path / "rec")
    assert {layout_of(sequence) for sequence in list_sequences(recording)} == {"piegraph"}


def test_gbnd(tmp_path):
    arrays, warnings = read_sequence(write_gbnd(tmp_path), ReadParams(fps=30))
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
    arrays, warnings = read_sequence(write_tum(tmp_path), ReadParams())
    kept = [0, 1, *range(3, FRAMES)]
    np.testing.assert_allclose(arrays["T_world_camera"][0], CAMERAS[0].T_world_camera, atol=1e-4)
    np.testing.assert_allclose(arrays["K"][0], [[535.4, 0, 320.1], [0, 539.2, 247.6], [0, 0, 1]])
    np.testing.assert_allclose(arrays["time"], np.array(kept) / 5, atol=1e-5)
    depth = ImageStack(arrays["depth"], arrays["depth_offsets"], 1, "depth")
    np.testing.assert_allclose(depth.depth(2, 0) * arrays["depth_scale"][0], images(3, 0)[1] * 5 / 5000)
    assert "1 colour images without a depth image" in " ".join(warnings)


def check_images(arrays, frame, source, jpeg=False):
    stacks = [ImageStack(arrays[k], arrays[f"{k}_offsets"], 2, k) for k in ("color", "depth")]
    color, depth = images(source, 1)
    np.testing.assert_array_equal(stacks[1].depth(frame, 1), depth)
    if not jpeg:
        np.testing.assert_array_equal(stacks[0].color(frame, 1), color)


def check_cameras(arrays, names):
    assert [name.item() for name in arrays["camera_name"]] == names
    for c, camera in enumerate(CAMERAS):
        np.testing.assert_allclose(arrays["T_world_camera"][c], camera.T_world_camera, atol=1e-5)
        np.testing.assert_allclose(arrays["K"][c], camera.K)


def test_phystwin(tmp_path):
    arrays, warnings = read_sequence(write_phystwin(tmp_path), ReadParams())
    check_cameras(arrays, ["0", "1"])
    check_images(arrays, 10, 10)  # by number: 10 comes after 9
    np.testing.assert_allclose(arrays["time"], np.arange(FRAMES) / 5, atol=1e-6)
    assert "mask" not in arrays
    assert any("turned about x" in text for text in warnings)


def with_masks(place):
    """Masks of a toy and of a hand, in another order for each camera; none for the last frame."""
    for c, names in enumerate(({"0": "Hand", "1": "sloth"}, {"0": "sloth", "1": "hand"})):
        (place / "mask").mkdir(exist_ok=True)
        (place / "mask" / f"mask_info_{c}.json").write_text(json.dumps(names))
        for key in names:
            (place / "mask" / str(c) / key).mkdir(parents=True)
            for f in range(FRAMES - 1):
                mask = np.zeros((48, 64), np.uint8)
                mask[f : f + 3, 10 if names[key] == "sloth" else 40] = 255
                cv2.imwrite(str(place / "mask" / str(c) / key / f"{f}.png"), mask)
    return place


def test_phystwin_processed_with_masks(tmp_path):
    place = with_masks(write_phystwin(tmp_path, raw=False))
    arrays, _ = read_sequence(place, ReadParams(fps=30))
    np.testing.assert_allclose(arrays["time"], np.arange(FRAMES) / 30)
    stack = ImageStack(arrays["mask"], arrays["mask_offsets"], 2, "mask")
    assert [stack.has(f, 0) for f in range(FRAMES)] == [True] * (FRAMES - 1) + [False]
    for c in range(2):
        rows, columns = np.nonzero(stack.mask(4, c))
        assert (rows.tolist(), columns.tolist()) == ([4, 5, 6], [10, 10, 10])


def test_masks_of_a_recording_are_taken_as_they_are(tmp_path):
    arrays, _ = read_sequence(with_masks(write_phystwin(tmp_path, raw=False)), ReadParams(fps=30))
    frames = Artifact(tmp_path, "frames", "", {}, {}, "", arrays)
    found = segment.run({"frames": frames, "hands": None}, SegmentParams(), None)
    masks = ImageStack(found.arrays["mask"], found.arrays["mask_offsets"], 2, "mask")
    given = ImageStack(arrays["mask"], arrays["mask_offsets"], 2, "mask")
    for c in range(2):
        np.testing.assert_array_equal(masks.mask(4, c), given.mask(4, c))
    assert found.arrays["area"].tolist() == [[3, 3]] * (FRAMES - 1) + [[0, 0]]
    assert found.warnings == ["1 of 12 frames have no mask in the recording"]


def test_phystwin_colour_as_a_video(tmp_path):
    place = write_phystwin(tmp_path)
    for c in range(2):
        shutil.rmtree(place / "color" / str(c))
        film = cv2.VideoWriter(str(place / "color" / f"{c}.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48))
        for f in range(FRAMES):
            film.write(np.full((48, 64, 3), 20 * f, np.uint8))
        film.release()
    arrays, _ = read_sequence(place, ReadParams())
    stack = ImageStack(arrays["color"], arrays["color_offsets"], 2, "colour")
    levels = [stack.color(f, 1).mean() for f in range(FRAMES)]
    np.testing.assert_allclose(levels, 20 * np.arange(FRAMES), atol=4)
    short = cv2.VideoWriter(str(place / "color" / "1.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48))
    for _ in range(5):
        short.write(np.zeros((48, 64, 3), np.uint8))
    short.release()
    with pytest.raises(DataError, match="video of camera 1 ends at frame 5, frame 5 is missing"):
        read_sequence(place, ReadParams())


def test_pgnd(tmp_path):
    arrays, warnings = read_sequence(write_pgnd(tmp_path), ReadParams())
    check_cameras(arrays, ["camera_0", "camera_1"])
    check_images(arrays, 7, 7, jpeg=True)
    np.testing.assert_allclose(arrays["time"], np.arange(FRAMES) / 5, atol=1e-5)
    known = np.isfinite(arrays["end_effector"]).all(1)
    assert known.sum() >= FRAMES - 1
    np.testing.assert_allclose(arrays["end_effector"][known][:3, 2], 0.3)
    np.testing.assert_allclose(np.diff(arrays["end_effector"][known][:, 1]), -0.01, atol=1e-4)
    assert any("turned about x" in text for text in warnings)
    assert any("robot/ is taken to be in the cameras' world" in text for text in warnings)


def test_calibration_beside_a_sequence_counts_to_it(tmp_path):
    write_pgnd(tmp_path)
    run = tmp_path / "run"
    piegraph_json("ingest", "--run", run, "--recording", tmp_path)
    shifts = np.load(tmp_path / "calibration" / "tvecs.npy")
    np.save(tmp_path / "calibration" / "tvecs.npy", shifts + 0.001)
    assert [o["state"] for o in piegraph_json("ingest", "--run", run)["outcomes"]] == ["done"]


@pytest.mark.parametrize("separator", ["_", ".", "-"])
def test_stills_with_poses_of_their_own(tmp_path, separator):
    for c, camera in enumerate(CAMERAS):
        color, depth = images(0, c)
        cv2.imwrite(str(tmp_path / f"frame-{c:06d}{separator}color.png"), color[:, :, ::-1])
        cv2.imwrite(str(tmp_path / f"frame-{c:06d}{separator}depth.png"), depth)
        np.savetxt(tmp_path / f"frame-{c:06d}{separator}pose.txt", camera.T_world_camera)
    np.savetxt(tmp_path / "camera-intrinsics.txt", CAMERAS[0].K)
    assert layout_of(tmp_path) == "stills"
    films, notes = read_films(tmp_path, "stills")
    for film, camera in zip(films, CAMERAS, strict=True):
        np.testing.assert_allclose(film.camera.T_world_camera, camera.T_world_camera, atol=1e-12)
        np.testing.assert_allclose(film.camera.K, CAMERAS[0].K)
    np.testing.assert_array_equal(films[1].images.depth(0)[0], images(0, 1)[1])
    assert "depth is taken to be in millimetres" in notes[0]


def write_stills(folder):
    place = folder / "scene"
    place.mkdir()
    for c, camera in enumerate(CAMERAS):
        color, depth = images(0, c)
        cv2.imwrite(str(place / f"{camera.name}_color.png"), color[:, :, ::-1])
        cv2.imwrite(str(place / f"{camera.name}_depth.png"), depth)
    write_cameras(place, CAMERAS)
    return place


def test_stills_are_a_scene_and_no_recording(tmp_path):
    place = write_stills(tmp_path)
    films, notes = read_films(place, layout_of(place))
    assert [film.camera.name for film in films] == ["camera_0", "camera_1"]
    assert [len(film.times) for film in films] == [1, 1]
    assert not notes
    refused = piegraph("ingest", "--run", tmp_path / "run", "--recording", tmp_path, check=3)
    assert "one frame: nothing can be seen to move" in refused.stderr
    assert "piegraph look" in refused.stderr


@pytest.mark.parametrize(
    ("breaks", "message"),
    [
        (lambda p: (p / "camera_1_color.png").unlink(), "camera camera_1 has no color image"),
        (lambda p: (p / "camera_1_depth.png").unlink(), "camera camera_1 has no depth image"),
        (lambda p: shutil.copy(p / "camera_1_color.png", p / "camera_1_rgb.png"), "are the same image"),
        (
            lambda p: [(p / f"camera_1_{k}.png").unlink() for k in ("color", "depth")],
            "is in cameras.json but has no im",
        ),
        (lambda p: write_cameras(p, CAMERAS[:1]), "camera_1 has images, but is not in cameras.json"),
        (lambda p: (p / "cameras.json").unlink(), "cameras.json is missing"),
    ],
)
def test_what_is_wrong_with_stills_is_named(tmp_path, breaks, message):
    place = write_stills(tmp_path)
    breaks(place)
    with pytest.raises(DataError) as refused:
        read_films(place, "stills")
    assert message in str(refused.value)
    assert str(tmp_path) in str(refused.value)


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
        (write("groundtruth.txt", "1 2 3\n"), "line 1: has 3 numbers, expected 8"),
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


def phystwin(change):
    def breaks(place):
        about = json.loads((place / "metadata.json").read_text())
        change(about)
        (place / "metadata.json").write_text(json.dumps(about))

    return breaks


def calibrated(value, protocol=4):
    return lambda place: (place / "calibrate.pkl").write_bytes(pickle.dumps(value, protocol))


def depth_of_step(value):
    return lambda place: np.save(place / "depth" / "1" / "3.npy", value)


BAD_PHYSTWIN = [
    (calibrated(Malicious()), "refused: it wants builtins.print, and only arrays, lists and numbers are read"),
    (calibrated([Malicious()], 0), "refused: it wants __builtin__.print"),
    (calibrated(np.array([Malicious(), 1], object)), "refused: it wants builtins.print"),
    (calibrated(np.array([None, 1], object)), "holds an array of"),
    (calibrated({1, 2}), "holds set, and only arrays, lists and numbers are read"),
    (calibrated([np.eye(4)]), "holds [1, 4, 4], and metadata.json has intrinsics of 2 cameras"),
    (calibrated([np.eye(4), np.ones((4, 4))]), "calibrate.pkl, camera 1: the"),
    (calibrated("poses"), "does not hold matrices"),
    (lambda p: (p / "calibrate.pkl").write_bytes((p / "calibrate.pkl").read_bytes()[:60]), "calibrate.pkl: cannot be"),
    (lambda p: (p / "calibrate.pkl").write_bytes(b""), "calibrate.pkl: cannot be read"),
    (phystwin(lambda about: about.pop("WH")), "metadata.json: has no WH"),
    (
        phystwin(lambda about: about.update(WH=[32, 48])),
        "color/0/0.png, camera 0: is 64 x 48, metadata.json says 32 x 48",
    ),
    (phystwin(lambda about: about.update(intrinsics="no")), "intrinsics are not numbers"),
    (phystwin(lambda about: about["recording"]["1"].pop("5")), "has no time of camera 1, frame 5"),
    (phystwin(lambda about: about.pop("recording") and about.pop("fps")), "has no fps"),
    (lambda p: (p / "metadata.json").write_text('{"WH": [64'), "metadata.json: cannot be read"),
    (lambda p: shutil.rmtree(p / "depth" / "1"), "camera 1 has a pose, but no folder of depth"),
    (lambda p: (p / "depth" / "2").mkdir(), "camera 2 has depth, but no pose"),
    (lambda p: shutil.rmtree(p / "color" / "1"), "camera 1 has no colour"),
    (lambda p: (p / "color" / "1" / "4.png").unlink(), "first unpaired frame 4"),
    (lambda p: (p / "color" / "1" / "4.png").write_bytes(b"x"), "image of camera 1, frame 4 cannot be decoded"),
    (lambda p: (p / "depth" / "1" / "3.npy").write_bytes(b"x"), "camera 1, frame 3: cannot be read"),
    (depth_of_step(np.ones((48, 64), np.float32)), "camera 1, frame 3: depth is float32"),
    (depth_of_step(np.full((48, 64), -1, np.int16)), "camera 1, frame 3: depth goes from -1 to -1"),
    (depth_of_step(np.ones((24, 64), np.uint16)), "camera 1, frame 3: depth is 64 x 24, colour 64 x 48"),
    (depth_of_step(np.array([Malicious()], object)), "camera 1, frame 3: cannot be read"),
]


@pytest.mark.parametrize(("breaks", "message"), BAD_PHYSTWIN, ids=[message[:40] for _, message in BAD_PHYSTWIN])
def test_what_is_wrong_with_a_phystwin_case_is_named(tmp_path, breaks, message, capsys):
    place = write_phystwin(tmp_path)
    breaks(place)
    with pytest.raises(DataError) as refused:
        read_sequence(place, ReadParams())
    assert message in str(refused.value)
    assert str(place) in str(refused.value)
    assert "code of others" not in capsys.readouterr().out


def test_depth_in_either_byte_order(tmp_path):
    place = write_phystwin(tmp_path)
    for f in range(FRAMES):
        np.save(place / "depth" / "1" / f"{f}.npy", images(f, 1)[1].astype(">u2"))
    check_images(read_sequence(place, ReadParams())[0], 5, 5)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", "<i8"])
def test_pickles_of_numbers_are_read_as_numpy_reads_them(tmp_path, protocol, kind):
    value = [
        np.arange(12).reshape(3, 4).astype(kind),
        np.asfortranarray(np.eye(3)),
        np.float64(2.5),
        [1, 2.5, "x", None],
    ]
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(value, protocol))
    for found, wanted in zip(load_pickle(tmp_path / "a.pkl"), value, strict=True):
        np.testing.assert_array_equal(found, wanted)


BAD_PGND = [
    (lambda p: shutil.rmtree(p.parent / "calibration"), "calibration/ is missing"),
    (lambda p: np.save(p.parent / "calibration" / "rvecs.npy", np.zeros((3, 3))), "rvecs.npy: holds an array (3, 3)"),
    (lambda p: (p.parent / "calibration" / "tvecs.npy").write_bytes(b"\x93NUMPY"), "tvecs.npy: cannot be read"),
    (lambda p: shutil.rmtree(p / "camera_1"), "camera_1 is calibrated, but has no folder"),
    (lambda p: shutil.copytree(p / "camera_1", p / "camera_2"), "camera_2 has no calibration"),
    (lambda p: (p / "timestamps.txt").write_text("0 0 0 0 1\n"), "line 1: has 5 numbers, expected 6"),
    (lambda p: (p / "timestamps.txt").write_text("0 0 0 0 1 soon\n"), "line 1: 'soon' is no number"),
    (lambda p: (p / "timestamps.txt").write_text("0 0 0 0 1 1\n"), "camera camera_0 has 12 frames and 1 time stamps"),
    (lambda p: (p / "camera_1" / "depth" / "000004.png").unlink(), "first unpaired frame 000004"),
    (lambda p: shutil.rmtree(p / "camera_1" / "depth"), "folder is missing"),
    (lambda p: (p / "robot" / "1700000000.200.txt").write_text("1 2 3\n"), "holds 1 rows"),
    (lambda p: (p / "robot" / "1700000000.200.txt").write_text("1 2 3\n" * 4 + "1\n"), "are not a rotation"),
]


@pytest.mark.parametrize(("breaks", "message"), BAD_PGND, ids=[message[:40] for _, message in BAD_PGND])
def test_what_is_wrong_with_a_pgnd_recording_is_named(tmp_path, breaks, message):
    place = write_pgnd(tmp_path)
    breaks(place)
    with pytest.raises(DataError) as refused:
        read_sequence(place, ReadParams())
    assert message in str(refused.value)
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize("write", [write_gbnd, write_tum, write_phystwin, write_pgnd, write_stills])
def test_a_folder_of_another_layout_is_told_as_that(tmp_path, write):
    sequence, name = write(tmp_path), write.__name__.removeprefix("write_")
    for other in set(SIGNS) - {name}:
        with pytest.raises(DataError, match=f"no sequence found in the layout {other}, but in the layout {name}"):
            list_sequences(tmp_path, other)
    assert layout_of(sequence) == name


def test_folders_that_cannot_be_read_are_named(tmp_path, monkeypatch):
    recording = make_recording(tmp_path / "rec")
    real = Path.iterdir

    def lock(name):
        def locked(path):
            if path.name == name:
                raise PermissionError(13, "Permission denied", str(path))
            return real(path)

        monkeypatch.setattr(Path, "iterdir", locked)

    lock("seq 0")
    with pytest.raises(DataError, match="seq 0: cannot be read: Permission denied"):
        list_sequences(recording)
    lock("depth")
    with pytest.raises(DataError, match="front/depth: cannot be read: Permission denied"):
        read_films(recording / "seq 1", "piegraph")


def test_gaps_in_numbering_are_said(tmp_path):
    places = write_gbnd(tmp_path / "a"), write_phystwin(tmp_path / "b"), write_pgnd(tmp_path / "c")
    for place in places:
        for file in place.rglob("*"):
            if file.stem in ("5", "000005", "000005_depth") and file.parent.name != "seg":
                file.unlink()
        lines = [(place / "timestamps.txt")] if (place / "timestamps.txt").is_file() else []
        for path in lines:
            kept = path.read_text().splitlines()
            path.write_text("\n".join(kept[:5] + kept[6:]))
        arrays, warnings = read_sequence(place, ReadParams())
        assert 5 not in arrays["source_frame"]
        assert any("no image between" in text for text in warnings)
