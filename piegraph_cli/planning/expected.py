"""Whether what a plan is asked about is the object that its model was trained on, the whole of it, and nothing else.

A look judges its own cloud (`perception.judgement`); here the same size check is made on clouds that come as files or
arrays, where no image tells what else is in them.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.errors import DataError
from piegraph_cli.perception.size import UNLIKE, check_size
from piegraph_cli.physics.particles import THICKNESS, Size, Sizes, choose_particles, size_of
from piegraph_cli.physics.rigid import moved_in_plane, planar_fit
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.planning.goals import Goal
from piegraph_cli.recording.camera import Camera

CELL = 0.01
"""Metres: side of the squares of the table by which areas are compared."""
APART = 2
"""Squares from one to the next of the same thing, at most."""
ON_TABLE = 0.005
"""Metres from z = 0 within which a point may be the table's."""
RIM = 0.4
"""Area at the table's height, as a share of the object's, from which the table is in the cloud: a rim always is."""
DENSE = 8
"""Points for each particle from which squares without points are empty."""
ABOVE = 0.03
"""Metres above one and a half times the trained object's height from which something else stands there."""
OTHER = 0.15
"""Share of the points from which what lies apart is another thing, no stray points."""
HEIGHTS, LIFTED = (5, 95), 0.012
"""Percentiles of a cloud's heights, and how far (m) both may lie from those of another on the same table."""
RAISED, EVEN = 0.006, 0.003
"""Metres by which all of a goal is higher or lower from which that is said, and by how much its low and its high differ."""
SCALED, ALIKE = 0.06, 0.02
"""Share by which a goal is larger or smaller in length and width from which that is said, and by how much these differ."""
BESIDE_TOP, SEEN = 0.004, 0.6
"""Metres beside a point of a goal's upper side within which one of the object's is the same, and the share that has one."""
FLAT, LEVEL = 0.5, 0.006
"""Share of the upper side that lies so near (m) to its top in things whose tops can be compared: of round ones, that are laid
a little aside, they tilt.
"""
TILTED, HIGHER, GROWN, UNEVEN = 1.8, 0.0025, 0.035, 0.05
"""Degrees, metres, and a share of its size, by which a goal differs that is the object laid there, from which that is said;
and by how much its size may differ from one direction to another. Good looks at a block end at 0.7, 0.0006 and 0.03.
"""
DIRECTIONS, EDGES = 36, (1, 99)
"""In which widths are compared, between these percentiles."""
ROUNDS, ROBUST = 6, 3.7
"""Of a plane through differences of height, and times their median beyond which they count for nothing."""
BY_HEIGHT = 0.0012
"""Metres within which what is so many times as large is so many times as high."""
UNITS, TOO_LARGE = (("millimetres", 1000.0), ("centimetres", 100.0), ("inches", 39.37)), 20.0
"""What others write for metres, and how many times too large a thing is from which its numbers are no metres."""
BESIDE, STAYS, SHUFFLED = 6, 2, 1.5
"""Particles that lie beside another, how many of them stay so when layers part, and times farther that these are where they
are others."""
FOLDED = 1.65
"""Springs, as a multiple of those at rest, from which layers are joined that only lie on one another."""


UNLIKE_REMEDY = "look whether the cloud holds the whole object and nothing else; else train on this one"


def check_object(cloud: np.ndarray, particles: np.ndarray, sizes: Sizes) -> list[str]:
    """Warnings about an object seen as a cloud [P, 3] with particles [N, 3] (m), for a model of an object of these sizes.

    Raises `DataError` where it is not that object, or more than it is in the cloud, with the cause where one is found.
    """
    now = size_of(particles)
    check = check_size(now, sizes, ())
    found = _no_metres(now.spacing / sizes.most.spacing) or _above(cloud, sizes)
    if not found and len(cloud) >= DENSE * len(particles):
        found = _table_in(cloud, sizes) or _beside(cloud, len(particles), sizes)
    if check.verdict == "good" and not found:
        return []
    bad = check.verdict == "bad"
    cause, remedy = (
        found or _raised(now, sizes) or (f"this {'is not' if bad else 'may not be'} the trained object", UNLIKE_REMEDY)
    )
    if bad:
        raise DataError(f"{cause}: {check.text}", "the object now", remedy)
    return [f"{cause}: {check.text}\n  try: {remedy}"]


