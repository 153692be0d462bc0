"""Strokes from a hand's path, and pairs from strokes."""

import numpy as np
import pytest

from piegraph_cli.dynamics.cutting import cut_strokes, frame_pairs, straight_pieces


def path(frames: int = 12) -> np.ndarray:
    return np.stack([np.arange(frames) * 0.01, np.zeros(frames), np.full(frames, 0.02)], 1)


def contact(*runs: tuple[int, int], frames: int = 12) -> np.ndarray:
    flags = np.zeros(frames, bool)
    for first, last in runs:
        flags[first : last + 1] = True
    return flags


def cut(hand: np.ndarray, touching: np.ndarray, min_length: float = 0.01, max_bend: float = 0.025) -> list[list[int]]:
    return cut_strokes(hand, touching, min_length, max_bend).strokes.tolist()


def test_strokes_are_runs_of_contact_with_a_known_path():
    assert cut(path(), contact((0, 3), (6, 11)), 0.01) == [[0, 3], [6, 11]]
    lost = path()
    lost[8] = np.nan
    assert cut(lost, contact((6, 11)), 0.01) == [[6, 7], [9, 11]]


def test_short_strokes_and_no_contact_give_none():
    assert cut(path(), contact((2, 3)), 0.02) == []
    assert cut(path(), contact(), 0.01) == []


def test_pairs_lie_inside_the_stroke_apart_and_moving():
    pairs = frame_pairs(2, 5, path(), 2)
    assert pairs.tolist() == [[2, 4], [2, 5], [3, 5]]
    still = path()
    still[4] = still[2]
    assert frame_pairs(2, 5, still, 2).tolist() == [[2, 5], [3, 5]]


def test_a_stroke_too_short_for_the_gap_gives_its_first_and_last_frame():
    assert frame_pairs(3, 4, path(), 2).tolist() == [[3, 4]]
    assert frame_pairs(3, 5, path(), 4).tolist() == [[3, 5]]
    assert frame_pairs(3, 3, path(), 2).tolist() == []


def polyline(*corners: tuple[float, float], step: float = 0.01) -> np.ndarray:
    """A path [F, 2] that goes from corner to corner, `step` metres a frame."""
    rows = [np.array(corners[0])[None]]
    for a, b in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
        share = np.arange(1, round(np.linalg.norm(b - a) / step) + 1) * step / np.linalg.norm(b - a)
        rows.append(a + share[:, None] * (b - a))
    return np.concatenate(rows)


def longest_stray(points: np.ndarray, pieces: list[tuple[int, int]]) -> float:
    """The largest distance (m) from a point of a piece to the line through its ends."""
    found = 0.0
    for first, last in pieces:
        along = points[last] - points[first]
        offset = points[first : last + 1] - points[first]
        found = max(found, np.abs(offset @ np.array([-along[1], along[0]]) / np.linalg.norm(along)).max())
    return found


@pytest.mark.parametrize(
    ("points", "cuts"),
    [
        (polyline((0, 0), (0.3, 0)), []),
        (polyline((0, 0), (0.15, 0), (0.15, 0.15)), [15]),
        (polyline((0, 0), (0.12, 0), (0.02, 0.0)), [12]),
        (polyline((0, 0), (0.15, 0), (0.09, 0.001), (0.25, 0.002)), [15, 21]),
        (polyline((0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1), (0, 0)), [10, 20, 30]),
    ],
    ids=["straight", "corner", "out and back", "back and forth along the chord", "closed loop"],
)
def test_a_path_is_cut_where_it_bends_and_where_it_turns_back(points, cuts):
    pieces = straight_pieces(points, 0.025)
    assert [first for first, _ in pieces[1:]] == pytest.approx(cuts, abs=1)
    assert [last for _, last in pieces[:-1]] == [first for first, _ in pieces[1:]]
    assert (pieces[0][0], pieces[-1][1]) == (0, len(points) - 1)


def test_a_curve_becomes_pieces_within_the_tolerance():
    angle = np.linspace(0, 1.5 * np.pi, 60)
    points = 0.1 * np.stack([np.cos(angle), np.sin(angle)], 1)
    coarse, fine = (straight_pieces(points, tolerance) for tolerance in (0.025, 0.008))
    assert 1 < len(coarse) < len(fine)
    assert longest_stray(points, coarse) < 0.027
    assert longest_stray(points, fine) < 0.010


@pytest.mark.parametrize("seed", range(10))
def test_the_trembling_of_a_tracked_hand_cuts_nothing(seed):
    """Noise of 10 mm in each frame, as in the sample."""
    points = np.stack([np.linspace(0, 0.1, 11), np.zeros(11)], 1)
    noisy = points + np.random.default_rng(seed).normal(0, 0.010, points.shape)
    assert straight_pieces(noisy, 0.025) == [(0, 10)]


def test_a_bent_push_becomes_several_strokes_and_short_pieces_are_counted():
    corner = polyline((0, 0), (0.15, 0), (0.15, 0.15), (0.15, 0.15))
    hand = np.concatenate([corner, np.zeros((len(corner), 1))], 1)
    found = cut_strokes(hand, np.ones(len(hand), bool), 0.01, 0.025)
    assert found.strokes.tolist() == [[0, 15], [15, 30]]
    assert (found.run.tolist(), found.bent, found.pieces, found.short) == ([0, 0], 1, 2, 0)
    hooked = polyline((0, 0), (0.15, 0), (0.15, 0.15), (0.12, 0.15))
    hand = np.concatenate([hooked, np.zeros((len(hooked), 1))], 1)
    found = cut_strokes(hand, np.ones(len(hand), bool), 0.05, 0.025)
    assert (len(found.strokes), found.bent, found.pieces, found.short) == (2, 1, 3, 1)
    whole = cut_strokes(hand, np.ones(len(hand), bool), 0.05, np.inf)
    assert (whole.strokes.tolist(), whole.bent, whole.pieces) == ([[0, len(hand) - 1]], 0, 0)
