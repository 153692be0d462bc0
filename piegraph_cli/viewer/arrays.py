"""What is drawn, as arrays: colours, thinned clouds, line segments, where to look from. Nothing here knows a browser."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.evaluation.metrics import SHAPE_RADIUS
from piegraph_cli.physics.springs import SpringGraph, build_springs
from piegraph_cli.viewer.pictures import Picture

MOST_POINTS = 20_000
"""Points of a cloud that are drawn; more are thinned."""

NEIGHBOURS = 2.2
"""How far apart joined particles are, in median distances to the nearest one."""

MOST_STRAIN = 0.1
"""Strain at which a spring's colour is full."""

SHORT, REST, LONG = (np.array(c, float) for c in ((33, 102, 172), (190, 190, 190), (214, 47, 39)))
"""Colours of springs that are pressed together, at rest, and stretched."""

NO_POINTS, NO_LINES = np.zeros((0, 3), np.float32), np.zeros((0, 2, 3), np.float32)

UNKNOWN = (150, 150, 150)
"""What no camera saw."""


def rgb(color: str) -> tuple[int, int, int]:
    """`#rrggbb` as three numbers in 0-255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def thinned(points: np.ndarray, most: int = MOST_POINTS) -> np.ndarray:
    """At most `most` of points [P, 3], evenly among them: clouds of a voxel grid are in its order."""
    step = -(-len(points) // most)
    return points[::step] if step > 1 else points


def cloud_colors(points: np.ndarray, pictures: Iterable[Picture]) -> np.ndarray:
    """A colour uint8 [P, 3] per point [P, 3] (m): that of the nearest camera whose mask it lies in, or any where none are.

    What no camera sees has the median of the others' colours.
    """
    colors = np.zeros((len(points), 3), np.uint8)
    nearest = np.full(len(points), np.inf)
    for picture in pictures:
        pixels, depth = picture.camera.project(points)
        columns, rows = (np.round(pixels / picture.reduced).T).astype(np.int64)
        height, width = picture.image.shape[:2]
        inside = (depth > 0) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height) & (depth < nearest)
        index = np.flatnonzero(inside)
        if picture.mask is not None:
            index = index[picture.mask[rows[index], columns[index]]]
        colors[index], nearest[index] = picture.image[rows[index], columns[index]], depth[index]
    seen = np.isfinite(nearest)
    colors[~seen] = np.median(colors[seen], axis=0) if seen.any() else UNKNOWN
    return colors


def spring_graph(positions: np.ndarray) -> SpringGraph:
    """Springs between neighbours among positions [N, 3] (m): as many as can be seen, however dense they lie."""
    if len(positions) < 2:
        return build_springs(positions, SHAPE_RADIUS)
    apart = np.median(cKDTree(positions).query(positions, k=2)[0][:, 1])
    return build_springs(positions, float(np.clip(NEIGHBOURS * apart, 1e-6, SHAPE_RADIUS)))


def strain_of(positions: np.ndarray, pairs: np.ndarray, rest_length: np.ndarray) -> np.ndarray:
    """Strain [S] of springs between `pairs` [S, 2] of positions [N, 3]: above 0 longer than at rest, below 0 shorter."""
    length = np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
    return length / np.maximum(rest_length, 1e-6) - 1


def strain_colors(strain: np.ndarray) -> np.ndarray:
    """A colour uint8 [S, 3] per strain [S]: blue shorter, grey at rest, red longer."""
    share = np.clip(np.abs(strain) / MOST_STRAIN, 0, 1)[:, None]
    end = np.where(strain[:, None] < 0, SHORT, LONG)
    return (REST + share * (end - REST)).round().astype(np.uint8)


def segments(positions: np.ndarray, pairs: np.ndarray | Sequence[tuple[int, int]]) -> np.ndarray:
    """Line segments [S, 2, 3] between pairs [S, 2] of positions [N, 3]; those with an end that is not finite are left out."""
    found = positions[np.asarray(pairs, np.int64).reshape(-1, 2)]
    return found[np.isfinite(found).all((1, 2))]


def view_on(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where to look from, and at what, so that points [P, 3] (m) fill much of the picture: from the front, above."""
    known = points[np.isfinite(points).all(1)]
    if not len(known):
        return np.array([0.0, -0.6, 0.5]), np.zeros(3)
    low, high = known.min(0), known.max(0)
    middle, size = (low + high) / 2, max(float(np.linalg.norm(high - low)), 0.1)
    return middle + 1.25 * size * np.array([0.1, -0.72, 0.69]), middle