def check_goal(goal: np.ndarray, count: int, sizes: Sizes) -> list[str]:
    """A word on a goal cloud [G, 3] (m) that is no such object, or more: a goal is a wish, so it is never refused for that.

    Clouds of fewer points than the object's `count` of particles are left alone: they are parts of it, or places.
    """
    if len(goal) < count:
        return []
    try:
        said = check_object(goal, choose_particles(goal, count), sizes)
    except DataError as error:
        said = [f"{error.message}\n  try: {error.hint}"]
    return [f"the goal: {text}" for text in said]


def require_level(goal: np.ndarray, cloud: np.ndarray) -> None:
    """Raise `DataError` for a goal cloud [G, 3] (m) on another table than the object's cloud [P, 3] (m), or in other units."""
    there, now = (
        float(np.ptp(np.percentile(points[:, :2], HEIGHTS, axis=0), axis=0).max()) for points in (goal, cloud)
    )
    units = _no_metres(there / max(now, 1e-3))
    if units:
        raise DataError(f"{units[0]}: it is {there:.3g} m large, the object {now:.3g} m", "the goal", units[1])
    low, high = np.percentile(goal[:, 2], HEIGHTS) - np.percentile(cloud[:, 2], HEIGHTS)
    lift = float(
        min(low, high) if low > 0 else max(low, high)
    )  # an object that is higher or seen from above is not lifted
    if abs(lift) <= LIFTED or low * high < 0:
        return
    side = "above" if lift > 0 else "below"
    text = f"the goal lies {abs(lift) * 1000:.0f} mm {side} the table that the object lies on"
    raise DataError(text, "the goal", "look at object and goal on one table, with one calibration")


def require_goal(
    goal: np.ndarray, cloud: np.ndarray, count: int, sizes: Sizes | None, cameras: Sequence[Camera] = ()
) -> None:
    """Raise `DataError`, with what differs, for a goal cloud [G, 3] (m) that the object of a cloud [P, 3] (m) cannot be.

    Of another size than a trained object's `sizes`, as `cameras` see it; of other spacing, where nothing was trained; or on
    another table.
    """
    require_level(goal, cloud)
    if len(goal) < count:
        return
    there = size_of(choose_particles(goal, count))
    if sizes is not None:
        check = check_size(there, sizes, cameras)
        if check.verdict == "bad":
            raise DataError(f"the goal is no cloud of this object: {check.text}", "the goal", UNLIKE_REMEDY)
        return
    now = size_of(choose_particles(cloud, count))
    if max(there.spacing / now.spacing, now.spacing / there.spacing) > UNLIKE[1]:
        text = f"the goal's particles lie {there.spacing * 100:.1f} cm apart, the object's {now.spacing * 100:.1f} cm"
        raise DataError(f"{text}: it is another object, or of another size", "the goal", "give a goal of this object")


def require_order(particles: np.ndarray, others: np.ndarray, what: str) -> None:
    """Raise `DataError` where `others` [N, 3] (m), called `what`, are not `particles` [N, 3] (m) in their order.

    Whatever an object does, what lies side by side in one of its shapes does so in the other, but for layers that part.
    """
    if len(others) != len(particles) or len(others) <= BESIDE:
        return
    beside = cKDTree(others).query(others, k=BESIDE + 1)[1][:, 1:]
    then, now = (np.linalg.norm(p[beside] - p[:, None], axis=2) for p in (others, particles))
    times = float(np.median(np.sort(now / np.maximum(then, 1e-9), axis=1)[:, STAYS - 1]))
    if times > SHUFFLED:
        text = f"its particles are in another order: those side by side there are {times:.1f} times as far apart now"
        raise DataError(text, what, "give the same particles in the same order, as a tracker follows them")


def check_folds(particles: np.ndarray, trained: Trained, radius: float) -> list[str]:
    """A word where layers of an object [N, 3] (m) that lie on one another will be taken for joined."""
    if trained.rest is None or trained.sizes is None or not trained.sizes.bends:
        return []
    now, rest = (len(build_springs(points, radius).pairs) for points in (particles, trained.rest))
    if now < FOLDED * rest:
        return []
    return [
        f"the object is folded: layers that lie on one another count as joined ({now} springs, {rest} at rest), and "
        "predictions are less sure\n  try: unfold it, or give particles that were tracked since it lay flat "
        "(--state TRACKS.h5:FRAME)"
    ]


def check_shape(target: Goal, sizes: Sizes) -> list[str]:
    """A word where a cloud, as the goal of an object that never bent, has nowhere the object's own shape."""
    if target.particles is not None or sizes.bends:
        return []
    return [
        "the goal: it has nowhere the shape that the object has now, and this object was never seen to bend: another object, "
        "or another part of it\n  try: a goal cloud of this object, seen by the same cameras; --goal-at or --goal-pose"
    ]


