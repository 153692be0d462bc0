"""Picks by hand, told from pushes: what thumb and fingers do, where, and what becomes of the object."""

import numpy as np
import pytest

from piegraph_cli.perception.pinch import held_points, moves, openness, picks, pinches, with_picks

OPEN, CLOSED = 0.6, 0.15
SHEET = np.stack([*np.meshgrid(np.linspace(-0.1, 0.1, 21), np.linspace(-0.1, 0.1, 21)), np.zeros((21, 21))], -1)
SHEET = SHEET.reshape(-1, 3)


def hand(apart: list[float], cameras: int = 2) -> np.ndarray:
    """Landmarks [F, C, 21, 2] (px) of a palm of 100 px whose thumb is so far from index and middle fingertip; NaN: unseen."""
    landmarks = np.full((len(apart), cameras, 21, 2), np.nan)
    for f, share in enumerate(apart):
        if np.isfinite(share):
            landmarks[f] = 0.0
            landmarks[f, :, 9] = [0, 100]
            landmarks[f, :, [8, 12]] = [100 * share, 0]
    return landmarks


def lifted(height: float) -> np.ndarray:
    """The sheet with its middle so high (m)."""
    raised = SHEET.copy()
    raised[:, 2] = height * np.exp(-np.linalg.norm(SHEET[:, :2], axis=1) / 0.05)
    return raised


def test_openness_is_that_of_the_median_camera_whatever_the_size():
    landmarks = hand([0.2, 0.5, np.nan], cameras=3)
    landmarks[0, 0] *= 7.0
    landmarks[1, 2, [8, 12]] = [3.0, 0.0]
    np.testing.assert_allclose(openness(landmarks), [0.2, 0.5, np.nan])


def test_a_frame_or_two_that_are_read_wrong_neither_open_nor_close_a_hand():
    truth = [False] * 6 + [True] * 7 + [False] * 6
    apart = np.where(truth, CLOSED, OPEN)
    apart[[2, 9]] = [0.30, 0.40]
    apart[11] = np.nan
    assert pinches(apart).tolist() == truth


@pytest.mark.parametrize("noise", range(5))
def test_pinches_of_a_noisy_hand(noise):
    truth = np.array([False] * 8 + [True] * 8 + [False] * 8 + [True] * 6 + [False] * 4)
    apart = np.where(truth, 0.22, 0.50) + np.random.default_rng(noise).normal(0, 0.06, len(truth))
    assert (pinches(apart) == truth).mean() > 0.95


FRAMES = 12
ACTS = [OPEN] * 4 + [CLOSED] * 5 + [OPEN] * 3
RISING = [0.0, 0, 0, 0, 0, 0.02, 0.04, 0.04, 0.01, 0, 0, 0]
AT_SHEET = np.tile([0.0, 0.0, 0.02], (FRAMES, 1))


def test_a_pick_is_a_hand_that_closes_on_the_object_and_lifts_it():
    found = picks(hand(ACTS), AT_SHEET, [lifted(h) for h in RISING], 0.06)
    assert np.flatnonzero(found).tolist() == [4, 5, 6, 7, 8]


@pytest.mark.parametrize(
    ("apart", "tips", "heights"),
    [
        (ACTS, AT_SHEET, [0.0] * FRAMES),
        ([CLOSED] * FRAMES, AT_SHEET, RISING),
        (ACTS, AT_SHEET + np.array([0.3, 0, 0]), RISING),
        ([np.nan] * FRAMES, AT_SHEET, RISING),
    ],
    ids=["nothing rises", "closed all the time", "away from the object", "never seen"],
)
def test_what_is_no_pick(apart, tips, heights):
    assert not picks(hand(apart), tips, [lifted(h) for h in heights], 0.06).any()


@pytest.mark.parametrize(
    ("before", "height", "gap", "held"),
    [
        (0.04, 0.04, 3, range(4, 15)),
        (0.04, 0.0, 3, range(4, 9)),
        (0.04, 0.015, 3, range(4, 9)),
        (0.01, 0.04, 3, range(4, 9)),
        (0.04, 0.04, 4, range(4, 9)),
    ],
    ids=["it stays up", "it has fallen", "on a pile", "beside a pile", "too long"],
)
def test_a_hand_that_looks_open_while_what_it_lifted_stays_up_holds_it(before, height, gap, held):
    apart = [OPEN] * 4 + [CLOSED] * 5 + [OPEN] * gap + [CLOSED] * 3 + [OPEN] * 3
    heights = [0.0] * 5 + [0.02] + [0.04] * 2 + [before] + [height] * (gap + 3) + [0.0] * 3
    tips = np.tile([0.0, 0.0, 0.02], (len(apart), 1))
    assert np.flatnonzero(picks(hand(apart), tips, [lifted(h) for h in heights], 0.06)).tolist() == list(held)


