"""What makes particles over time doubtful that are well-formed: points that exchange places, lost markers, other clocks."""

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.recording.timing import COUNTED, COUNTS, LONGEST_GAP, MANY

NEIGHBOURS = 6
AWAY, NEAR = 0.75, 0.25
"""Spacings: farther from where its neighbours take it a particle is elsewhere, nearer to another's place it is there."""
TORN, TORN_SHARE = 2.5, 0.04
"""Times as far as before, or as all are apart, from its neighbours a particle is torn from them; a share of all."""
LEAP = 0.02
"""Metres that a marker leaps to the origin where that stands for a lost one."""
UNTOUCHED, UNTOUCHED_SHARE = 0.02, 0.3
"""Metres, and a share of all motion, that an object may move while nothing touches it."""
STILL, SEVERAL = 1e-3, 8
"""Metres: an object that moves less was not moved; of fewer frames that may be so."""
SLOW = 1.0
"""Seconds from frame to frame at which nobody tracks: those may be milliseconds."""
MOVES, FEWEST_MOVES = 0.1, 8
"""Share of its fastest from which an object moves, and frames in which it has to."""
LATEST, UNEVEN, EVENER, LAGS = 1.0, 0.006, 3.0, 1.5
"""Seconds that clocks are tried; metres by which a hand's distance from what it moves varies, and times less with another
clock, and frames that it is off: from these on it is told.
"""
GAP_VARIES = 0.1
"""Metres by which a hand's distance from what it touches varies where it does not touch it all the while."""
FAST = 3.0
"""Metres a second that no hand that pushes or picks goes."""


HELD, FEWEST_HELD = 3, 5
"""So many frames in which all particles repeat, between such in which they move, are held; so often it is told."""
THROUGH = 0.08
"""Metres that nothing goes along an object in touch with it that stays where it is to the last digit."""
PARTED, PARTED_BY, KEPT = 1.5, 0.01, 2
"""Times as far, and metres farther, that a particle is from all but so many of those beside it where it is lost."""


def find_exchanged(positions: np.ndarray) -> tuple[int, list[int]] | None:
    """The first frame in which particles [T, N, 3] (m) take each other's places, and which do."""
    spacing = float(np.median(cKDTree(positions[0]).query(positions[0], k=2)[0][:, 1]))
    if spacing <= 0:
        return None
    near = cKDTree(positions[0]).query(positions[0], k=min(NEIGHBOURS, positions.shape[1] - 1) + 1)[1][:, 1:]
    for frame, (before, after) in enumerate(pairwise(positions), 1):
        expected = before + np.median((after - before)[near], axis=1)
        elsewhere = np.flatnonzero(np.linalg.norm(after - expected, axis=1) > AWAY * spacing)
        if len(elsewhere) < 2:
            continue
        for places in (before, expected):
            distance, taken = cKDTree(places).query(after[elsewhere])
            exchanged = _closed(elsewhere, np.where(distance < NEAR * spacing, taken, -1))
            if exchanged:
                return frame, exchanged
    return None


def _closed(particles: np.ndarray, places: np.ndarray) -> list[int]:
    """Those particles that took places of each other and left none empty."""
    took = {int(i): int(j) for i, j in zip(particles, places, strict=True) if j >= 0 and i != j}
    while set(took.values()) != set(took):
        ends = set(took) & set(took.values())
        took = {i: j for i, j in took.items() if i in ends and j in ends}
    return sorted(took) if len(took) > 1 else []


def find_torn(positions: np.ndarray) -> tuple[int, int] | None:
    """The first frame in which particles [T, N, 3] (m) are away from those beside them all at once, and how many are.

    Whatever an object does, what lies side by side stays so: particles that do not were written in another order.
    """
    count = positions.shape[1]
    near = cKDTree(positions[0]).query(positions[0], k=min(NEIGHBOURS, count - 1) + 1)[1][:, 1:]
    far = np.stack([np.median(np.linalg.norm(p[near] - p[:, None], axis=2), axis=1) for p in positions])
    torn = (far[1:] > TORN * np.maximum(far[:-1], np.median(far[0]))).sum(1)
    wrong = np.flatnonzero(torn >= max(2.0, TORN_SHARE * count))
    return (int(wrong[0]) + 1, int(torn[wrong[0]])) if len(wrong) else None


