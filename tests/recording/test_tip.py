"""Whether a measured end-effector is where the cameras see something move: a rod that goes about a table of boxes."""

import re
from functools import cache

import numpy as np
import pytest

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.recording.tip import check_tip
from tests.recording.table_scene import BLOCK, Box, make_views

FRAMES = 30
TIMES = np.arange(FRAMES) * 0.2


def path(times) -> np.ndarray:
    """Where the rod's lower end is [T, 3] (m): it rests, goes about, never on the block."""
    turn = 2 * np.pi * np.clip(np.asarray(times) - 1, 0, 4) / 4
    return np.stack([0.22 * np.cos(turn), 0.26 * np.sin(2 * turn) / 2 + 0.15, np.full(len(turn), 0.02)], 1)


@cache
def recorded():
    """Cameras and their depth images: the rod is 2 cm wide and 12 cm high."""
    cameras = camera_rig(160, 120)[:2]
    boxes = [(*BLOCK, Box((x, y), (0.02, 0.02, 0.12))) for x, y, _ in path(TIMES)]
    return cameras, [view.depth for view in make_views(cameras, 0.001, boxes)]


def told(tips) -> list[str]:
    return check_tip(tips, TIMES, *recorded())


def test_a_tip_that_is_where_something_moves_is_good():
    assert told(path(TIMES)) == []
    assert told(path(TIMES) + np.array([0.01, 0.01, 0.02])) == []


@pytest.mark.parametrize("late", [0.4, -0.6])
def test_a_clock_that_is_another_is_said_with_the_seconds(late):
    (text,) = told(path(TIMES - late))
    assert f"{abs(late):.1f} s {'ahead of' if late > 0 else 'behind'} the cameras'" in text
    assert ("subtract" if late > 0 else "add") + f" {abs(late):.1f} s" in text


@pytest.mark.parametrize(
    "change", [lambda p: p * [-1, -1, 1], lambda p: p[:, [0, 2, 1]], lambda p: p + np.array([0, 0, 0.15])]
)
def test_another_frame_of_reference_is_said(change):
    (text,) = told(change(path(TIMES)))
    assert "in the cameras' world" in text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p + np.array([0, 0, 0.2]), r"were it (9|12|15|20) cm lower"),
        (lambda p: p - np.array([0, 0, 0.09]), r"were it (6|9|12|15) cm higher"),
        (lambda p: p[:, [1, 0, 2]], "with x and y exchanged"),
        (lambda p: p * [1, -1, 1], "with y turned over"),
        (lambda p: p[:, [1, 0, 2]] * [1, -1, 1], "turned by 90 degrees"),
    ],
)
def test_the_frame_of_reference_that_would_fit_is_named(change, said):
    (text,) = told(change(path(TIMES)))
    assert re.search(said, text), text


def test_what_never_moves_or_is_out_of_all_images_is_said():
    assert told(np.zeros((FRAMES, 3))) == ["the end-effector never moves by more than 10 mm"]
    (text,) = told(path(TIMES) + np.array([0, 0, 2.0]))
    assert "no camera sees" in text
    assert told(np.full((FRAMES, 3), np.nan)) == []
