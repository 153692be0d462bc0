"""Recordings that keep a reader waiting, leave something out without a word, or break what reads them."""

import json
import os
import pickle

import numpy as np
import pytest

from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.layout import write_cameras
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.plain import load_numbers
from piegraph_cli.recording.points import read_points
from piegraph_cli.recording.readers import read_films, read_path
from piegraph_cli.recording.sequence import read_sequence
from piegraph_cli.stages.look import read_scene
from piegraph_cli.stages.simulate import record_sequences
from tests.recording.test_readers import phystwin, with_masks, write_gbnd, write_pgnd, write_phystwin, write_tum
from tests.stages.make_recording import make_recording


def replaced(path, make):
    path.unlink()
    make(path)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
@pytest.mark.parametrize("name", ["calibrate.pkl", "color/0/3.png", "depth/1/3.npy", "metadata.json"])
def test_pipes_and_devices_are_refused_before_they_are_read(tmp_path, name, make):
    place = write_phystwin(tmp_path)
    replaced(place / name, make)
    with pytest.raises(DataError, match="no regular file") as refused:
        read_films(place, "phystwin")
    assert str(place / name) in str(refused.value)


def test_a_pipe_beside_the_sequences_is_refused(tmp_path):
    place = write_pgnd(tmp_path)
    replaced(tmp_path / "calibration" / "rvecs.npy", os.mkfifo)
    with pytest.raises(DataError, match=r"rvecs.npy: cannot be read: no regular file"):
        read_films(place, "pgnd")


def test_a_link_to_itself_is_an_image_that_is_not_there(tmp_path):
    place = write_tum(tmp_path)
    replaced(sorted((place / "rgb").iterdir())[3], lambda path: path.symlink_to(path.name))
    with pytest.raises(DataError, match=r"rgb.txt: image .* is not in the sequence"):
        read_films(place, "tum")


@pytest.mark.parametrize("number", ["1e308", "1e160", "nan"])
def test_poses_of_impossible_numbers_are_left_out(tmp_path, number):
    place = write_tum(tmp_path)
    lines = (place / "groundtruth.txt").read_text().splitlines()
    lines[3] = " ".join([*lines[3].split()[:5], number, *lines[3].split()[6:]])
    (place / "groundtruth.txt").write_text("\n".join(lines))
    films, _ = read_films(place, "tum")
    assert np.isfinite(films[0].camera.T_world_camera).all()


def many_times_over():
    things: list = [1.0]
    for _ in range(9):
        things = [things] * 10
    return things


@pytest.mark.parametrize(
    ("poses", "message"),
    [(many_times_over(), "holds more than 10000 things"), ([[10**400] * 4] * 4, "does not hold matrices")],
)
def test_a_small_pickle_of_much_is_refused(tmp_path, poses, message):
    place = write_phystwin(tmp_path)
    (place / "calibrate.pkl").write_bytes(pickle.dumps(poses))
    with pytest.raises(DataError, match=message):
        read_films(place, "phystwin")


def test_a_header_that_is_no_python_is_refused(tmp_path):
    np.save(tmp_path / "k.npy", np.eye(3))
    data = (tmp_path / "k.npy").read_bytes()
    (tmp_path / "k.npy").write_bytes(data.replace(b"(3, 3)", b"((3, 3"))
    with pytest.raises(DataError, match=r"k.npy: cannot be read"):
        load_numbers(tmp_path / "k.npy", (3, 3))


@pytest.mark.parametrize("times", [None, 5, {"0": None}, {"0": 10**400}, {"0": "noon"}])
def test_times_that_are_none_are_named_by_camera_and_frame(tmp_path, times):
    place = write_phystwin(tmp_path)
    phystwin(lambda about: about["recording"].update({"1": times}))(place)
    with pytest.raises(DataError, match="has no time of camera 1, frame 0") as refused:
        read_films(place, "phystwin")
    assert refused.value.hint


