"""Particles bent by hand: some are held at new places on the table, the others follow as springs let them."""

import numpy as np

from piegraph_cli.physics.rigid import moved_in_plane, planar_fit

ROUNDS = 30
"""Of fitting each particle's turn and solving for all places, which is as rigid as possible."""
HOLDS = (30.0, 3.0, 0.3, 0.03, 0.003)
"""How much a held particle weighs beside one spring: less is tried until springs keep their lengths."""
LENGTHS, KEPT = 60, 0.02
"""Rounds in which springs are given their lengths back, no place held, and the share of a length that may be missing then."""


def bend(
    rest: np.ndarray, pairs: np.ndarray, held: np.ndarray, places: np.ndarray, start: np.ndarray | None = None
) -> np.ndarray:
    """Particles [N, 3] (m) bent in the plane of the table, so that `held` [K] of them are at `places` [K, 2] (m).

    rest [N, 3] (m) and the springs' pairs [S, 2] say the shape; heights stay. Springs keep their lengths: a place that is
    out of reach is not reached. `start` [N, 3] (m), by default the rest moved onto the places, is what bending begins with.
    Source: Sorkine and Alexa (2007), as-rigid-as-possible deformation, in the plane with equal weights.
    """
    flat = np.asarray(rest, np.float64)[:, :2]
    places = np.asarray(places, np.float64)
    if start is None:
        motion = planar_fit(flat[held], places)
        now = moved_in_plane(flat, motion)
    else:
        now = np.array(start, np.float64)[:, :2]
    for hold in HOLDS:
        now = _as_rigid_as_possible(flat, pairs, held, places, now, hold)
        bent = _with_lengths(flat, pairs, now)
        if stretched_by(flat, pairs, bent) <= KEPT:
            break
    return np.column_stack([bent, rest[:, 2]]).astype(np.float32)


def _as_rigid_as_possible(
    flat: np.ndarray, pairs: np.ndarray, held: np.ndarray, places: np.ndarray, now: np.ndarray, hold: float
) -> np.ndarray:
    """Places [N, 2] (m) from the places `now`: turns of the particles, and places for these turns, in turn."""
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    edges = flat[second] - flat[first]
    laplacian = np.zeros((len(flat), len(flat)))
    np.add.at(laplacian, (first, second), -1.0)
    np.add.at(laplacian, (first, first), 1.0)
    laplacian[held, held] += hold
    inverse = np.linalg.inv(laplacian)
    pull = np.zeros_like(flat)
    pull[held] = hold * places
    for _ in range(ROUNDS):
        there = now[second] - now[first]
        cross = edges[:, 0] * there[:, 1] - edges[:, 1] * there[:, 0]
        turn = np.arctan2(
            np.bincount(first, cross, len(flat)), np.bincount(first, (edges * there).sum(1), len(flat))
        )  # of each particle with its springs
        both = np.stack([turn[first], turn[second]])
        cosine, sine = np.cos(both).mean(0), np.sin(both).mean(0)
        turned = np.column_stack([cosine * edges[:, 0] - sine * edges[:, 1], sine * edges[:, 0] + cosine * edges[:, 1]])
        right = pull.copy()
        np.add.at(right, first, -turned)
        now = inverse @ right
    return now


def _with_lengths(flat: np.ndarray, pairs: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Places [N, 2] in which springs have their lengths, near the given ones."""
    first, second = pairs.T
    lengths = np.linalg.norm(flat[second] - flat[first], axis=1)
    share = 1.0 / np.maximum(np.bincount(pairs.ravel(), minlength=len(flat)), 1)
    now = now.copy()
    for _ in range(LENGTHS):
        along = now[second] - now[first]
        length = np.linalg.norm(along, axis=1)
        move = ((length - lengths) / np.maximum(length, 1e-9))[:, None] * along
        np.add.at(now, first, share[first][:, None] * move)
        np.add.at(now, second, -share[second][:, None] * move)
    return now


def bent_by(rest: np.ndarray, particles: np.ndarray) -> float:
    """How far (m) particles [N, 3] are from the rest [N, 3] moved rigidly in the plane, root of the mean square."""
    moved = moved_in_plane(rest[:, :2], planar_fit(rest[:, :2], particles[:, :2]))
    return float(np.sqrt(((moved - particles[:, :2]) ** 2).sum(1).mean()))


def stretched_by(rest: np.ndarray, pairs: np.ndarray, particles: np.ndarray) -> float:
    """The largest change of a spring's length in the plane, as a share of it."""
    first, second = pairs.T
    before, after = (np.linalg.norm(p[second, :2] - p[first, :2], axis=1) for p in (rest, particles))
    return float((np.abs(after - before) / np.maximum(before, 1e-9)).max(initial=0.0))