def find_lost(points: np.ndarray) -> tuple[int, ...] | None:
    """Where points [T, ..., 3] (m) first leap to the origin itself, as lost markers are written: indices of one."""
    lost = (points == 0).all(-1)
    leaps = np.linalg.norm(np.diff(points, axis=0), axis=-1) > LEAP
    edge = np.zeros_like(lost)
    edge[1:] |= lost[1:] & leaps
    edge[:-1] |= lost[:-1] & leaps
    return tuple(int(i) for i in np.argwhere(edge)[0]) if edge.any() else None


def find_doubts(positions: np.ndarray, hand: np.ndarray, time: np.ndarray, contact: np.ndarray) -> list[str]:
    """Warnings of particles [T, N, 3], end-effector [T, 3] (m, NaN where unknown), times [T] (s) and contact [T]."""
    found = [*_doubts_of_time(hand, time), *_doubts_of_motion(positions, contact)]
    return found or _doubts_of_touch(positions, hand, time, contact) or _doubts_of_tracking(positions, hand, contact)


def _doubts_of_time(hand: np.ndarray, time: np.ndarray) -> list[str]:
    steps, found = np.diff(time), []
    usual = float(np.median(steps))
    if 1 <= usual <= COUNTED and len(steps) > 1 and (steps == usual).all() and (time == np.round(time)).all():
        found.append(f"times are whole numbers, {usual:g} apart: are these frame numbers?\n  try: {COUNTS}")
    elif usual >= SLOW and len(time) >= SEVERAL:
        found.append(f"frames are {usual:.3g} s apart: are these milliseconds?\n  try: times in seconds")
    longest = int(steps.argmax())
    if steps[longest] > max(LONGEST_GAP, MANY * usual):
        found.append(
            f"times leap {steps[longest]:.1f} s ahead at frame {longest + 1}: make two files where tracking began anew"
        )
    speeds = np.linalg.norm(np.diff(hand, axis=0), axis=1) / steps
    speeds = speeds[np.isfinite(speeds)]
    if len(speeds) and (fast := float(np.quantile(speeds, 0.95))) > FAST:
        found.append(f"the end-effector goes {fast:.1f} m/s: are times seconds, and positions metres?")
    return found


def _doubts_of_motion(positions: np.ndarray, contact: np.ndarray) -> list[str]:
    """Particles that nothing moved, and such as move while nothing touches them."""
    if len(positions) >= SEVERAL and float(np.linalg.norm(positions - positions[0], axis=2).max()) < STILL:
        return [f"no particle moves by more than {STILL * 1000:g} mm"]
    edges = [0, *(np.flatnonzero(np.diff(contact.astype(int))) + 1), len(contact)]
    moved = {True: 0.0, False: 0.0}
    for first, end in pairwise(edges):
        far = np.linalg.norm(positions[end - 1] - positions[first], axis=1).mean()
        moved[bool(contact[first])] += float(far)
    if moved[False] > UNTOUCHED and moved[False] > UNTOUCHED_SHARE * sum(moved.values()):
        return [
            f"the object moves by {moved[False]:.2g} m while nothing touches it, by {moved[True]:.2g} m in contact: "
            "have end-effector and particles one clock and one frame of reference, and is contact right?"
        ]
    return []


def _doubts_of_tracking(positions: np.ndarray, hand: np.ndarray, contact: np.ndarray) -> list[str]:
    """Particles that are held or stop, all of them or some, while what touches them goes on."""
    repeats = np.r_[False, (positions[1:] == positions[:-1]).all((1, 2))]
    edges = [0, *(np.flatnonzero(np.diff(repeats.astype(int))) + 1), len(repeats)]
    runs = [(first, end) for first, end in pairwise(edges) if repeats[first]]
    held = [(first, end) for first, end in runs if end - first <= HELD and end < len(repeats)]
    if len(held) >= FEWEST_HELD and 2 * len(held) >= len(runs):
        count = sum(end - first for first, end in held)
        return [
            f"all particles repeat those of the frame before in {count} frames between others in which they move: were they "
            "tracked at a lower rate?\n  try: leave out frames without particles of their own"
        ]
    far, first, end = max((_along(hand, contact, *run) for run in runs), default=(0.0, 0, 0))
    if far > THROUGH:
        return [
            f"the particles stay to the last digit from frame {first - 1} to {end - 1}, while the end-effector goes "
            f"{far:.2g} m in contact: did tracking stop?\n  try: leave these frames out"
        ]
    stuck = find_parted(positions)
    if not stuck:
        return []
    frame, which = stuck
    named = ", ".join(map(str, which[:5])) + (" and more" if len(which) > 5 else "")
    return [
        f"in frame {frame} particles are away from all those beside them: {named}: were they lost?\n  try: leave them, or "
        "these frames, out"
    ]


