"""What comes onto the table and is not the object, found in depth alone: the tip of a stick, or of a hand in a glove.

For recordings in which no hand can be found. What is new in a frame and stands higher than the object is not the object,
which may move along with it; from there the tip is looked for downwards.
"""

from collections.abc import Callable, Sequence

import numpy as np

from piegraph_cli.perception.clouds import flying_pixels, world_map
from piegraph_cli.perception.hands import fill_gaps, slow_chain
from piegraph_cli.recording.camera import Camera

LOOKS = 12
"""Frames, spread over the sequence, from which it is learnt what stays."""
STEP, STEP_PER_M2 = 0.012, 0.015
"""How much nearer (m) than what stays something new is, near and per squared metre of distance."""
EDGE = 0.02
"""Depth steps (m) above this one are edges: a stick is thin, so that smaller ones are on it."""
LOW = 0.008
"""Height (m) above the table from which something is not the table."""
VOXEL = 0.012
"""Edge (m) of the grid on which what is connected is found."""
CLEAR = 0.02
"""Height (m) above the object's top from which nothing is the object."""
TALL = 0.06
"""Metres of a stick that must show above that height."""
SIDE = 0.785
"""How far a round stick's surface lies before its axis on average over what a camera sees of it, in radii: pi / 4."""
BESIDE = 0.008
"""Metres beside a stick's surface at which points are still its own."""
GAP = 0.025
"""Metres along a stick without a point at which it ends."""
ABOVE = 0.008
"""Height (m) above the object's top from which it is the hand."""
FINGER = 0.02
"""Metres of fingers of which a direction is taken."""
FEWEST_OF_HAND, STRAY = 50, 10
"""Points above the object that are a hand; how many of them may be stray ones below it."""
FEWEST = 25
"""Points of a stick's upper part that tell its axis."""


TipOf = Callable[[Sequence[np.ndarray], Sequence[np.ndarray], float], np.ndarray]
"""The tip [3] (m, NaN unknown) from each camera's points [P, 3] of what is new, the cameras' centres and the object's top."""


def find_tips(
    depths: Sequence[Sequence[np.ndarray]],
    cameras: Sequence[Camera],
    workspace: np.ndarray,
    times: np.ndarray,
    tip_of: TipOf,
    *,
    max_gap: float,
    max_speed: float = 2.5,
) -> tuple[np.ndarray, np.ndarray]:
    """The tip [F, 3] (m, NaN unknown) of what comes in, as `tip_of` finds it, and in which frames [F] it was seen.

    `depths[camera][frame]` [H, W] in the camera's units; `workspace` [3, 2] (m); `times` [F] (s). Tips that no hand could
    reach within `max_speed` (m/s) are dropped, gaps up to `max_gap` (s) filled. All unknown where no frame shows the table
    without it: then it cannot be told from what lies there.
    """
    rest = [resting_depth(own) for own in depths]
    origins = [camera.T_world_camera[:3, 3] for camera in cameras]
    top = object_top(depths, cameras, workspace)
    tips = np.full((len(times), 3), np.nan)
    for f in range(len(times)):
        tips[f] = tip_of([newcomers(own[f], rest[c], cameras[c]) for c, own in enumerate(depths)], origins, top)
    if np.isfinite(tips).all():
        return np.full_like(tips, np.nan), np.zeros(len(times), bool)
    tips[~slow_chain(tips, times, max_speed)] = np.nan
    return fill_gaps(tips[:, None], times, max_gap)[:, 0], np.isfinite(tips).all(axis=1)


def resting_depth(depths: Sequence[np.ndarray]) -> np.ndarray:
    """What stays in one camera: the farthest reading [H, W] of each pixel that comes more than once; 0 without one."""
    frames = np.unique(np.linspace(0, len(depths) - 1, LOOKS).round().astype(int))
    stack = np.sort(np.stack([depths[f] for f in frames]), axis=0)
    return stack[max(len(stack) - 2, 0)]


def object_top(depths: Sequence[Sequence[np.ndarray]], cameras: Sequence[Camera], workspace: np.ndarray) -> float:
    """The height (m) of the highest thing in the workspace in the frame in which that is least: then no stick is there."""
    frames = np.unique(np.linspace(0, len(depths[0]) - 1, LOOKS).round().astype(int))
    (x0, x1), (y0, y1) = np.asarray(workspace, float)[:2]
    tops = []
    for f in frames:
        heights = []
        for own, camera in zip(depths, cameras, strict=True):
            points = world_map(own[f], camera)[~flying_pixels(own[f], camera, EDGE)]
            x, y, z = points.T
            heights.append(z[(x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > LOW)])
        every = np.concatenate(heights)
        tops.append(float(np.percentile(every, 99)) if len(every) else 0.0)
    return min(tops)