def test_an_empty_cloud_and_an_unknown_hand_neither_make_nor_break_a_pick():
    clouds, tips = [lifted(h) for h in RISING], AT_SHEET.copy()
    clouds[6], tips[7] = np.zeros((0, 3)), np.nan
    assert np.flatnonzero(picks(hand(ACTS), tips, clouds, 0.06)).tolist() == [4, 5, 6, 7, 8]


def test_the_open_hand_that_comes_for_a_pick_does_not_handle_and_pushes_stay():
    touching = np.array([0, 1, 1, 0, 0, 1, 1, 1, 0, 1], bool)
    holds = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 0], bool)
    assert with_picks(touching, holds).astype(int).tolist() == [0, 1, 1, 0, 0, 0, 1, 1, 1, 0]


def keypoints(path: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """A pinching hand's [F, 21, 3] (m): its tips meet on a path [F, 3], and it points where it is turned to [F] (rad)."""
    shape = np.zeros((21, 3))
    shape[[5, 9, 13]], shape[0] = [[-0.02, 0.02, 0.08], [-0.02, 0, 0.08], [-0.02, -0.02, 0.08]], [-0.11, 0, 0.10]
    c, s, zero, one = np.cos(turns), np.sin(turns), np.zeros_like(turns), np.ones_like(turns)
    turning = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    return path[:, None] + shape @ turning.transpose(0, 2, 1)


def test_the_pinch_goes_with_the_knuckles_where_fingertips_are_hidden():
    steps = np.linspace(0, 1, 9)[:, None]
    path = steps * [0.2, -0.1, 0.0] + [0.0, 0.0, 0.01]
    hand = keypoints(path, steps[:, 0])
    hand[3:, [4, 8, 12]] += [0.0, 0.0, 0.04]  # looked for on the hand, which hides them
    hand[6, 9] = np.nan
    pushing = hand[:, [8, 12]].mean(1)
    holds = np.arange(9) >= 1
    found = held_points(hand, pushing, holds)
    known = [1, 2, 3, 4, 5, 7, 8]
    np.testing.assert_allclose(found[known], path[known], atol=1e-3)
    np.testing.assert_array_equal(found[[0, 6]], pushing[[0, 6]])
    np.testing.assert_array_equal(held_points(hand, pushing, np.zeros(9, bool)), pushing)
    hand[:, 4] = np.nan
    np.testing.assert_array_equal(held_points(hand, pushing, holds), pushing)


def dome(height: float, at: float) -> np.ndarray:
    """The sheet with a hill so high, so far along x (m)."""
    raised = SHEET.copy()
    raised[:, 2] = height * np.exp(-np.linalg.norm(SHEET[:, :2] - [at, 0], axis=1) / 0.04)
    return raised


def test_what_moves_is_told_from_what_an_arm_hides():
    whole, half = lifted(0.0), SHEET[SHEET[:, 0] < 0]
    assert moves([whole, half, whole, lifted(0.05), lifted(0.05)]).tolist() == [False, False, False, True, False]
    assert not moves([whole, whole[:0], whole]).any()


CARRIED = [*[dome(0.0, 0.0)] * 4, *[dome(0.08, 0.03 * k - 0.1) for k in range(1, 7)], *[dome(0.08, 0.08)] * 4]
"""Frames 4 to 9 move."""
ALONG = np.array([[0.03 * np.clip(f - 3, 0, 6) - 0.1, 0, 0.06] for f in range(len(CARRIED))])


@pytest.mark.parametrize("hidden", [OPEN, np.nan], ids=["looks open", "unseen"])
def test_a_pick_lasts_as_long_as_what_it_holds_is_on_its_way(hidden):
    apart = [OPEN] * 4 + [CLOSED] * 3 + [hidden] * 4 + [OPEN] * 3
    assert np.flatnonzero(picks(hand(apart), ALONG, CARRIED, 0.06)).tolist() == list(range(3, 10))


def test_a_hand_that_is_seen_closed_only_when_it_lays_down_has_lifted_before():
    apart = [OPEN] * 7 + [CLOSED] * 3 + [OPEN] * 4
    assert np.flatnonzero(picks(hand(apart), ALONG, CARRIED, 0.06)).tolist() == list(range(3, 10))
    low = [points * [1, 1, 0.25] for points in CARRIED]
    assert not picks(hand(apart), ALONG, low, 0.06).any()
