"""Why a table is not at z = 0: ways in which poses and depth are commonly wrong, each tried on the planes that were found."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from piegraph_cli.recording.checks import listed
from piegraph_cli.recording.planes import Plane
from piegraph_cli.recording.slips import COMBINED, PLACES, UNCOMMON, Change, made

MOST_PERMUTED = 4
"""Up to so many cameras, every exchange of their poses is tried; of more, exchanges of two."""
CLOSE = 1.0
"""A cause is found if it brings each table within this share of what would be bad."""
DISTANCES = 0.1, 15.0
"""Tables are so far (m) from cameras: shrunk enough, any scene lies at z = 0."""
LEVEL = 1.2
"""A table that is tilted by no more (deg) is level."""
SCALES = (0.008, 0.3)
"""A scale that is off by less is no scale, by more no slip of a ruler."""
LARGE = 0.05, 5.0
"""Metres and degrees: what is less far off is no such slip."""
ALIKE = 0.004, 1.0, 30.0
"""Metres and degrees between the tables of cameras that see the same one, and the most it is tilted."""
STRETCHED = 0.01
"""Share by which cameras may differ in how many times too far they see the table."""


@dataclass(frozen=True)
class Fault:
    """How far a table is from where it should be."""

    offset: float
    """Height of the table's middle above where it should be, metres."""
    tilt: float
    """Angle from the horizontal, degrees."""
    above: float
    """Height of the camera above it along the world's z, metres: negative if the camera looks from below."""
    distance: float
    """From the camera to the table's middle, metres."""


@dataclass(frozen=True)
class Cause:
    """What would explain the fault of these cameras, tried on their data."""

    text: str
    remedy: str
    cameras: tuple[int, ...]
    tested: bool = True
    """Whether undoing it puts the table right."""


Limits = Callable[[Fault], float]
"""A fault as a share of what would be bad; above 1 it is."""


def fault_of(plane: Plane, T: np.ndarray, table: float, scale: float = 1.0) -> Fault:
    """The fault of a table found by a camera, were its pose `T` [4, 4] and its depth `scale` times what it is."""
    centre = T[:3, :3] @ plane.centre * scale + T[:3, 3]
    normal = T[:3, :3] @ plane.normal
    tilt = float(np.degrees(np.arccos(np.clip(abs(normal[2]) / max(np.linalg.norm(normal), 1e-12), 0, 1))))
    reach = float(np.linalg.norm(plane.centre)) * scale
    return Fault(float(centre[2] - table), tilt, float(T[2, 3] - centre[2]), reach)


def find_cause(
    planes: Sequence[Sequence[Plane]],
    poses: Sequence[np.ndarray],
    depth_scales: Sequence[float],
    faults: Sequence[Fault],
    bad: Sequence[int],
    suspect: Sequence[int],
    names: Sequence[str],
    table: float,
    limits: Limits,
) -> Cause:
    """What explains the faults of the cameras `bad`, by trying it.

    `planes` are in each camera's frame (m), `poses` [4, 4], `depth_scales` (m per unit), `suspect` those that are not good.
    """

    def likely(fault: Fault) -> float:
        return limits(fault) if DISTANCES[0] < fault.distance < DISTANCES[1] else np.inf

    def worst(cameras: Sequence[int], poses_of: Callable[[int], np.ndarray], scale: float = 1.0) -> float:
        return max(min(likely(fault_of(p, poses_of(c), table, scale)) for p in planes[c]) for c in cameras)

    found = (
        _swapped(suspect, names, poses, worst)
        or _changed(bad, poses, depth_scales, worst, table)
        or (_changed(bad, poses, depth_scales, worst, table, PLACES) if _large(bad, faults, 2) else None)
        or _scaled(bad, faults, poses, names, table)
        or (_leaning([planes[c][0] for c in bad], [poses[c] for c in bad], bad) if len(bad) == len(poses) else None)
        or _stretched(bad, faults, depth_scales, table)
        or (_changed(bad, poses, depth_scales, worst, table, UNCOMMON) if _large(bad, faults) else None)
    )
    if found:
        return found
    who, angle = listed([names[c] for c in bad]), max(faults[c].tilt for c in bad)
    return Cause(
        f"the pose of {who} is off (tilt {angle:.1f} deg); nothing simple explains it",
        "calibrate again with the board flat on the table (`piegraph calibrate`)",
        tuple(bad),
        tested=False,
    )


