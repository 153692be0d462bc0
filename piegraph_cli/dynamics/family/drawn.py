"""What a family of objects gives: an object that is drawn, strokes of it, where they leave it, and its traits."""

from dataclasses import dataclass

import numpy as np

TRAITS = 4
"""Numbers that say of an object what its particles do not show; what each is, its family says."""


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