@pytest.mark.parametrize("name", ["99999999999999999999", "9" * 200, "1.5"])
def test_a_step_that_is_no_step_is_named(tmp_path, name):
    place = write_phystwin(tmp_path)
    for kind, suffix in (("color", ".png"), ("depth", ".npy")):
        (place / kind / "0" / f"0{suffix}").rename(place / kind / "0" / f"{name}{suffix}")
    with pytest.raises(DataError, match="is not named by a number"):
        read_films(place, "phystwin")


def test_a_camera_without_masks_among_those_with_is_told(tmp_path):
    place = write_phystwin(tmp_path)
    with_masks(place)
    assert not any("no mask" in text for text in read_sequence(place, ReadParams())[1])
    (place / "mask" / "mask_info_1.json").unlink()
    assert any("no mask of an object for camera 1" in text for text in read_sequence(place, ReadParams())[1])


def test_a_camera_that_lost_its_intrinsics_is_not_left_out_in_silence(tmp_path):
    place = write_gbnd(tmp_path)
    (place / "camera_1" / "camera_params.npy").unlink()
    with pytest.raises(DataError, match=r"camera_1/camera_params.npy: cannot be read"):
        read_films(place, "gbnd")


def test_a_table_of_the_end_effector_that_cannot_be_read_is_not_taken_for_none(tmp_path):
    place = next(path for path in sorted(make_recording(tmp_path / "rec").iterdir()) if path.is_dir())
    assert read_path(place, "piegraph", ReadParams()) is None
    (place / "end_effector.csv").symlink_to("end_effector.csv")
    with pytest.raises(DataError, match=r"end_effector.csv"):
        read_path(place, "piegraph", ReadParams())


def transposed_pgnd(place):
    np.save(
        place.parent / "calibration" / "intrinsics.npy",
        np.load(place.parent / "calibration" / "intrinsics.npy").swapaxes(1, 2),
    )


def transposed_phystwin(place):
    phystwin(lambda about: about.update(intrinsics=np.swapaxes(about["intrinsics"], 1, 2).tolist()))(place)


def transposed_ours(place):
    about = json.loads((place.parent / "cameras.json").read_text())
    for camera in about["cameras"].values():
        camera["K"] = np.transpose(camera["K"]).tolist()
    (place.parent / "cameras.json").write_text(json.dumps(about))


def write_ours(folder):
    return next(path for path in sorted(make_recording(folder / "rec").iterdir()) if path.is_dir())


@pytest.mark.parametrize(
    ("write", "layout", "change"),
    [
        (write_pgnd, "pgnd", transposed_pgnd),
        (write_phystwin, "phystwin", transposed_phystwin),
        (write_ours, "piegraph", transposed_ours),
    ],
)
def test_transposed_intrinsics_are_told(tmp_path, write, layout, change):
    place = write(tmp_path)
    read_films(place, layout)
    change(place)
    with pytest.raises(DataError, match="is no matrix of intrinsics: it is transposed"):
        read_films(place, layout)


@pytest.mark.parametrize("frame", ["²", "٣", "9" * 5000])
def test_what_is_no_frame_number_is_a_folder_that_is_not_there(tmp_path, frame):
    with pytest.raises(DataError, match="no such folder"):
        read_scene(f"{write_ours(tmp_path)}:{frame}")


def test_a_recording_is_not_rendered_over(tmp_path):
    recording = make_recording(tmp_path / "rec")
    before = (recording / "cameras.json").read_bytes()
    with pytest.raises(UsageError, match="not simulated"):
        record_sequences(recording, SimulateParams(environment="tblock", sequences=1), jobs=1, force=False)
    assert (recording / "cameras.json").read_bytes() == before


def test_cameras_that_cannot_be_written_are_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_cameras(tmp_path / "file" / "rec", [])


def test_a_cloud_of_impossible_places_is_refused(tmp_path):
    np.savez(tmp_path / "goal.npz", points=np.array([[0, 0, 0], [0, 1e30, 0]]))
    with pytest.raises(DataError, match=r"goal.npz, frame 0: a point is 1e\+30 m from the origin"):
        read_points(tmp_path / "goal.npz", None, {})