def check_against(goal: np.ndarray, cloud: np.ndarray, count: int, sizes: Sizes) -> list[str]:
    """A word on a goal cloud [G, 3] (m) that is the object of a cloud [P, 3] (m), but for its scale or height.

    Both are compared by `count` particles; what bends has no size of its own.
    """
    said = []
    low, high = np.percentile(goal[:, 2], HEIGHTS) - np.percentile(cloud[:, 2], HEIGHTS)
    if min(abs(low), abs(high)) > RAISED and abs(high - low) < EVEN:
        side = "above" if low > 0 else "below"
        text = f"the goal: it lies {abs(low + high) * 500:.0f} mm {side} the table that the object lies on"
        said.append(f"{text}\n  try: look at object and goal with one calibration")
    there, now = (size_of(choose_particles(points, count)) for points in (goal, cloud))
    grown = there.length / now.length, there.width / now.width
    if not sizes.bends and min(abs(one - 1) for one in grown) > SCALED and abs(grown[0] - grown[1]) < ALIKE:
        text = f"the goal: it is {np.mean(grown):.2f} times as large as the object now, lengthwise and across"
        said.append(
            f"{text}\n  try: check depth_scale, K and units of the one of them that is not as large as the thing"
        )
    return said


def check_laid(goal: np.ndarray, cloud: np.ndarray, particles: np.ndarray, target: Goal, sizes: Sizes) -> list[str]:
    """A word on a goal cloud [G, 3] (m) where the object, laid as it fits best, is tilted, higher, lower or of another scale.

    The object, which never bends, is seen as a cloud [P, 3] with particles [N, 3] (m), which are in `target` where its shape
    was found.
    """
    if sizes.bends:
        return []
    there = Goal.of_cloud(goal, cloud, particles, rigid=True) if target.particles is None else target
    assert there.particles is not None
    motion = planar_fit(particles[:, :2], there.particles[0][:, :2])
    now = np.column_stack([moved_in_plane(cloud[:, :2], motion), cloud[:, 2]])
    grown, uneven = _grown(goal, now)
    found = _tops_apart(goal, now)
    if found is None:
        return []
    lift, tilt = found
    by_height = (grown - 1) * float(np.percentile(now[:, 2], HEIGHTS[1]))
    remedy = "look at object and goal with one calibration"
    if tilt > TILTED:
        return [f"the goal: it is tilted by {tilt:.1f} deg against the object on the table\n  try: {remedy}"]
    if abs(grown - 1) > GROWN and uneven < UNEVEN and abs(lift - by_height) < BY_HEIGHT and lift * (grown - 1) > 0:
        text = f"the goal: it is {grown:.2f} times as large as the object now, in all directions"
        return [f"{text}\n  try: check depth_scale, K and units of the one of them that is not as large as the thing"]
    if abs(lift) > HIGHER:
        side = "above" if lift > 0 else "below"
        return [f"the goal: its top lies {abs(lift) * 1000:.1f} mm {side} that of the object\n  try: {remedy}"]
    return []


def _grown(goal: np.ndarray, now: np.ndarray) -> tuple[float, float]:
    """How many times as wide a goal [G, 3] is as the object laid there [P, 3] (m), and how that differs by direction."""
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    along = np.stack([np.cos(angles), np.sin(angles)])
    low, high = (np.percentile(points[:, :2] @ along, EDGES, axis=0) for points in (goal, now))
    ratio = (low[1] - low[0]) / np.maximum(high[1] - high[0], 1e-3)
    return float(np.median(ratio)), float(ratio.std())


def _tops_apart(goal: np.ndarray, now: np.ndarray) -> tuple[float, float] | None:
    """How far (m) the upper side of a goal [G, 3] lies above that of the object laid there [P, 3] (m), in its middle, and its
    tilt (deg); None where they hardly overlap, and of things without a flat top.
    """
    goal, now = (points[points[:, 2] > np.percentile(points[:, 2], HEIGHTS[1]) / 2] for points in (goal, now))
    flat = now[:, 2] > np.percentile(now[:, 2], HEIGHTS[1]) - LEVEL
    if min(len(goal), len(now)) < DENSE or flat.mean() < FLAT:
        return None
    apart, near = cKDTree(now[:, :2]).query(goal[:, :2])
    same = apart < BESIDE_TOP
    if same.mean() < SEEN or same.sum() < DENSE:
        return None
    above = goal[same, 2] - now[near[same], 2]
    places = np.column_stack([np.ones(len(above)), goal[same, :2] - now[:, :2].mean(0)])
    kept = np.ones(len(above), bool)
    for _ in range(ROUNDS):
        plane = np.linalg.lstsq(places[kept], above[kept], rcond=None)[0]
        off = np.abs(above - places @ plane)
        kept = off <= max(ROBUST * float(np.median(off[kept])), ON_TABLE / 10)
    return float(plane[0]), float(np.degrees(np.arctan(np.hypot(plane[1], plane[2]))))


