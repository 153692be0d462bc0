"""Flat garments as triangle meshes: outlines, even triangles inside them, and the thin closed shell that cameras see.

Pure geometry on NumPy arrays, everything deterministic; no physics here.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import Delaunay

from piegraph_cli.physics.springs import farthest_point_sample

_ROUNDS = 60
_BEZIER = np.linspace(0, 1, 25)[:, None]
_DENSE = 2000
_WALL_GAP = 0.6
"""Triangle edges between the outline and the first points inside it."""


@dataclass(frozen=True, eq=False)
class ClothMesh:
    """A flat cloth around the origin."""

    points: np.ndarray
    """[V, 2] vertices, metres; the first `rim` are the outline, counter-clockwise."""
    triangles: np.ndarray
    """[T, 3] counter-clockwise."""
    rim: int
    """How many vertices the outline has."""
    corners: tuple[int, ...]
    """Vertices of the outline at which two of its curves meet."""

    @property
    def areas(self) -> np.ndarray:
        """[T] area of each triangle, m2."""
        return np.abs(_doubled_areas(self.points, self.triangles)) / 2

    @cached_property
    def _around(self) -> np.ndarray:
        """[V, T] 1 where the triangle has the vertex."""
        around = np.zeros((len(self.points), len(self.triangles)))
        around[self.triangles, np.arange(len(self.triangles))[:, None]] = 1
        return around

    def shell_triangles(self) -> np.ndarray:
        """[2 T + 2 rim, 3] of the closed shell, facing outwards; its vertices are all of the top, then of the bottom."""
        count = len(self.points)
        here = np.arange(self.rim)
        after = (here + 1) % self.rim
        walls = [(here + count, after + count, after), (here + count, after, here)]
        return np.concatenate(
            [self.triangles, self.triangles[:, ::-1] + count, *(np.stack(wall, axis=-1) for wall in walls)]
        )

    def shell(self, nodes: np.ndarray, radius: float) -> np.ndarray:
        """Vertices [..., 2 V, 3] of the shell around nodes [..., V, 3] (m), `radius` (m) off along their normals."""
        first, second, third = (nodes[..., self.triangles[:, k], :] for k in range(3))
        normal = self._around @ np.cross(second - first, third - first)
        offset = radius * normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        return np.concatenate([nodes + offset, nodes - offset], axis=-2)

    def material_points(self, count: int) -> np.ndarray:
        """Weights [count, V] of the vertices in points spread evenly over the cloth, its rim and corners included.

        The farthest points first, among the rim and random ones from a fixed seed.
        """
        rng = np.random.default_rng(0)
        inner = _DENSE + 2 * count
        chosen = self.triangles[rng.choice(len(self.triangles), inner, p=self.areas / self.areas.sum())]
        u, v = np.sqrt(rng.random(inner)), rng.random(inner)
        weights = np.zeros((self.rim + inner, len(self.points)))
        weights[np.arange(self.rim), np.arange(self.rim)] = 1
        rows = self.rim + np.arange(inner)
        for k, share in enumerate((1 - u, u * (1 - v), u * v)):
            weights[rows, chosen[:, k]] = share
        flat = np.column_stack([weights @ self.points, np.zeros(len(weights))])
        return weights[farthest_point_sample(flat, count)]

    def weights_at(self, places: np.ndarray) -> np.ndarray:
        """Weights [P, V] of the vertices at places [P, 2] (m) of the flat cloth, each in the triangle it lies in."""
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        to, along, across = places[:, None] - a, b - a, c - a
        whole = _doubled_areas(self.points, self.triangles)
        second = (to[..., 0] * across[:, 1] - to[..., 1] * across[:, 0]) / whole
        third = (along[:, 0] * to[..., 1] - along[:, 1] * to[..., 0]) / whole
        shares = np.stack([1 - second - third, second, third], -1)
        inside = shares.min(-1).argmax(1)
        weights, row = np.zeros((len(places), len(self.points))), np.arange(len(places))
        weights[row[:, None], self.triangles[inside]] = shares[row, inside]
        return weights


def square_outline() -> list[np.ndarray]:
    """The unit square as four curves [K, 2], counter-clockwise."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return [np.array([corners[k], corners[(k + 1) % 4]]) for k in range(4)]


