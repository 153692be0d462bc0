"""Merging hand landmarks over cameras and time, on landmarks and depth whose truth is known."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.errors import MissingError
from piegraph_cli.perception import hands
from piegraph_cli.perception.hands import (
    FLESH,
    detect_hands,
    end_effector,
    fill_gaps,
    find_hands,
    lift_hands,
    merge_rays,
)
from tests.perception.scene import hand_pose, ring_camera

CAMERAS = [ring_camera(azimuth, f"c{n}") for n, azimuth in enumerate((0.4, 2.0, 3.5, 5.1))]
TIMES = np.arange(8) * 0.2
HANDS = np.array([hand_pose(np.array([0.1 - 0.01 * f, 0.02, 0.03])) for f in range(8)])


def landmarks_of(hands: np.ndarray) -> np.ndarray:
    return np.stack([[camera.project(hand)[0] for camera in CAMERAS] for hand in hands])


def skin_depth(hands: np.ndarray):
    """Depth images that read the skin above each landmark in a small patch, the nearest landmark on top."""

    def depth(frame: int, c: int) -> np.ndarray:
        pixels, distance = CAMERAS[c].project(hands[frame])
        image = np.zeros((159, 212), np.uint16)
        for k in np.argsort(-distance):
            length = np.linalg.norm(CAMERAS[c].rays(pixels[k])[0])
            column, row = np.round(pixels[k]).astype(int)
            image[row - 2 : row + 3, column - 2 : column + 3] = round(1000 * (distance[k] - FLESH[k] / length))
        return image

    return depth


def test_keypoints_of_clean_landmarks():
    track = lift_hands(landmarks_of(HANDS), skin_depth(HANDS), CAMERAS, TIMES)
    assert track.seen.all()
    assert track.observed.all()
    np.testing.assert_allclose(track.keypoints, HANDS, atol=2e-3)
    assert (track.spread < 1e-3).all()


def test_one_camera_needs_its_depth():
    one = lift_hands(landmarks_of(HANDS)[:, :1], skin_depth(HANDS), CAMERAS[:1], TIMES)
    assert np.nanmedian(np.linalg.norm(one.keypoints - HANDS, axis=-1)) < 3e-3
    blind = lift_hands(landmarks_of(HANDS)[:, :1], lambda f, c: np.zeros((159, 212), np.uint16), CAMERAS[:1], TIMES)
    assert np.isnan(blind.keypoints).all()
    assert not blind.observed.any()
    assert blind.seen.all()


def test_how_much_of_a_hand_has_a_depth_is_known():
    pixels = landmarks_of(HANDS).copy()
    pixels[1, 2] = np.nan
    deep = lift_hands(pixels, skin_depth(HANDS), CAMERAS, TIMES).deep
    assert np.isnan(deep[1, 2])
    assert np.nanmean(deep) > 0.8
    beside = lift_hands(pixels, lambda f, c: np.roll(skin_depth(HANDS)(f, c), 30, 1), CAMERAS, TIMES).deep
    assert np.nanmean(beside) < 0.5


def test_two_cameras_need_no_depth():
    nothing = np.zeros((159, 212), np.uint16)
    track = lift_hands(landmarks_of(HANDS)[:, :2], lambda f, c: nothing, CAMERAS[:2], TIMES)
    np.testing.assert_allclose(track.keypoints, HANDS, atol=1e-4)


def test_a_camera_that_is_wrong_is_outvoted():
    pixels = landmarks_of(HANDS)
    pixels[:, 2] += 40
    track = lift_hands(pixels, skin_depth(HANDS), CAMERAS, TIMES)
    np.testing.assert_allclose(track.keypoints, HANDS, atol=3e-3)


@pytest.mark.parametrize("reading", ["table", "something in front"])
def test_depth_that_cannot_be_the_finger_is_not_believed(reading):
    camera, true = CAMERAS[1], skin_depth(HANDS)

    def wrong(frame: int, _: int) -> np.ndarray:
        image = true(frame, 1)
        column, row = np.round(camera.project(HANDS[frame])[0][8]).astype(int)
        ray = camera.rays([[column, row]])[0] @ camera.T_world_camera[:3, :3].T
        table = -1000 * camera.T_world_camera[2, 3] / ray[2]
        image[row - 3 : row + 4, column - 3 : column + 4] = table if reading == "table" else 400
        return image

    track = lift_hands(landmarks_of(HANDS)[:, 1:2], wrong, [camera], TIMES)
    assert np.isnan(track.keypoints[:, 8]).all()
    assert np.isfinite(track.keypoints[:, 4]).all()


def test_all_cameras_together_are_better_than_any_two():
    rng = np.random.default_rng(0)
    pixels = landmarks_of(HANDS) + rng.normal(0, 1.5, (8, 4, 21, 2))
    blind = np.zeros((159, 212), np.uint16)

    def error(views: list[int]) -> float:
        cameras = [CAMERAS[c] for c in views]
        track = lift_hands(pixels[:, views], lambda f, c: blind, cameras, TIMES, max_speed=10)
        return np.sqrt(np.nanmean((track.keypoints - HANDS) ** 2))

    pairs = [error([a, b]) for a in range(4) for b in range(a)]
    assert error([0, 1, 2, 3]) < 0.78 * min(pairs)


def test_a_jump_is_dropped_and_filled():
    hands = HANDS.copy()
    hands[4] += [0.6, 0, 0]
    track = lift_hands(landmarks_of(hands), lambda f, c: np.zeros((159, 212), np.uint16), CAMERAS, TIMES)
    assert list(np.flatnonzero(~track.observed)) == [4]
    np.testing.assert_allclose(track.keypoints[4], (HANDS[3] + HANDS[5]) / 2, atol=1e-3)


def test_a_fast_hand_is_kept_when_allowed():
    hands = HANDS.copy()
    hands[4:] += [0.2, 0, 0]
    nothing = np.zeros((159, 212), np.uint16)
    assert lift_hands(landmarks_of(hands), lambda f, c: nothing, CAMERAS, TIMES, max_speed=1.5).observed.all()
    slow = lift_hands(landmarks_of(hands), lambda f, c: nothing, CAMERAS, TIMES, max_speed=0.3)
    assert not slow.observed[3:5].all()


@pytest.mark.parametrize(("missing", "filled"), [([3], True), ([3, 4], True), ([3, 4, 5], False), ([0], False)])
def test_only_short_inner_gaps_are_filled(missing, filled):
    keypoints = HANDS.copy()
    keypoints[missing] = np.nan
    result = fill_gaps(keypoints, TIMES, max_gap=0.65)
    if filled:
        np.testing.assert_allclose(result, HANDS, atol=1e-9)
    else:
        assert np.isnan(result[missing]).all()


def test_a_hand_hidden_from_one_camera_is_projected_into_it():
    pixels = landmarks_of(HANDS)
    expected = pixels[:, 1].copy()
    pixels[:, 1] = np.nan
    track = lift_hands(pixels, skin_depth(HANDS), CAMERAS, TIMES)
    assert not track.seen[:, 1].any()
    assert track.seen[:, 0].all()
    np.testing.assert_allclose(track.pixels[:, 1], expected, atol=1)


def test_a_hand_never_seen():
    def never(frame: int, camera: int) -> np.ndarray:
        raise AssertionError("depth asked for without a hand")

    track = lift_hands(np.full((8, 4, 21, 2), np.nan), never, CAMERAS, TIMES)
    assert np.isnan(track.keypoints).all()
    assert np.isnan(track.pixels).all()
    assert np.isnan(track.spread).all()
    assert not track.observed.any()
    assert not track.seen.any()


def test_a_single_frame():
    track = lift_hands(landmarks_of(HANDS[:1]), skin_depth(HANDS), CAMERAS, TIMES[:1])
    np.testing.assert_allclose(track.keypoints, HANDS[:1], atol=2e-3)


def test_nearly_parallel_rays_alone_say_nothing():
    origins = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    rays = np.array([[[[0.05, 0, 1]], [[-0.05, 0, 1]]]]) / np.hypot(0.05, 1)
    assert np.isnan(merge_rays(origins, rays, np.full(rays.shape, np.nan))).all()


def test_end_effector_lies_between_the_finger_tips():
    np.testing.assert_allclose(end_effector(HANDS)[0], [0.1, 0.02, 0.03], atol=1e-3)
    keypoints = HANDS.copy()
    keypoints[2, 8] = np.nan
    assert np.isnan(end_effector(keypoints)[2]).all()


def test_a_missing_model_is_named(tmp_path):
    with pytest.raises(MissingError, match=r"nowhere\.task.*\n.*doctor --fetch hand-landmarker"):
        detect_hands([], np.zeros(0), tmp_path / "nowhere.task", 1)


def test_a_broken_model_is_named(tmp_path):
    (tmp_path / "broken.task").write_bytes(b"not a model")
    with pytest.raises(MissingError, match=r"broken\.task"):
        detect_hands([np.zeros((64, 64, 3), np.uint8)], np.zeros(1), tmp_path / "broken.task", 1)


class FakeLandmarker:
    """Stands in for MediaPipe's: answers the calls in turn with a hand at the image's centre, or with none."""

    def __init__(self, answers):
        self.answers, self.stamps = list(answers), []

    def detect_for_video(self, image, stamp):
        self.stamps.append(stamp)
        if not self.answers.pop(0):
            return SimpleNamespace(hand_landmarks=[], handedness=[])
        points = [SimpleNamespace(x=0.5, y=0.25)] * 21
        return SimpleNamespace(hand_landmarks=[points], handedness=[[SimpleNamespace(score=0.9)]])


@pytest.fixture
def landmarker(monkeypatch):
    fake = FakeLandmarker([True, False, True, False, False])
    monkeypatch.setattr(hands, "_hand_landmarker", lambda path, count, mode: nullcontext(fake))
    return fake


def test_a_lost_hand_is_searched_for_again_in_the_same_frame(landmarker):
    images = [np.zeros((40, 80, 3), np.uint8)] * 3
    pixels, score = detect_hands(images, np.array([7.0, 7.2, 7.2005]), Path("model.task"), 1)
    pixels, score = pixels[:, 0], score[:, 0]
    np.testing.assert_allclose(pixels[:2], np.tile([39.5, 9.5], (2, 21, 1)))
    assert np.isnan(pixels[2]).all()
    assert score.tolist() == [0.9, 0.9, 0.0]
    assert landmarker.stamps == sorted(set(landmarker.stamps))
    assert landmarker.stamps[:2] == [0, 200]


def test_what_was_not_followed_is_searched_for_once(landmarker):
    landmarker.answers = [False, False, True]
    pixels, _ = detect_hands([np.zeros((40, 80, 3), np.uint8)] * 3, np.array([0.0, 0.2, 0.4]), Path("model.task"), 1)
    assert np.isfinite(pixels).all(axis=(1, 2, 3)).tolist() == [False, False, True]
    assert landmarker.stamps == [0, 200, 400]


def test_hands_of_images_apart(monkeypatch):
    fake = FakeLandmarker([True, False])
    monkeypatch.setattr(hands, "_hand_landmarker", lambda path, count, mode: nullcontext(fake))
    fake.detect = lambda image: fake.detect_for_video(image, 0)
    pixels, score = find_hands((np.zeros((40, 80, 3), np.uint8) for _ in range(2)), Path("model.task"), 2)
    assert pixels.shape == (2, 2, 21, 2)
    np.testing.assert_allclose(pixels[0, 0], np.tile([39.5, 9.5], (21, 1)))
    assert np.isnan(pixels[0, 1]).all()
    assert score.tolist() == [[0.9, 0.0], [0.0, 0.0]]
