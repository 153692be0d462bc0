"""What a family of objects gives: an object that is drawn, strokes of it, where they leave it, and its traits."""

import math
from dataclasses import dataclass

import numpy as np

TRAITS = 4
"""Numbers that say of an object what its particles do not show; what each is, its family says."""
TOUCHING = 0.4
"""Share of strokes that begin where they touch."""
AWAY = 0.08
"""Farthest that the others begin from there [m]."""
ALIKE, AROUND = 0.7, (0.4, 1.2)
"""Share of simulated strokes that are like those of a recording, and by which factors they differ, from, to."""


@dataclass(frozen=True)
class Drawn:
    """Strokes [S] of one object that was drawn at random."""

    rest: np.ndarray
    """[N, 3] metres."""
    before: np.ndarray
    """[S, N, 3] metres."""
    after: np.ndarray
    """[S, N, 3] metres."""
    start: np.ndarray
    """[S, 2] metres."""
    end: np.ndarray
    """[S, 2] metres."""
    mode: np.ndarray
    """[S] 0 push, 1 pick."""
    held: np.ndarray
    """[S, 2] bool: whether a pick holds the object already at its start, and still at its end."""
    traits: np.ndarray
    """[TRAITS], each about between -2 and 2, 0 in the middle of what is drawn."""


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number, even in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points [..., 2] turned about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def first_touch(points: np.ndarray, heading: float, aside: float, reach: float) -> float:
    """How far (m) along the line with this heading, `aside` (m) to the left of the origin, a disc first touches points [P, 2].

    Infinite where it passes them.
    """
    x, y = turned(points, -heading).T
    across = np.abs(y - aside)
    near = across < reach
    return float((x[near] - np.sqrt(reach**2 - across[near] ** 2)).min(initial=np.inf))


def random_strokes(
    rng: np.random.Generator,
    rim: np.ndarray,
    reach: np.ndarray,
    lengths: tuple[float, float],
    like: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends [S, 2] (m) of strokes from anywhere by pushers with these radii [S] (m).

    Their lines touch the outline's points [P, 2] (m), or just miss them. Most begin as far from there, and go on for as
    long, as one of `like` [K, 2] (m); the others are as long as `lengths` (m) say, from, to.
    """
    starts, ends = [], []
    for radius in reach.tolist():
        heading, length = rng.uniform(0, 2 * np.pi), between(rng, *lengths)
        x, across = turned(rim, -heading).T
        aside = rng.uniform(across.min() - 1.3 * radius, across.max() + 1.3 * radius)
        touch = first_touch(rim, heading, aside, radius)
        if not math.isfinite(touch):
            touch = x.min() + rng.uniform(0, 0.05)
        start = touch if rng.random() < TOUCHING else touch - rng.uniform(0, min(AWAY, length))
        if like is not None and rng.random() < ALIKE:
            free, pushing = like[rng.integers(len(like))] * rng.uniform(*AROUND, 2)
            start, length = touch - free, max(free + pushing, lengths[0])
        starts.append(turned(np.array([start, aside]), heading))
        ends.append(turned(np.array([start + length, aside]), heading))
    return np.array(starts), np.array(ends)
