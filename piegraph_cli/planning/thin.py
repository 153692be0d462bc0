"""Where particles of a thin thing, a rope, belong in a goal cloud: as far along it as they are now, counted from either end.

Nearest points do not tell how a rope lies along a goal, and the best assignment of points may shuffle half of it over an
end that lies near. What is found here does.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from piegraph_cli.planning.goals import thinned

POINTS, NEIGHBOURS, NEAR = 500, 8, 0.03
"""Points of a cloud that are joined to their nearest ones, how many, and how far away (m) at most."""
CELLS = 24
"""Parts along a thing, of which each has a middle."""
THIN = 10.0
"""Times as long as it is wide, from which a thing is thin."""
LIKE = 1.12
"""Factor between the lengths of one thing now and in the goal; where it is more, parts of it touch in one of them."""


@dataclass(frozen=True)
class Line:
    """The middle line of a thin cloud."""

    middles: np.ndarray
    """[CELLS, 3] metres, from one end to the other."""
    length: float
    """Metres."""
    points: np.ndarray
    """[P, 3] metres: those of the cloud that it is of."""
    along: np.ndarray
    """[P] in 0..1: how far along it they are."""

    def at(self, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places [N, 3] (m) and headings [N] (rad) of the line at shares [N] of its length."""
        cells = (np.arange(CELLS) + 0.5) / CELLS
        places = np.stack([np.interp(share, cells, self.middles[:, k]) for k in range(3)], -1)
        ahead = np.gradient(self.middles, axis=0)
        way = np.stack([np.interp(share, cells, ahead[:, k]) for k in range(2)], -1)
        return places, np.arctan2(way[:, 1], way[:, 0])

    def share_of(self, particles: np.ndarray) -> np.ndarray:
        """How far along it particles [N, 3] (m) are: [N] in 0..1."""
        return self.along[cKDTree(self.points).query(particles)[1]]


def line_of(cloud: np.ndarray) -> Line | None:
    """The line of a cloud [P, 3] (m); None where it is not thin, or not in one piece."""
    points = thinned(np.asarray(cloud, float), POINTS)
    apart, near = cKDTree(points).query(points, NEIGHBOURS + 1, distance_upper_bound=NEAR)
    row, column = np.nonzero(np.isfinite(apart))
    graph = csr_array((apart[row, column] + 1e-9, (row, near[row, column])), (len(points), len(points)))
    from_middle = dijkstra(graph, directed=False, indices=0)
    if not np.isfinite(from_middle).all():
        return None
    walked = dijkstra(graph, directed=False, indices=int(from_middle.argmax()))
    length = float(walked.max())
    along = walked / length
    cell = np.minimum((along * CELLS).astype(int), CELLS - 1)
    count = np.bincount(cell, minlength=CELLS)
    if not count.all():
        return None
    middles = np.stack([np.bincount(cell, points[:, k], CELLS) for k in range(3)], -1) / count[:, None]
    line = Line(middles, length, points, along)
    width = 2 * np.linalg.norm(points - line.at(along)[0], axis=1).mean()
    return line if length > THIN * width else None


def places_along(goal: Line | None, cloud: np.ndarray, particles: np.ndarray) -> np.ndarray | None:
    """The particles [2, N, 3] float32 (m) in a goal, from either end; now they are `particles` [N, 3] of `cloud` [P, 3] (m).

    None where thing or goal is not thin, or one of them touches itself.
    """
    now = line_of(cloud) if goal is not None else None
    if goal is None or now is None or max(now.length / goal.length, goal.length / now.length) > LIKE:
        return None
    share = now.share_of(particles)
    middle, heading = now.at(share)
    found = []
    for other, back in ((share, 0.0), (1 - share, np.pi)):
        place, there = goal.at(other)
        turn = there - heading + back
        x, y, z = (particles - middle).T
        aside = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], -1)
        found.append(place + aside)
    return np.array(found, np.float32)
