"""A camera that stops while others go on is said, and its depth counts for nothing; still views and stutters are none."""

import cv2
import numpy as np
import pytest

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.errors import DataError
from piegraph_cli.recording.frozen import LONG, find_frozen
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.sequence import read_sequence

FRAMES = 12


def images(noise: float = 1.0, frames: int = FRAMES, cameras: int = 2, moves: bool = True) -> list[bytes]:
    rng = np.random.default_rng(0)
    found = []
    for f in range(frames):
        for _ in range(cameras):
            image = np.full((24, 32), 500.0)
            image[4:8, f : f + 4] -= 50 * moves
            image += noise * 5 * rng.standard_normal(image.shape)
            found.append(cv2.imencode(".png", image.astype(np.uint16))[1].tobytes())
    return found


def frozen(images: list[bytes], camera: int, first: int, last: int = FRAMES) -> list[bytes]:
    return [
        images[first * 2 + camera] if k % 2 == camera and first <= k // 2 < last else one
        for k, one in enumerate(images)
    ]


def test_what_repeats_while_others_go_on_is_found_from_its_first_repetition():
    good, there = images(), np.ones((FRAMES, 2), bool)
    for kinds, of_color, of_depth in (
        ((good, good), 0, 0),
        ((frozen(good, 1, 5), good), 6, 0),
        ((good, frozen(good, 1, 5)), 0, 6),
        ((frozen(good, 1, 0), frozen(good, 1, 0)), 11, 11),
        ((frozen(good, 1, 5, 5 + LONG), good), 0, 0),
        ((frozen(good, 1, 5, 6 + LONG), good), LONG, 0),
    ):
        color, depth = find_frozen(*kinds, there)
        assert (color.sum(0).tolist(), depth.sum(0).tolist()) == ([0, of_color], [0, of_depth])


def test_still_views_without_noise_and_lost_frames_are_no_camera_that_stopped():
    there = np.ones((FRAMES, 2), bool)
    still, moving = images(0, moves=False), images(0)
    mixed = [(moving, still)[k % 2][k] for k in range(len(still))]
    for kinds in ((still, still), (mixed, mixed), (images(), still), (moving, moving)):
        assert not np.any(find_frozen(*kinds, there))
    there[5:, 1] = False
    good = images()
    assert not np.any(find_frozen(frozen(good, 1, 5), frozen(good, 1, 5), there))


def record(folder, stopped: int):
    rng = np.random.default_rng(0)
    cameras = camera_rig(32, 24)[:2]
    write_cameras(folder, cameras)
    for k, camera in enumerate(cameras):
        for frame in range(FRAMES):
            if k == 0 or frame <= stopped:
                color = rng.integers(0, 255, (24, 32, 3)).astype(np.uint8)
                depth = rng.integers(900, 1100, (24, 32)).astype(np.uint16)
            write_frame(folder / "take", camera, frame, color, depth, 90)
        write_times(folder / "take", camera, np.arange(FRAMES) / 5)
    return folder / "take"


def test_a_camera_that_stops_is_lost_from_there_on(tmp_path):
    arrays, warnings = read_sequence(record(tmp_path, stopped=7), ReadParams())
    assert arrays["source_frame"][:, 1].tolist() == [0, 1, 2, 3, 4, 5, 6, 7, -1, -1, -1, -1]
    assert [
        w for w in warnings if "camera cam1 stopped: its depth repeats one picture from frame 8 on, in 4 of 12" in w
    ]
    assert not [w for w in warnings if "cam0" in w]


def test_a_camera_that_stopped_for_most_of_a_sequence_is_refused(tmp_path):
    with pytest.raises(
        DataError, match="camera cam1 stopped: its colour repeats one picture from frame 3 on, in 9 of 12"
    ):
        read_sequence(record(tmp_path, stopped=2), ReadParams())