def _large(bad: Sequence[int], faults: Sequence[Fault], least: int = 1) -> bool:
    """Whether so many cameras are bad, and most of them by far."""
    far = sum(abs(faults[c].offset) > LARGE[0] or faults[c].tilt > LARGE[1] for c in bad)
    return len(bad) >= least and 2 * far > len(bad)


def _changed(
    bad: Sequence[int],
    poses: Sequence[np.ndarray],
    depth_scales: Sequence[float],
    worst: Callable,
    table: float,
    tried: Sequence[tuple[Change, ...]] = COMBINED,
) -> Cause | None:
    """The fewest slips among those tried that bring all tables right: that is hardly chance."""
    best: tuple[int, float, tuple[Change, ...]] | None = None
    for changes in tried:
        slips = made(changes)
        if best is not None and len(slips) > best[0]:
            break
        scale = changes[-1].scale

        def changed(c: int, changes: tuple[Change, ...] = changes) -> np.ndarray:
            T = poses[c]
            for change in changes:
                T = change.pose(T)
            return T

        score = worst(bad, changed, scale)
        if score < CLOSE and (best is None or score < best[1]):
            best = len(slips), score, slips
    if best is None:
        return None
    parts = [_depth_name(c, depth_scales[bad[0]]) if c.scale != 1 else (c.name, c.remedy) for c in best[2]]
    where = f"z = {table:g}"
    return Cause(
        f"{' and '.join(p[0] for p in parts)} puts the table at {where}", "; ".join(p[1] for p in parts), tuple(bad)
    )


def _depth_name(change: Change, depth_scale: float) -> tuple[str, str]:
    right = depth_scale * change.scale
    far = f"{1 / change.scale:g} times too far" if change.scale < 1 else f"{change.scale:g} times too near"
    return f"depth is {far}: depth_scale {right:g}", f"set depth_scale to {right:g} in cameras.json"


def _swapped(
    suspect: Sequence[int], names: Sequence[str], poses: Sequence[np.ndarray], worst: Callable
) -> Cause | None:
    """The exchange of fewest poses that brings all tables right."""
    found = []
    for order in exchanges(suspect):
        moved = [c for c in suspect if order[c] != c]
        score = worst(suspect, lambda c, order=order: poses[order[c]])
        if score < 0.5 * CLOSE:
            found.append((len(moved), score, order, moved))
    if not found:
        return None
    _, _, order, moved = min(found, key=lambda f: f[:2])
    return swap_cause(order, moved, names)


def swap_cause(order: dict[int, int], moved: Sequence[int], names: Sequence[str]) -> Cause:
    """That cameras have each other's poses: camera c that of `order[c]`."""
    if len(moved) == 2:
        text = f"{names[moved[0]]} and {names[moved[1]]} swapped: each has the other's pose"
    else:
        text = "poses exchanged: " + ", ".join(
            f"{names[c]} has that of another, {names[order[c]]}'s fits" for c in moved
        )
    return Cause(text, "exchange them in cameras.json, or rename the folders", tuple(moved))


def exchanges(cameras: Sequence[int]) -> list[dict[int, int]]:
    """All ways to exchange the poses of cameras: which camera's pose each of them gets. None changes nothing."""
    if len(cameras) <= MOST_PERMUTED:
        return [dict(zip(cameras, order, strict=True)) for order in permutations(cameras) if order != tuple(cameras)]
    same = {c: c for c in cameras}
    return [same | {a: b, b: a} for a, b in combinations(cameras, 2)]


