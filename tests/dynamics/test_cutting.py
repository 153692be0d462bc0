"""Strokes from a hand's path, and pairs from strokes."""

import numpy as np

from piegraph_cli.dynamics.cutting import cut_strokes, frame_pairs


def path(frames: int = 12) -> np.ndarray:
    return np.stack([np.arange(frames) * 0.01, np.zeros(frames), np.full(frames, 0.02)], 1)


def contact(*runs: tuple[int, int], frames: int = 12) -> np.ndarray:
    flags = np.zeros(frames, bool)
    for first, last in runs:
        flags[first : last + 1] = True
    return flags


def test_strokes_are_runs_of_contact_with_a_known_path():
    assert cut_strokes(path(), contact((0, 3), (6, 11)), 0.01).tolist() == [[0, 3], [6, 11]]
    lost = path()
    lost[8] = np.nan
    assert cut_strokes(lost, contact((6, 11)), 0.01).tolist() == [[6, 7], [9, 11]]


def test_short_strokes_and_no_contact_give_none():
    assert cut_strokes(path(), contact((2, 3)), 0.02).shape == (0, 2)
    assert cut_strokes(path(), contact(), 0.01).shape == (0, 2)


def test_pairs_lie_inside_the_stroke_apart_and_moving():
    pairs = frame_pairs(2, 5, path(), 2)
    assert pairs.tolist() == [[2, 4], [2, 5], [3, 5]]
    still = path()
    still[4] = still[2]
    assert frame_pairs(2, 5, still, 2).tolist() == [[2, 5], [3, 5]]
