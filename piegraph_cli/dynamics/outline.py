"""The outline of a rigid body: of its particles, by an alpha shape, or as a drawing gives it, laid on them."""

import bisect
import math
from collections.abc import Callable

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from piegraph_cli.errors import DataError
from piegraph_cli.physics.rigid import moved_in_plane

JOINED = 0.95
"""Share of the points that an outline holds."""
COVERED = 1.3
"""Times as far as joins the particles that a part of the body may be from the nearest of them."""
FLAT = 1e-4
"""Metres off a line below which points have no area."""
FILLED = 400
"""Points that stand for the area of an outline that is given, about."""
YAWS, FINISHED = 24, 6
"""Turns in which an outline is first laid on the particles, and how many of them are refined."""
OUTSIDE = 10.0
"""What a particle outside of the outline weighs, against a part of the outline without a particle."""
SCALE = 1.25
"""Times that outline and particles may differ in size."""
BARE, BEYOND = 1.7, 0.03
"""Spacings of particles without one, and share of the outline's size outside of it, that are too far; at least `ROUGH`."""
ROUGH = 0.004
"""Metres that tracked particles are expected to be off."""
WRONG = 0.1
"""Share of the outline or of the particles that is too far where the outline is another body's."""
NO_AREA = ("the particles span no area: no outline", "", "a rigid body lies flat; train another model")
OUTLINE = "outline"
"""Where an error is that is about an outline that is given."""
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 39.37}


def outline_of(points: np.ndarray, alpha: float) -> np.ndarray:
    """Ends [E, 4] (m) of the pieces of the outline of points [N, 2] (m): the edges of an alpha shape.

    Triangles between points belong to it whose circumradius is at most `alpha` times the least with which they join nearly
    all points into one. Raises `DataError` for points that have no area.
    """
    mesh, radius = _mesh(points, _circumradius)
    return _border(points, mesh.simplices[radius <= alpha * _joining(mesh.simplices, radius, len(points))])