def _scaled(
    bad: Sequence[int], faults: Sequence[Fault], poses: Sequence[np.ndarray], names: Sequence[str], table: float
) -> Cause | None:
    """Depth (or the board) off by some percent, or a table at another height: both leave the table level."""
    if any(faults[c].tilt > LEVEL or faults[c].above + faults[c].offset <= 0 for c in bad):
        return None
    offset = np.array([faults[c].offset for c in bad])
    height = float(offset.mean())
    true_above = np.array([faults[c].above for c in bad]) + offset
    # depth times 1 + e puts a table that is `true_above` below the camera e times that too low
    e = -float((offset / true_above).mean())
    by_scale = float(np.abs(offset + e * true_above).max())
    by_height = float(np.abs(offset - height).max())
    scale_text = f"depth or board size off by {100 * e:+.1f} %"
    height_text = f"the table lies {1000 * abs(height):.0f} mm {'above' if height > 0 else 'below'} z = {table:g}"
    fits = []
    if by_scale < 0.003 and SCALES[0] < abs(e) < SCALES[1]:
        fits.append((by_scale, scale_text, "measure the board's squares again, check depth_scale"))
    if by_height < 0.003 and (len(bad) > 1 or len(poses) == 1):
        remedy = (
            f"calibrate with the board on the table, or say where the table is: ingest.table = {table + height:.3f}"
        )
        fits.append((by_height, height_text, remedy))
    if not fits:
        return None
    fits.sort()
    if len(fits) == 2 and len(bad) > 1 and fits[0][0] < 0.5 * fits[1][0]:
        fits = fits[:1]
    who = "" if len(bad) == len(poses) else f" in {listed([names[c] for c in bad])}, or the pose is off"
    return Cause(", or ".join(f[1] for f in fits) + who, "; or ".join(f[2] for f in fits), tuple(bad))


def _stretched(
    bad: Sequence[int], faults: Sequence[Fault], depth_scales: Sequence[float], table: float
) -> Cause | None:
    """Depth that several cameras see so many times too far, whatever its unit is."""
    true = [faults[c].above + faults[c].offset for c in bad]
    if len(bad) < 2 or any(faults[c].tilt > LEVEL or height <= 0 for c, height in zip(bad, true, strict=True)):
        return None
    times = np.array([faults[c].above / height for c, height in zip(bad, true, strict=True)])
    factor = float(times.mean())
    if not DISTANCES[0] < min(faults[c].distance for c in bad) / factor < DISTANCES[1]:
        return None  # then the poses are in other units
    if np.ptp(times) > STRETCHED * factor or 1 - SCALES[1] < factor < 1 + SCALES[1]:
        return None
    far = f"{factor:.3g} times too far" if factor > 1 else f"{1 / factor:.3g} times too near"
    right = f"{depth_scales[bad[0]] / factor:.3g}"
    text = f"depth is {far}: depth_scale {right} puts the table at z = {table:g}"
    return Cause(text, f"set depth_scale to {right} in cameras.json, and find out what unit depth has", tuple(bad))


def _leaning(tables: Sequence[Plane], poses: Sequence[np.ndarray], bad: Sequence[int]) -> Cause | None:
    """The same plane in all cameras, tilted against z: the world was laid otherwise."""
    normals = np.array([-T[:3, :3] @ plane.normal for plane, T in zip(tables, poses, strict=True)])
    centres = np.array([T[:3, :3] @ plane.centre + T[:3, 3] for plane, T in zip(tables, poses, strict=True)])
    normal = normals.mean(0) / max(float(np.linalg.norm(normals.mean(0))), 1e-12)
    middle = centres.mean(0)
    apart = float(np.abs((centres - middle) @ normal).max())
    askew = float(np.degrees(np.arccos(np.clip(normals @ normal, -1, 1))).max())
    if apart > ALIKE[0] or askew > ALIKE[1] or normal[2] < np.cos(np.radians(ALIKE[2])):
        return None
    a, b = -normal[:2] / normal[2]
    height = middle[2] - a * middle[0] - b * middle[1]
    angle = float(np.degrees(np.arccos(np.clip(normal[2], -1, 1))))
    return Cause(
        f"the table is tilted by {angle:.1f} deg{' alike in all cameras' if len(bad) > 1 else ''}",
        "level the cameras with `piegraph calibrate RECORDING --table`, or say where the table is: "
        f"ingest.table = {height:.4f},{a:.4f},{b:.4f}",
        tuple(bad),
    )
