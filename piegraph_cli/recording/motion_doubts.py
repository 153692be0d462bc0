"""What makes particles over time doubtful that are well-formed: points that exchange places, lost markers, other clocks."""

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.recording.timing import COUNTED, COUNTS, LONGEST_GAP, MANY

NEIGHBOURS = 6
AWAY, NEAR = 0.75, 0.25
"""Spacings: farther from where its neighbours take it a particle is elsewhere, nearer to another's place it is there."""
LEAP = 0.02
"""Metres that a marker leaps to the origin where that stands for a lost one."""
UNTOUCHED, UNTOUCHED_SHARE = 0.02, 0.3
"""Metres, and a share of all motion, that an object may move while nothing touches it."""
STILL, SEVERAL = 1e-3, 8
"""Metres: an object that moves less was not moved; of fewer frames that may be so."""
FAST = 3.0
"""Metres a second that no hand that pushes or picks goes."""


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
    return [*_doubts_of_time(hand, time), *_doubts_of_motion(positions, contact)]


def _doubts_of_time(hand: np.ndarray, time: np.ndarray) -> list[str]:
    steps, found = np.diff(time), []
    usual = float(np.median(steps))
    if 1 <= usual <= COUNTED and len(steps) > 1 and (steps == usual).all() and (time == np.round(time)).all():
        found.append(f"times are whole numbers, {usual:g} apart: are these frame numbers?\n  try: {COUNTS}")
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