def _along(hand: np.ndarray, contact: np.ndarray, first: int, end: int) -> tuple[float, int, int]:
    """The longest way (m) that a hand [T, 3] goes in one contact from frame `first` to before `end`, and these frames."""
    touching = np.flatnonzero(contact[first:end] & np.isfinite(hand[first:end]).all(1)) + first
    parts = np.split(touching, np.flatnonzero(np.diff(touching) > 1) + 1)
    return max((float(np.linalg.norm(hand[p[-1]] - hand[p[0]])) for p in parts if len(p)), default=0.0), first, end


def find_parted(positions: np.ndarray) -> tuple[int, list[int]] | None:
    """The last frame in which particles [T, N, 3] (m) have left those that lay beside them, all but two, and which have.

    Layers of a fold that part keep neighbours in their own layer.
    """
    count = positions.shape[1]
    if count <= NEIGHBOURS:
        return None
    near = cKDTree(positions[0]).query(positions[0], k=NEIGHBOURS + 1)[1][:, 1:]
    first, last = (np.linalg.norm(p[near] - p[:, None], axis=2) for p in (positions[0], positions[-1]))
    kept = ((last < PARTED * first) | (last < first + PARTED_BY)).sum(1)
    parted = np.flatnonzero(kept <= KEPT)
    return (len(positions) - 1, [int(k) for k in parted]) if 0 < len(parted) < count / 2 else None


def _doubts_of_touch(positions: np.ndarray, hand: np.ndarray, time: np.ndarray, contact: np.ndarray) -> list[str]:
    """A hand that is now near, now far from what it is said to touch, and one that keeps its distance by another clock."""
    trees = [cKDTree(points) for points in positions]
    gaps = np.array(
        [
            tree.query(np.nan_to_num(at, nan=np.inf))[0] if np.isfinite(at).all() else np.nan
            for tree, at in zip(trees, hand, strict=True)
        ]
    )
    touching = gaps[contact & np.isfinite(gaps)]
    if len(touching) >= SEVERAL:
        near, far = np.quantile(touching, [0.1, 0.9])
        if far - near > GAP_VARIES:
            return [f"in contact the end-effector is {near:.2g} to {far:.2g} m from the object: is contact right?"]
    late = find_late(positions, hand, time)
    if late is None:
        return []
    side = "behind" if late > 0 else "ahead of"
    return [
        f"the end-effector is {abs(late):.2g} s {side} the particles: with that it keeps its distance from what it moves\n"
        "  try: one clock for both"
    ]


def find_late(positions: np.ndarray, hand: np.ndarray, time: np.ndarray) -> float | None:
    """Seconds by which a hand [T, 3] is behind the particles [T, N, 3] (m) that it moves at times [T] (s), if it is.

    What moves a thing stays at one distance from it as long as that moves.
    """
    speed = np.zeros(len(time))
    speed[1:] = np.linalg.norm(np.diff(positions, axis=0), axis=2).mean(1) / np.diff(time)
    known = np.isfinite(hand).all(1)
    moves = np.flatnonzero((speed > MOVES * speed.max()) & known)
    if len(moves) < FEWEST_MOVES:
        return None
    runs = np.split(moves, np.flatnonzero(np.diff(moves) > 1) + 1)
    runs = [run for run in runs if len(run) >= FEWEST_MOVES // 2]
    middles = positions.mean(1)

    def uneven(late: float) -> float:
        off, count = 0.0, 0
        for run in runs:
            at = np.stack([np.interp(time[run] + late, time[known], axis) for axis in hand[known].T], 1)
            near = np.linalg.norm(positions[run[0]] - at[0], axis=1).argsort()[:NEIGHBOURS]
            for there in (positions[run][:, near].mean(1), middles[run]):
                gaps = np.linalg.norm(at - there, axis=1)
                off, count = off + float(((gaps - gaps.mean()) ** 2).sum()), count + len(run)
        return (off / max(count, 1)) ** 0.5

    step = float(np.median(np.diff(time)))
    given = uneven(0.0)
    if given < UNEVEN:
        return None
    tried = np.arange(-LATEST, LATEST + step / 4, max(step / 2, LATEST / 50))
    found = [uneven(late) for late in tried]
    best = int(np.argmin(found))
    return float(tried[best]) if abs(tried[best]) >= LAGS * step and given > EVENER * found[best] else None
