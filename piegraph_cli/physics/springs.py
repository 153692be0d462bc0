"""The spring graph of an object: which particles a spring joins, how stiff it may be, and how particles are chosen.

Pure geometry on NumPy arrays; the motion of the springs is in `simulation`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from piegraph_cli.errors import DataError, UsageError

_GAP = 1.3
"""Longest segment of a contour, times the longest gap that has to be bridged."""


@dataclass(frozen=True, eq=False)
class SpringGraph:
    """Springs between particles. Compared and hashed by identity, so that what is derived from it can be cached."""

    pairs: np.ndarray
    """[S, 2] int64, the two particles of each spring, smaller index first, sorted."""
    rest_length: np.ndarray
    """[S] float64, metres."""
    particles: int
    """How many particles the springs join."""
    contour: np.ndarray | None = None
    """[E, 2] int64, the ends of the segments that a pusher touches: see `contour`; None where it touches particles alone."""

    @cached_property
    def touched(self) -> np.ndarray:
        """The contour; a particle alone is a segment of no length."""
        return np.arange(self.particles)[:, None].repeat(2, 1) if self.contour is None else self.contour

    @cached_property
    def largest_eigenvalue(self) -> float:
        """Largest eigenvalue of the graph Laplacian with unit stiffness (dimensionless); 0 without springs."""
        if len(self.pairs) == 0:
            return 0.0
        laplacian = np.zeros((self.particles, self.particles))
        first, second = self.pairs.T
        laplacian[first, second] = laplacian[second, first] = -1.0
        laplacian[np.arange(self.particles), np.arange(self.particles)] = -laplacian.sum(axis=1)
        return float(np.linalg.eigvalsh(laplacian)[-1])


def build_springs(positions: np.ndarray, radius: float) -> SpringGraph:
    """Join particles at most `radius` (m) apart by springs at rest, and what stays apart across its shortest gaps.

    positions: [N, 3] metres. The added springs are the edges of the minimum spanning tree that cross between
    parts, so every particle is connected to every other. Raises DataError for no or non-finite positions,
    UsageError for a radius that is not positive.
    Source: paper, III-D (springs by a distance threshold); the spanning tree is ours, since a thin or sparsely
    sampled object falls apart at any fixed threshold.
    """
    positions = np.asarray(positions, np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3 or len(positions) == 0:
        raise DataError(f"particle positions have shape {positions.shape}, expected [N, 3] with N at least 1")
    if not np.isfinite(positions).all():
        raise DataError(f"particle {int(np.argmin(np.isfinite(positions).all(axis=1)))} has a non-finite position")
    if not radius > 0:
        raise UsageError(f"spring radius is {radius} m", hint="a radius above 0, about twice the particle spacing")
    pairs = cKDTree(positions).query_pairs(radius, output_type="ndarray").astype(np.int64).reshape(-1, 2)
    pairs = np.concatenate([pairs, _bridges(positions, pairs)])
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    rest_length = np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
    return SpringGraph(pairs, rest_length, len(positions))


def contour(positions: np.ndarray) -> np.ndarray:
    """The segments [E, 2] between particles [N, 3] (m) that an upright disc touches: no gap is left that it slips into.

    Two particles are joined that have no other one in the circle between them, seen from above (Gabriel's graph), and
    are hardly further apart than gaps have to be for all to hang together: a longer segment would close a notch.
    """
    flat = np.asarray(positions, np.float64)[:, :2]
    square = cdist(flat, flat, "sqeuclidean")
    first, second = np.triu_indices(len(flat), 1)
    reach = _GAP**2 * minimum_spanning_tree(square).max() if len(flat) > 1 else 0.0
    near = square[first, second] <= reach
    first, second = first[near], second[near]
    around = square[first] + square[second] - square[first, second][:, None]
    around[np.arange(len(first)), first] = around[np.arange(len(first)), second] = np.inf
    open_pairs = np.stack([first, second], 1)[(around >= -1e-12).all(1)]
    alone = np.setdiff1d(np.arange(len(flat)), open_pairs)
    return np.concatenate([open_pairs, np.stack([alone, alone], 1)])


def _bridges(positions: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Pairs [K, 2] that join the connected components of `pairs` at the least total length."""
    count = len(positions)
    adjacency = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    components, label = connected_components(adjacency, directed=False)
    if components == 1:
        return np.zeros((0, 2), np.int64)
    distance = cdist(positions, positions)
    inside = label[:, None] == label[None]
    distance[inside] = 0.5 * distance[~inside].min()  # cheaper than any gap, yet an edge: SciPy drops lengths near 0
    first, second = minimum_spanning_tree(distance).nonzero()
    across = label[first] != label[second]
    return np.sort(np.stack([first[across], second[across]], axis=1).astype(np.int64), axis=1)


def stability_bound(graph: SpringGraph, damping: float, gain: float = 0.0) -> float:
    """Largest stable dimensionless stiffness α = k dt²/m of the semi-implicit step; infinite without springs.

    damping: δ in (0, 1]; gain: the proportional gain κ = Kp dt²/m that acts beside the springs. The bound is
    (2 (1 + δ)/δ − κ)/λmax: the fastest mode of the linear springs, `x'' = −(α λmax + κ) x`, then flips its sign every
    step without growing. Springs with a rest length are never stiffer than that.
    Source: paper, Eq. 3, with the new velocity moving the positions (the eigenvalues of that update).
    """
    if not 0 < damping <= 1:
        raise UsageError(f"damping is {damping}, expected above 0 and at most 1")
    if graph.largest_eigenvalue == 0:
        return float("inf")
    return (2 * (1 + damping) / damping - gain) / graph.largest_eigenvalue


def farthest_point_sample(points: np.ndarray, count: int, start: int = 0) -> np.ndarray:
    """Indices [count] of points [P, 3], each the farthest from all before it, beginning with index `start`.

    Any prefix is itself the sample of that size. Deterministic: ties go to the lower index. Raises DataError
    for fewer points than `count` or fewer than `count` distinct ones.
    """
    points = np.asarray(points, np.float64)
    if len(points) < count or count < 1:
        raise DataError(
            f"{len(points)} points, but {count} particles are to be chosen among them",
            hint="fewer particles, a finer voxel size, or a cloud that sees more of the object",
        )
    x, y, z = np.ascontiguousarray(points.T)
    chosen = np.empty(count, np.int64)
    chosen[0] = start
    nearest = np.full(len(points), np.inf)
    for k in range(1, count):
        last = chosen[k - 1]
        np.minimum(nearest, (x - x[last]) ** 2 + (y - y[last]) ** 2 + (z - z[last]) ** 2, out=nearest)
        chosen[k] = nearest.argmax()
        if not nearest[chosen[k]] > 0:
            raise DataError(f"only {k} distinct points, but {count} particles", hint="fewer particles")
    return chosen
