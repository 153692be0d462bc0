"""A sheet by its first frame: whether the object is one, and the net of triangles that stands for it.

A sheet is thin, lies flat on the table and extends two ways wherever one looks. Nothing here moves it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import Delaunay, cKDTree

from piegraph_cli.errors import DataError
from piegraph_cli.physics.particles import choose_particles

PARTICLES = 300
"""Nodes of the net."""
THIN, FLAT = 0.011, 0.03
"""Metres above the table: of half of a sheet's points at most, and of nearly all, folds being higher."""
AROUND, WIDE = 0.03, 0.45
"""Within how many metres of a point one looks how the object extends there, and how much less at least the second way."""
MOSTLY = 0.6
"""Share of the points about which a sheet must extend two ways; at its border it does less."""
LONG_EDGE, GAP = 2.6, 0.006
"""Edges longer than so many times the usual spacing, and triangles so far (m) from any point, bridge what is no sheet."""
SHORTER, BENDING = 0.2, 0.05
"""Stiffness of edges against being pushed together, and of bending; of being stretched it is 1."""


def is_sheet(cloud: np.ndarray) -> bool:
    """Whether a cloud [P, 3] (m, the table at z = 0) is a sheet that lies on the table."""
    z = cloud[:, 2]
    if len(cloud) < 4 * PARTICLES or np.median(z) > THIN or np.quantile(z, 0.95) > FLAT:
        return False
    some = cloud[:: max(1, len(cloud) // 200), :2]
    tree = cKDTree(cloud[:, :2])
    extents = []
    for near in tree.query_ball_point(some, AROUND):
        about = cloud[near, :2] - cloud[near, :2].mean(0)
        small, large = np.linalg.eigvalsh(about.T @ about)
        extents.append(np.sqrt(max(small, 0.0) / max(large, 1e-12)))
    return bool((np.array(extents) > WIDE).mean() > MOSTLY)


@dataclass(frozen=True, eq=False)
class SheetMesh:
    """A net of triangles in the middle of a sheet that lay flat."""

    points: np.ndarray
    """[N, 3] float32, metres: where they lie in the first frame."""
    half: float
    """Half of the sheet's thickness, metres."""
    triangles: np.ndarray
    """[T, 3] int32, counter-clockwise from above."""
    pairs: np.ndarray
    """[C, 2] int32: edges and, for bending, opposite corners of triangles that share one, in the order of solving."""
    rest: np.ndarray
    """[C] float32, metres."""
    pulls: np.ndarray
    """[C] float32: stiffness against being further apart."""
    pushes: np.ndarray
    """[C] float32: the same against being nearer."""

    @cached_property
    def around(self) -> csr_array:
        """[N, T] 1 where a triangle has the node."""
        count = len(self.triangles)
        where = self.triangles.ravel(), np.repeat(np.arange(count), 3)
        return csr_array((np.ones(3 * count, np.float32), where), shape=(len(self.points), count))

    def normals(self, x: np.ndarray) -> np.ndarray:
        """Unit normals [N, 3] of nodes at [N, 3] (m), upwards in the first frame."""
        a, b, c = (x[self.triangles[:, k]] for k in range(3))
        summed = self.around @ np.cross(b - a, c - a)
        return summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-12)

    def particles(self, x: np.ndarray) -> np.ndarray:
        """Points [N, 3] (m) on the sheet's upper face, which the first frame's cloud shows."""
        return x + self.half * self.normals(x)


def sheet_mesh(cloud: np.ndarray, particles: int) -> SheetMesh:
    """The net of a sheet's first cloud [P, 3] (m), of at least so many nodes; the first ones are `choose_particles`'.

    Raises `DataError` for a cloud of too few points, or that is no surface.
    """
    top = choose_particles(cloud, max(PARTICLES, particles))
    half = float(np.clip(np.median(top[:, 2]) / 2, 0.0005, THIN))
    points = (top - [0, 0, half]).astype(np.float32)
    points[:, 2] = points[:, 2].clip(min=half)
    triangles = _triangles(top[:, :2], cloud[:, :2])
    if len(triangles) < len(points) / 2:
        raise DataError("the object's points make no surface", hint="track it as a solid: track.object=solid")
    edges, bends = _edges(triangles)
    order = np.random.default_rng(0).permutation(len(edges) + len(bends))
    pairs = np.concatenate([edges, bends])
    rest = np.linalg.norm(top[pairs[:, 0], :2] - top[pairs[:, 1], :2], axis=1)
    pulls, pushes = (np.repeat([k, BENDING], [len(edges), len(bends)]) for k in (1.0, SHORTER))
    values = (values[order].astype(np.float32) for values in (rest, pulls, pushes))
    return SheetMesh(points, half, triangles, pairs[order].astype(np.int32), *values)


def _triangles(flat: np.ndarray, cloud: np.ndarray) -> np.ndarray:
    """Triangles [T, 3] of points [N, 2] that lie on what a cloud [P, 2] covers, counter-clockwise."""
    triangles = Delaunay(flat).simplices
    corners = flat[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(1)
    spacing = np.median(cKDTree(flat).query(flat, k=2)[0][:, 1])
    gaps = cKDTree(cloud).query(corners.mean(1))[0]
    kept = triangles[(sides < LONG_EDGE * spacing) & (gaps < GAP)]
    a, b, c = (flat[kept[:, k]] for k in range(3))
    u, v = b - a, c - a
    clockwise = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    kept[clockwise] = kept[clockwise][:, ::-1]
    return kept.astype(np.int32)


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges [E, 2], and opposite corners [B, 2] of triangles that share one."""
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    across = np.concatenate([triangles[:, (k + 2) % 3] for k in range(3)])
    edges, number = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    number = number.ravel()
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(number[order][1:] == number[order][:-1])
    return edges, np.stack([across[order[same]], across[order[same + 1]]], 1)
