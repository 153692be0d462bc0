"""Depth of another moment than its colour: made-up scenes in which a disc wanders over a ground, in both."""

import cv2
import numpy as np
import pytest

from piegraph_cli.recording.clocks import moving
from piegraph_cli.recording.lag import MOST, agreement, busiest, check_lags, lag_of, moving_in_depth
from tests.recording.test_clocks import STEP, TIMES, VIEWS, film, path


def depth_film(camera, late=0.0):
    """Depth images uint16 (mm) of the disc, 5 cm above the ground, with holes."""
    rng, images = np.random.default_rng(camera + 9), []
    for place in path(TIMES - late):
        image = np.full((60, 80), 800, np.uint16) + rng.integers(0, 5, (60, 80)).astype(np.uint16)
        x, y = VIEWS[camera % 3] @ [*place, 1]
        cv2.circle(image, (round(x), round(y)), 9, 750, -1)
        image[rng.random(image.shape) < 0.05] = 0
        images.append(image)
    return images


def told(late, frames=slice(None)):
    color = [moving(film(k)[frames]) for k in range(len(late))]
    depth = [moving_in_depth(depth_film(k, one)[frames], 0.001) for k, one in enumerate(late)]
    return check_lags([f"cam{k}" for k in range(len(late))], color, depth, [TIMES[frames]] * len(late))


def test_depth_of_the_same_moment_is_good():
    assert told([0, 0, 0]) == []
    assert told([0, 0], slice(4, 15)) == []


@pytest.mark.parametrize("frames", [1, 2, -1])
def test_one_camera_whose_depth_is_frames_late_is_named(frames):
    (check,) = told([0, frames * STEP])
    assert (check.name, check.cameras, check.verdict) == ("clocks", ("cam1",), "bad")
    assert check.figure == pytest.approx(frames * STEP, abs=0.08)
    assert f"{'after' if frames > 0 else 'before'} colour" in check.text
    assert check.cause == "depth and colour of a frame are of different moments"


def test_half_a_frame_is_doubtful():
    (check,) = told([0, STEP / 2])
    assert (check.cameras, check.verdict) == (("cam1",), "doubtful")
    assert check.figure == pytest.approx(STEP / 2, abs=0.05)


@pytest.mark.parametrize("frames", [1, 2, -1])
def test_few_frames_of_one_camera_tell(frames):
    (check,) = told([frames * STEP], slice(4, 15))
    assert (check.cameras, check.verdict) == (("cam0",), "bad")
    assert check.figure == pytest.approx(frames * STEP, abs=0.1)
    assert told([frames * STEP], slice(4, 11)) == []
    assert told([0], slice(4, 15)) == []


def test_where_no_camera_tells_enough_all_do_together(monkeypatch):
    monkeypatch.setattr("piegraph_cli.recording.lag.CHANGE", 9.0)
    (check,) = told([2 * STEP] * 2, slice(4, 15))
    assert (check.cameras, check.verdict) == (("cam0", "cam1"), "bad")
    assert told([2 * STEP], slice(4, 15)) == []


def test_lags_are_told_in_parts_of_a_frame():
    rng = np.random.default_rng(0)
    moved = rng.random((30, 4, 5)) ** 4
    assert lag_of(agreement(moved, moved, 3)) == pytest.approx(0, abs=0.1)
    assert lag_of(agreement(moved, np.roll(moved, 2, 0), 3)) == pytest.approx(2, abs=0.1)
    between = (moved + np.roll(moved, 1, 0)) / 2
    assert lag_of(agreement(moved, between, 3)) == pytest.approx(0.5, abs=0.1)


def test_of_long_sequences_the_busiest_part_is_looked_at():
    seen = np.zeros((3 * MOST, 24))
    seen[200:230] = np.random.default_rng(0).random((30, 24))
    part = busiest(seen)
    assert part.start <= 200
    assert part.stop >= 230
    assert part.stop - part.start == MOST
