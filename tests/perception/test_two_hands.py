"""Two hands in view: told from one, kept apart over cameras and time, the one that moves found."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.perception import hands
from piegraph_cli.perception.hands import detect_hands, end_effector, lift_hands
from piegraph_cli.perception.two_hands import look_frames, sees_two, separate_hands, travel
from tests.perception.scene import hand_pose, ring_camera
from tests.perception.test_hands import landmarks_of, skin_depth

CAMERAS = [ring_camera(azimuth, f"c{n}") for n, azimuth in enumerate((0.4, 2.0, 3.5, 5.1))]
FRAMES = 8
TIMES = np.arange(FRAMES) * 0.2
PUSHING = np.array([hand_pose(np.array([0.1 - 0.02 * f, 0.06, 0.03])) for f in range(FRAMES)])
RESTING = np.array([hand_pose(np.array([-0.05, -0.14, 0.02]))] * FRAMES)


def both_depths(frame: int, c: int) -> np.ndarray:
    near, far = skin_depth(PUSHING)(frame, c), skin_depth(RESTING)(frame, c)
    return np.where(near > 0, near, far)


@pytest.fixture
def detections():
    """Both hands [F, C, 2, 21, 2], in an order that changes from image to image."""
    found = np.stack([landmarks_of(PUSHING), landmarks_of(RESTING)], axis=2)
    swapped = np.random.default_rng(0).random((FRAMES, len(CAMERAS))) < 0.5
    found[swapped] = found[swapped][:, ::-1]
    return found


def test_hands_in_any_order_are_kept_apart_and_the_one_that_moves_is_found(detections):
    each = separate_hands(detections, both_depths, CAMERAS)
    tracks = [lift_hands(one, both_depths, CAMERAS, TIMES) for one in each]
    ways = [travel(end_effector(track.keypoints)) for track in tracks]
    mover = int(np.argmax(ways))
    np.testing.assert_allclose(each[mover], landmarks_of(PUSHING))
    np.testing.assert_allclose(each[1 - mover], landmarks_of(RESTING))
    assert max(ways) > 0.05 > 0.01 > min(ways)


def test_a_hand_seen_alone_by_some_cameras_goes_to_its_owner(detections):
    detections[3, 1, 0] = np.nan
    detections[4, :, 1] = np.nan
    each = separate_hands(detections, both_depths, CAMERAS)
    truth = [landmarks_of(PUSHING), landmarks_of(RESTING)]
    if not np.allclose(each[0, 0], truth[0][0]):
        truth.reverse()
    for found, true in zip(each, truth, strict=True):
        known = np.isfinite(found)
        assert known[[0, 1, 2, 5, 6, 7]].all()
        np.testing.assert_allclose(found[known], true[known])


def test_one_hand_found_twice_stays_one():
    once = landmarks_of(PUSHING)
    each = separate_hands(np.stack([once, once + 1], axis=2), skin_depth(PUSHING), CAMERAS)
    np.testing.assert_allclose(each[0], once)
    assert np.isnan(each[1]).all()


def test_two_hands_are_sure_and_apart(detections):
    one_camera, sure = detections[:, 0], np.full((FRAMES, 2), 0.9)
    assert sees_two(one_camera, sure).all()
    assert not sees_two(one_camera, sure * [1, 0.3]).any()
    assert not sees_two(one_camera[:, [0, 0]], sure).any()
    assert not sees_two(np.where(np.arange(2)[:, None, None] == 1, np.nan, one_camera), sure).any()


def test_frames_looked_at_lie_inside_the_sequence():
    assert look_frames(41).tolist() == [10, 20, 30]
    assert len(look_frames(1)) <= 1


def test_a_path_unknown_goes_nowhere():
    assert travel(np.full((4, 3), np.nan)) == 0.0


def test_all_hands_of_an_image_are_returned(monkeypatch):
    points = [[SimpleNamespace(x=x, y=0.5)] * 21 for x in (0.25, 0.75)]
    sure = [[SimpleNamespace(score=score)] for score in (0.9, 0.8)]
    fake = SimpleNamespace(detect_for_video=lambda *_: SimpleNamespace(hand_landmarks=points, handedness=sure))
    monkeypatch.setattr(hands, "_hand_landmarker", lambda path, count, mode: nullcontext(fake))
    pixels, score = detect_hands([np.zeros((40, 80, 3), np.uint8)], np.zeros(1), Path("model.task"), 2)
    assert pixels[0, :, 0].tolist() == [[19.5, 19.5], [59.5, 19.5]]
    assert score.tolist() == [[0.9, 0.8]]