def _mesh(points: np.ndarray, width: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[Delaunay, np.ndarray]:
    """Triangles between points, and how wide (m) [T] each is. Raises `DataError` for points that have no area."""
    if len(points) < 3 or np.linalg.svd(points - points.mean(0), compute_uv=False)[-1] < FLAT:
        raise DataError(*NO_AREA)
    mesh = Delaunay(points)
    return mesh, width(points, mesh.simplices)


def _joining(triangles: np.ndarray, width: np.ndarray, count: int) -> float:
    """The least width (m) up to which triangles join nearly all of so many points into one."""
    ordered = np.sort(width)
    enough = bisect.bisect_left(ordered, True, key=lambda limit: _joined(triangles[width <= limit], count))
    if enough == len(ordered):
        raise DataError(*NO_AREA)
    return float(ordered[enough])


def _border(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Ends [E, 4] (m) of the sides that one of the triangles [T, 3] has alone."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    pairs, times = np.unique(edges, axis=0, return_counts=True)
    return points[pairs[times == 1]].reshape(-1, 4)


def covered_outline(points: np.ndarray) -> np.ndarray:
    """Ends [E, 4] (m) of the pieces of the outline of points [N, 2] (m) that lie evenly in a body, some on its edge.

    Of the triangles between points those belong to it that have nothing farther from a corner than `COVERED` times what
    joins nearly all points into one, and what these enclose. Raises `DataError` for points that have no area.
    """
    mesh, width = _mesh(points, _cover)
    open_sides = width > COVERED * _joining(mesh.simplices, width, len(points))
    outside = open_sides & (mesh.neighbors < 0).any(1)
    while True:
        beside = open_sides & ~outside & ((mesh.neighbors >= 0) & outside[mesh.neighbors]).any(1)
        if not beside.any():
            return _border(points, mesh.simplices[~outside])
        outside |= beside


def _cover(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How far (m) what lies in triangles [T, 3] between points [N, 2] is from their nearest corners, at most."""
    corners = points[triangles]
    a, b, c = np.sort(np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2), axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        blunt = np.maximum(a * a / (a * a + c * c - b * b), b * b / (b * b + c * c - a * a)) * c
    return np.where(c * c > a * a + b * b, blunt, _circumradius(points, triangles))


def _circumradius(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Of triangles [T, 3] between points [N, 2] (m), metres."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    sides = [np.linalg.norm(u - v, axis=1) for u, v in ((b, c), (a, c), (a, b))]
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    return np.prod(sides, axis=0) / np.maximum(4 * area, 1e-12)


def _joined(triangles: np.ndarray, count: int) -> bool:
    """Whether triangles join nearly all of so many points into one."""
    i, j = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]]).T
    parts = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(count, count)), directed=False)[1]
    return bool(np.bincount(parts).max() >= JOINED * count)


def laid_on(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Corners [K, 2] (m) of an outline in any place and turn, laid on the particles [N, 2] (m) of its body.

    Particles are to lie inside, and every part of the inside is to have one near. Raises `DataError` where the outline is
    of another size or shape; one that fits mirrored alone is told.
    """
    _check_size(corners, points)
    laid, _ = _best(corners, points)
    wrong = _misfit(laid, points)
    if wrong:
        mirrored = _misfit(_best(corners * [1, -1], points)[0], points)
        hint = "an outline is seen from above: turn its y over" if not mirrored else "give the outline of this body"
        raise DataError(f"the outline is not that of the particles: {wrong}", OUTLINE, hint)
    return laid


def edges_of(corners: np.ndarray) -> np.ndarray:
    """Ends [K, 4] (m) of the pieces between corners [K, 2]."""
    return np.hstack([corners, np.roll(corners, -1, 0)])


def _check_size(corners: np.ndarray, points: np.ndarray) -> None:
    """By how far from their middles the outline's inside and the particles are, which does not tell turns apart."""
    size, other = (float(np.sqrt(np.square(x - x.mean(0)).sum(1).mean())) for x in (_filled(corners), points))
    ratio = size / max(other, 1e-9)
    if 1 / SCALE < ratio < SCALE:
        return
    unit = next((name for name, times in UNITS.items() if 1 / SCALE < ratio / times < SCALE), None)
    message = f"the outline measures {_measures(corners)}, the particles {_measures(points)}"
    raise DataError(
        message, hint=f"give metres: these are {unit}" if unit else "give the outline of this body, in metres"
    )


def _measures(points: np.ndarray) -> str:
    _, sides, _ = cv2.minAreaRect(points.astype(np.float32))
    low, high = sorted(1e3 * side for side in sides)
    return f"{high:.0f} x {low:.0f} mm"


def _best(corners: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, float]:
    """The corners where they fit the points best, and the cost (m^2) there."""
    inside = _filled(corners)
    middle, tree = inside.mean(0), cKDTree(points)

    def cost(pose: np.ndarray) -> float:
        bare = tree.query(moved_in_plane(inside - middle, pose))[0]
        back = moved_in_plane(points - pose[:2], np.array([*middle, -pose[2]]))
        return float(np.square(bare).mean() + OUTSIDE * np.square(np.maximum(_outside(corners, back), 0)).mean())

    starts = [np.array([*points.mean(0), yaw]) for yaw in np.arange(YAWS) * (2 * math.pi / YAWS)]
    scale = np.array([0.01, 0.01, 0.1])
    settings = {"xatol": 1e-3, "fatol": 1e-10, "maxiter": 400}
    found = [
        minimize(lambda x: cost(x * scale), pose / scale, method="Nelder-Mead", options=settings)
        for pose in sorted(starts, key=cost)[:FINISHED]
    ]
    best = min(found, key=lambda result: result.fun)
    return moved_in_plane(corners - middle, best.x * scale), float(best.fun)


def _misfit(corners: np.ndarray, points: np.ndarray) -> str:
    """What is wrong with an outline where it lies, in words; "" where nothing is."""
    inside = _filled(corners)
    spacing = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
    bare = float((cKDTree(points).query(inside)[0] > max(BARE * spacing, ROUGH)).mean())
    size = float(np.ptp(corners, axis=0).max())
    beyond = float((_outside(corners, points) > max(BEYOND * size, ROUGH)).mean())
    if beyond > WRONG:
        return f"{beyond:.0%} of them lie outside of it"
    return f"{bare:.0%} of its inside has none near" if bare > WRONG else ""


def _filled(corners: np.ndarray) -> np.ndarray:
    """Points [P, 2] on a grid inside of an outline."""
    low, high = corners.min(0), corners.max(0)
    step = math.sqrt(float(np.prod(high - low)) / FILLED)
    grid = np.stack(np.meshgrid(*(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))), -1)
    points = grid.reshape(-1, 2)
    return points[_outside(corners, points) < 0]


def _outside(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far (m) [P] points [P, 2] are outside of an outline; negative inside."""
    start, piece = corners, np.roll(corners, -1, 0) - corners
    apart = points[:, None] - start
    share = np.clip((apart * piece).sum(-1) / np.maximum((piece * piece).sum(-1), 1e-18), 0, 1)
    distance = np.linalg.norm(apart - share[..., None] * piece, axis=-1).min(1)
    (x1, y1), dx, dy = start.T, piece[:, 0], piece[:, 1]
    spans = (y1 > points[:, 1:]) != (y1 + dy > points[:, 1:])
    left = points[:, :1] < x1 + (points[:, 1:] - y1) / np.where(dy == 0, 1.0, dy) * dx
    return np.where((spans & left).sum(1) % 2 == 1, -distance, distance)