def _no_metres(ratio: float) -> tuple[str, str] | None:
    """Cause and remedy for what is so many times as large as it should be, where that is another unit."""
    if ratio < TOO_LARGE:
        return None
    unit, each = min(UNITS, key=lambda known: abs(np.log(ratio / known[1])))
    return f"these are {unit}, not metres", f"divide by {each:g}"


def _raised(now: Size, sizes: Sizes) -> tuple[str, str] | None:
    """Cause and remedy where nothing but the height above z = 0 is another one."""
    apart = sizes.apart(now)
    if apart.pop("height") < UNLIKE[0] or max(apart.values()) > UNLIKE[0]:
        return None
    lift = now.height - float(np.clip(now.height, sizes.least.height, sizes.most.height))
    side = "higher" if lift > 0 else "lower"
    return (
        f"its top lies {abs(lift) * 1000:.0f} mm {side} than the trained object's: another object, or a table that is not at "
        "z = 0",
        f"--table HEIGHT, {abs(lift):.3f} m {side} than now, if that is where the table is; else the object's own cloud",
    )


def _cells(points: np.ndarray) -> set[tuple[int, int]]:
    return set(map(tuple, np.unique(np.floor(points[:, :2] / CELL).astype(int), axis=0).tolist()))


def _table_in(cloud: np.ndarray, sizes: Sizes) -> tuple[str, str] | None:
    """Cause and remedy where squares of the table are in the cloud [P, 3] beside a thing that stands higher."""
    if sizes.least.height < 2 * ON_TABLE + THICKNESS / 2:
        return None  # as flat as the table's noise: size alone tells
    high = _cells(cloud[cloud[:, 2] > 2 * ON_TABLE])
    near = {(i + a, j + b) for i, j in high for a in (-1, 0, 1) for b in (-1, 0, 1)}
    bare = _cells(cloud[np.abs(cloud[:, 2]) < ON_TABLE]) - near
    if len(bare) <= RIM * len(high):
        return None
    return (
        f"the table is in the cloud ({len(bare) * CELL**2 * 1e4:.0f} cm2 of it beside {len(high) * CELL**2 * 1e4:.0f} cm2 "
        "that stand higher)",
        f"cut away what lies below z = {ON_TABLE * 1000:g} mm, or let piegraph look find the object in images",
    )


def _above(cloud: np.ndarray, sizes: Sizes) -> tuple[str, str] | None:
    """Cause and remedy where something reaches far above what the object ever did."""
    top, known = float(np.percentile(cloud[:, 2], 99.5)), sizes.most.height
    if top < 1.5 * known + ABOVE:
        return None
    return (
        f"something reaches {top * 100:.0f} cm high, the trained object {known * 100:.1f} cm: a hand or a tool in the cloud",
        "take it away, or cut it out of the cloud",
    )


def _beside(cloud: np.ndarray, count: int, sizes: Sizes) -> tuple[str, str] | None:
    """Cause and remedy where something lies beside the object."""
    parts = [part for part in _parts(cloud) if len(part) >= max(count, OTHER * len(cloud))]
    if len(parts) < 2:
        return None
    of_object = next((part for part in parts if _fits(part, count, sizes)), parts[0])
    other = next(part for part in parts if part is not of_object)
    x, y = other[:, :2].mean(0)
    return (
        f"{len(parts)} things are in the cloud, one more around x, y = ({x:+.2f}, {y:+.2f}) m: a hand or another object",
        "give the cloud of the object alone",
    )


def _fits(part: np.ndarray, count: int, sizes: Sizes) -> bool:
    return check_size(size_of(choose_particles(part, count)), sizes, ()).verdict != "bad"


def _parts(cloud: np.ndarray) -> list[np.ndarray]:
    """The parts of a cloud [P, 3] between which two squares of the table are empty, the one with most points first."""
    squares, of_point = np.unique(np.floor(cloud[:, :2] / CELL).astype(int), axis=0, return_inverse=True)
    near = cKDTree(squares).query_pairs(APART, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(squares),) * 2)
    part = connected_components(links, directed=False)[1][of_point.ravel()]
    return sorted((cloud[part == k] for k in np.unique(part)), key=len, reverse=True)
