"""Random outlines of things that lie on a table, and points inside of them."""

from collections.abc import Callable

import numpy as np

from piegraph_cli.dynamics.family.drawn import between, turned

SIZE = (0.05, 0.2)
"""Root of an outline's area [m], from, to."""
STRETCH = (0.6, 1.7)
"""Factors along one axis, from, to."""
_ROUND = 36
"""Corners of what is round."""


def _polygon(rng: np.random.Generator) -> np.ndarray:
    count = int(rng.integers(3, 9))
    angles = (np.arange(count) + rng.uniform(-0.35, 0.35, count)) * (2 * np.pi / count)
    return _polar(angles, rng.uniform(0.6, 1.0, count))


def _blob(rng: np.random.Generator) -> np.ndarray:
    angles, order = np.arange(_ROUND) * (2 * np.pi / _ROUND), np.arange(2, 6)
    waves = np.cos(angles[:, None] * order + rng.uniform(0, 2 * np.pi, 4))
    return _polar(angles, np.maximum(1 + waves @ (rng.normal(0, 0.35, 4) / order), 0.3))


def _waisted(rng: np.random.Generator) -> np.ndarray:
    """A bar whose long sides bend in or out."""
    x, width = np.linspace(-1, 1, _ROUND // 2), rng.uniform(0.3, 1.0)
    deep, steep = rng.uniform(-0.2, 0.5, 2), rng.uniform(1, 4)
    sides = [width * (1 - d * np.cos(np.pi / 2 * x) ** steep) for d in (deep if rng.random() < 0.5 else deep[[0, 0]])]
    return np.concatenate([np.column_stack([x, -sides[0]]), np.column_stack([x, sides[1]])[::-1]])


def _rectangle(rng: np.random.Generator) -> np.ndarray:
    half = between(rng, 0.15, 1.0)
    return np.array([[-1, -half], [1, -half], [1, half], [-1, half]])


def _stems(rng: np.random.Generator) -> np.ndarray:
    """A bar with stems: T, L, U, H, a cross, and what is between."""
    thick = rng.uniform(0.2, 0.6)

    def side(count: int) -> list[tuple[float, float]]:
        edges = np.sort(rng.uniform(-1, 1, 2 * count))
        edges = edges + np.linspace(-0.3, 0.3, 2 * count) if count else edges
        edges = np.clip(edges, -1, 1)
        high = rng.uniform(0.3, 1.4, count)
        return [p for k in range(count) for a, b in [edges[2 * k : 2 * k + 2]] for p in _stem(a, b, high[k])]

    above, below = side(int(rng.integers(1, 3))), side(int(rng.integers(0, 2)))
    top = [(x, thick + y) for x, y in above][::-1]
    bottom = [(x, -y) for x, y in below]
    return np.array([(-1.0, 0.0), *bottom, (1.0, 0.0), (1.0, thick), *top, (-1.0, thick)])


def _stem(left: float, right: float, high: float) -> list[tuple[float, float]]:
    return [(left, 0.0), (left, high), (right, high), (right, 0.0)]


def _polar(angles: np.ndarray, radius: np.ndarray) -> np.ndarray:
    return radius[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


KINDS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "polygons": _polygon,
    "blobs": _blob,
    "waisted bars": _waisted,
    "rectangles": _rectangle,
    "bars with stems (T, L, U, cross)": _stems,
}
"""What outlines there are, each as often as the others."""


def random_outline(rng: np.random.Generator) -> np.ndarray:
    """Corners [K, 2] (m) of an outline, in order, about the middle of its area."""
    kinds = list(KINDS.values())
    corners = kinds[int(rng.integers(len(kinds)))](rng)
    corners = turned(corners * [between(rng, *STRETCH), 1.0], rng.uniform(0, 2 * np.pi))
    area, middle = _area(corners)
    return (corners - middle) * (between(rng, *SIZE) / np.sqrt(abs(area)))


def _area(corners: np.ndarray) -> tuple[float, np.ndarray]:
    after = np.roll(corners, -1, 0)
    cross = corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]
    area = cross.sum() / 2
    return area, ((corners + after) * cross[:, None]).sum(0) / (6 * area)


def inside(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points [P, 2] lie inside an outline [K, 2]."""
    (x1, y1), (x2, y2) = corners.T, np.roll(corners, -1, 0).T
    x, y = points.T[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = ((y1 > y) != (y2 > y)) & (x < x1 + (y - y1) / (y2 - y1) * (x2 - x1))
    return crossed.sum(1) % 2 == 1


def filled(rng: np.random.Generator, corners: np.ndarray, count: int) -> np.ndarray:
    """Random points [count, 2] (m) inside an outline [K, 2] (m)."""
    low, high = corners.min(0), corners.max(0)
    found = np.zeros((0, 2))
    while len(found) < count:
        points = rng.uniform(low, high, (2 * count, 2))
        found = np.concatenate([found, points[inside(corners, points)]])
    return found[:count]


def along(corners: np.ndarray, step: float) -> np.ndarray:
    """Points [P, 2] on an outline [K, 2], at most `step` (m) apart."""
    return pieces(np.stack([corners, np.roll(corners, -1, 0)], 1), step)


def pieces(edges: np.ndarray, step: float) -> np.ndarray:
    """Points [P, 2] on the straight pieces [E, 2, 2] of an outline, from their first ends on, at most `step` (m) apart."""
    counts = np.ceil(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1) / step).astype(int).clip(1)
    parts = [a + (b - a) * np.arange(n)[:, None] / n for (a, b), n in zip(edges, counts, strict=True)]
    return np.concatenate(parts)