def tshirt_outline() -> list[np.ndarray]:
    """A T-shirt as wide and as long as the unit square, as curves [K, 2] between its corners, counter-clockwise."""
    side = np.concatenate([[[0.29, -0.5]], _bezier((0.28, -0.03), (0.275, 0.105), (0.35, 0.09)), [[0.42, 0.07]]])
    cuff = np.array([[0.42, 0.07], [0.5, 0.28]])
    shoulder = np.concatenate([[[0.5, 0.28]], _bezier((0.3, 0.41), (0.24, 0.455), (0.13, 0.5))])
    half_neck = _bezier((0.13, 0.5), (0.1, 0.4), (0.0, 0.4))
    neck = np.concatenate([half_neck, _mirrored(half_neck)[1:]])
    hem = np.array([[-0.29, -0.5], [0.29, -0.5]])
    return [hem, side, cuff, shoulder, neck, _mirrored(shoulder), _mirrored(cuff), _mirrored(side)]


def triangulate(outline: list[np.ndarray], size: float, edge: float) -> ClothMesh:
    """Fill an outline of curves [K, 2] in units of `size` (m) with triangles whose edges are about `edge` (m) long.

    Points start on a hexagonal grid and relax, each to the middle of its triangles; those of the outline stay.
    """
    pieces = [_resample(curve * size, edge) for curve in outline]
    rim = np.concatenate(pieces)
    corners = np.cumsum([0] + [len(piece) for piece in pieces[:-1]])
    points = np.concatenate([rim, _hexagons(rim, edge)])
    for _ in range(_ROUNDS):
        points[len(rim) :] = _middles(points, _fill(points, rim))[len(rim) :]
    return ClothMesh(points, _fill(points, rim), len(rim), tuple(corners.tolist()))


def _bezier(first: tuple, control: tuple, last: tuple) -> np.ndarray:
    a, b, c = (np.array(point) for point in (first, control, last))
    return (1 - _BEZIER) ** 2 * a + 2 * _BEZIER * (1 - _BEZIER) * b + _BEZIER**2 * c


def _mirrored(curve: np.ndarray) -> np.ndarray:
    return curve[::-1] * [-1, 1]


def _resample(curve: np.ndarray, edge: float) -> np.ndarray:
    """Points at even distances of about `edge` along a curve [K, 2], its last one left out."""
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    at = np.linspace(0, along[-1], max(1, round(along[-1] / edge)) + 1)[:-1]
    return np.column_stack([np.interp(at, along, curve[:, axis]) for axis in range(2)])


def _hexagons(rim: np.ndarray, edge: float) -> np.ndarray:
    """Points of a hexagonal grid, symmetric about x = 0, that lie well inside the rim."""
    low, high = rim.min(0), rim.max(0)
    rows = np.arange(low[1] + edge / 2, high[1], edge * math.sqrt(3) / 2)
    half = math.ceil(high[0] / edge)
    steps = np.arange(-half, half + 1)
    grid = np.concatenate(
        [np.column_stack([(steps + 0.5 * (k % 2)) * edge, np.full(len(steps), y)]) for k, y in enumerate(rows)]
    )
    return grid[_inside(rim, grid) & (_distance(rim, grid) > _WALL_GAP * edge)]


def _fill(points: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Delaunay triangles of the points whose middle is inside the rim, counter-clockwise as SciPy gives them."""
    triangles = Delaunay(points).simplices.astype(np.int64)
    return triangles[_inside(rim, points[triangles].mean(1))]


def _middles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area-weighted mean [V, 2] of the middles of the triangles around each point."""
    area = np.abs(_doubled_areas(points, triangles))
    middle, total = np.zeros_like(points), np.zeros(len(points))
    for k in range(3):
        np.add.at(middle, triangles[:, k], points[triangles].mean(1) * area[:, None])
        np.add.at(total, triangles[:, k], area)
    return middle / total[:, None]


def _doubled_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    u, v = points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _inside(rim: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points [P, 2] a polygon [K, 2] encloses, bool [P]: a ray to the right crosses it an odd number of times."""
    x, y = points[:, 0, None], points[:, 1, None]
    a, b = rim, np.roll(rim, -1, axis=0)
    spans = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
    return (spans & (x < (b[:, 0] - a[:, 0]) * (y - a[:, 1]) / rise + a[:, 0])).sum(1) % 2 == 1


def _distance(rim: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance [P] of points [P, 2] to a polygon's line [K, 2]."""
    edges = np.roll(rim, -1, axis=0) - rim
    relative = points[:, None] - rim
    along = np.clip((relative * edges).sum(-1) / (edges**2).sum(-1), 0, 1)
    return np.linalg.norm(relative - along[..., None] * edges, axis=-1).min(1)