def newcomers(depth: np.ndarray, rest: np.ndarray, camera: Camera) -> np.ndarray:
    """World points [P, 3] (m) above the table of what is nearer to the camera than what stays there."""
    before, now = rest * np.float32(camera.depth_scale), depth * np.float32(camera.depth_scale)
    new = (depth > 0) & (rest > 0) & (before - now > np.maximum(STEP, STEP_PER_M2 * before**2))
    points = world_map(depth, camera)[new & ~flying_pixels(depth, camera, EDGE)]
    return points[points[:, 2] > LOW].astype(np.float64)


def stick_tip(seen: Sequence[np.ndarray], origins: Sequence[np.ndarray], top: float, radius: float) -> np.ndarray:
    """The lower end [3] (m) of a stick among each camera's points [P, 3]; NaN where none stands up far enough.

    `origins` are the cameras' centres: each point is moved away from its camera, into the stick's axis. `top` is the
    object's height (m): higher points tell the axis, and those along it how far down it goes.
    """
    nothing = np.full(3, np.nan)
    inner = [p + radius * SIDE * _unit(p - o) for p, o in zip(seen, origins, strict=True)]
    points = np.concatenate(inner)
    upper = _largest(points[points[:, 2] > top + CLEAR])
    if len(upper) < FEWEST:
        return nothing
    line = _axis(upper, radius)
    if line is None:
        return nothing
    base, axis = line
    along, off = _on(points, base, axis)
    heights = np.sort(along[off < radius + BESIDE])
    highest = heights[-1]
    breaks = np.flatnonzero(np.diff(heights) > GAP)
    lowest = heights[breaks[-1] + 1] if len(breaks) else heights[0]
    if (highest - lowest) * axis[2] < TALL:
        return nothing
    return base + lowest * axis


def hand_tip(seen: Sequence[np.ndarray], origins: Sequence[np.ndarray], top: float) -> np.ndarray:
    """The fingertips [3] (m) of a hand from each camera's points [P, 3]; NaN where none is there.

    They are the lower end of what is higher than the object's `top` (m); where that goes on below, beside the object, they
    are where its lowest part points to at half the object's height.
    """
    points = np.concatenate(seen)
    upper = _largest(points[points[:, 2] > top + ABOVE])
    if len(upper) < FEWEST_OF_HAND:
        return np.full(3, np.nan)
    lowest = float(np.sort(upper[:, 2])[STRAY])
    end = upper[upper[:, 2] < lowest + FINGER].mean(axis=0)
    beside = np.linalg.norm(upper[:, :2] - end[:2], axis=1)
    back = upper[(upper[:, 2] > end[2] + FINGER / 2) & (upper[:, 2] < end[2] + 2 * FINGER) & (beside < 3 * FINGER)]
    slope = end - back.mean(axis=0) if len(back) else np.zeros(3)
    if lowest > top + ABOVE + FINGER / 2 or slope[2] > -FINGER / 4:
        return np.array([*end[:2], lowest])
    return end + slope * (end[2] - top / 2) / -slope[2]


def _axis(points: np.ndarray, radius: float, tries: int = 60) -> tuple[np.ndarray, np.ndarray] | None:
    """A point and the direction (upwards) of the line that most points [P, 3] are near; None where it lies flat."""
    rng = np.random.default_rng(0)
    best, chosen = 0, None
    for a, b in points[rng.integers(len(points), size=(tries, 2))]:
        if np.linalg.norm(b - a) < 0.3 * TALL:
            continue
        near = _on(points, a, _unit(b - a))[1] < radius
        if near.sum() > best:
            best, chosen = int(near.sum()), near
    if chosen is None or best < FEWEST:
        return None
    middle = points[chosen].mean(axis=0)
    axis = np.linalg.svd(points[chosen] - middle, full_matrices=False)[2][0]
    axis = axis if axis[2] > 0 else -axis
    return (middle, axis) if axis[2] > 0.3 else None


def _on(points: np.ndarray, base: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along a line, and how far from it, points [P, 3] are (m)."""
    offset = points - base
    along = offset @ axis
    return along, np.linalg.norm(offset - along[:, None] * axis, axis=1)


def _largest(points: np.ndarray) -> np.ndarray:
    """Those of the points [P, 3] that are the largest connected part on a grid of `VOXEL`."""
    from scipy.ndimage import label

    if len(points) == 0:
        return points
    cells = np.floor((points - points.min(axis=0)) / VOXEL).astype(int)
    grid = np.zeros(cells.max(axis=0) + 1, bool)
    grid[tuple(cells.T)] = True
    parts = label(grid, np.ones((3, 3, 3)))[0][tuple(cells.T)]
    return points[parts == np.bincount(parts).argmax()]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
