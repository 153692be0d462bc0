"""The particles that represent a cloud, and how large an object is by them. NumPy alone: nothing heavy is imported."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.errors import DataError
from piegraph_cli.physics.springs import farthest_point_sample

CROWD = 8  # neighbours by which a point counts as part of the object
STRAY = 2.5  # times the usual distance to them, beyond which it does not
ONE_SIDE = 1.45  # factor by which particles lie closer where fewer sides of the object are seen
THICKNESS = 0.01  # metres added to heights and widths before they are compared
BENDS = 1.15  # factor between the largest and the smallest length or width that an object had, from which it bends


def choose_particles(cloud: np.ndarray, count: int) -> np.ndarray:
    """The particles [count, 3] (m) that represent a cloud [P, 3]: spread by farthest points from the middle of it.

    Stray points, being the farthest, would all be chosen: those whose neighbours lie far beyond the usual distance are
    left out. No particle lies below the table. Raises DataError for too few points.
    """
    cloud = np.asarray(cloud, np.float64)
    if len(cloud) < count:
        raise DataError(f"{len(cloud)} points, but {count} particles are to be chosen among them")
    reach = cKDTree(cloud).query(cloud, k=min(CROWD, len(cloud)))[0].reshape(len(cloud), -1)[:, -1]
    kept = cloud[reach <= STRAY * np.median(reach)]
    kept[:, 2] = kept[:, 2].clip(min=0)
    middle = ((kept - kept.mean(axis=0)) ** 2).sum(axis=1).argmin()
    return kept[farthest_point_sample(kept, count, int(middle))]


def chamfer(one: np.ndarray, other: np.ndarray) -> float:
    """Sum of the two mean nearest-point distances (m) of clouds [N, 3] and [M, 3] (m). Source: paper, Table I."""
    there, back = cKDTree(other).query(one)[0], cKDTree(one).query(other)[0]
    return float(there.mean() + back.mean())


@dataclass(frozen=True)
class Size:
    """How large an object is by its particles, metres."""

    length: float
    """Longer side of the narrowest rectangle around it on the table."""
    width: float
    """The shorter side."""
    height: float
    """Of its highest particles above z = 0."""
    spacing: float
    """Mean distance of a particle from its nearest neighbour: what bending does not change."""


def size_of(particles: np.ndarray) -> Size:
    """The size of an object by its particles [N, 3] (m), N at least 2, spread as `choose_particles` does."""
    length, width = _rectangle(particles[:, :2].astype(float))
    spacing = cKDTree(particles).query(particles, k=2)[0][:, 1].mean()
    return Size(length, width, float(np.percentile(particles[:, 2], 95)), float(spacing))


def _rectangle(points: np.ndarray) -> tuple[float, float]:
    """Longer and shorter side of the rectangle of least area around points [N, 2]; one side lies along their hull."""
    ordered = points[np.lexsort(points.T[::-1])]
    corners = np.array(_chain(ordered) + _chain(ordered[::-1]))
    edges = np.roll(corners, -1, 0) - corners
    along = edges[np.linalg.norm(edges, axis=1) > 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], 1)
    sides = np.stack([np.ptp(corners @ axes.T, axis=0) for axes in (along, across)], 1)
    best = sides[sides.prod(1).argmin()] if len(sides) else np.zeros(2)
    return float(best.max()), float(best.min())


def _chain(points: np.ndarray) -> list[np.ndarray]:
    """One side of the convex hull of points [N, 2] in their order, without the last one. Source: Andrew (1979)."""
    kept: list[np.ndarray] = []
    for point in points:
        while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0:
            kept.pop()
        kept.append(point)
    return kept[:-1]


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


@dataclass(frozen=True)
class Sizes:
    """The sizes that one object has had, smallest and largest of each measure."""

    least: Size
    most: Size

    @classmethod
    def of(cls, states: Iterable[np.ndarray]) -> "Sizes":
        """Of an object in several states, particles [N, 3] (m) each."""
        rows = np.array([list(vars(size_of(state)).values()) for state in states])
        return cls(Size(*map(float, rows.min(0))), Size(*map(float, rows.max(0))))

    @classmethod
    def of_array(cls, rows: np.ndarray) -> "Sizes":
        """From what `array` gave."""
        return cls(*(Size(*map(float, row)) for row in rows))

    def array(self) -> np.ndarray:
        """[2, 4] metres: smallest and largest length, width, height and spacing."""
        return np.array([list(vars(size).values()) for size in (self.least, self.most)])

    @property
    def bends(self) -> bool:
        """Whether the object has been longer or wider at one time than at another."""
        return self.most.length > BENDS * self.least.length or self.most.width > BENDS * self.least.width

    def apart(self, size: Size, one_side: bool = False) -> dict[str, float]:
        """By which factor a size lies beyond what was seen, 1 for what lies within, for each measure.

        From `one_side` alone, as one camera sees it, an object is also less long and wide.

        What bends may become smaller and higher than it was seen, and as wide as it is long, but never longer. Particles of a
        simulated rope lie in its middle, one behind the other; those of a cloud lie around it.
        """
        least, most, line = vars(self.least).copy(), vars(self.most).copy(), self.least.width < THICKNESS
        if self.bends:
            most["height"] *= most["height"] / max(least["height"], 1e-6)
            least |= {"length": 0.0, "width": 0.0, "spacing": least["spacing"] ** 2 / most["spacing"]}
            most["width"] = max(most["length"], most["width"])
        if line:
            most["height"], most["spacing"] = 2 * self.most.height, float(np.hypot(most["spacing"], 2 * THICKNESS))
        least["spacing"] /= ONE_SIDE
        if one_side:
            least |= {name: least[name] / ONE_SIDE for name in ("length", "width")}
        found = {}
        for name, value in vars(size).items():
            more = THICKNESS if name in ("height", "width") else 0.0  # of flat and narrow things noise is a large share
            low, high = least[name] + more, most[name] + more
            found[name] = max(1.0, low / max(value + more, 1e-6), (value + more) / max(high, 1e-6))
        return found
