"""Checks of each two cameras: whether their clouds meet, and whether one sees through what the other sees."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from piegraph_cli.recording.agreement import Sight, apart, seen_through
from piegraph_cli.recording.causes import exchanges, swap_cause
from piegraph_cli.recording.checks import Check, Verdict, judged, listed

APART, APART_SHARE = (0.007, 0.012), (0.01, 0.016)
"""Distance (m) of two cameras' clouds that is doubtful, bad; or as a share of the distance.

Good ones end below 2 mm; poses that are off by half a degree make 5.
"""
THROUGH = (0.12, 0.3)
"""Share of one camera's things that another sees through."""

Pair = tuple[int, int]


def check_pairs(sights: Sequence[Sequence[Sight]], table: float) -> list[Check]:
    """Clouds and outlines of each two cameras, from what each saw in a few frames; `table` is its height (m)."""
    poses = [seen[0].camera.T_world_camera for seen in sights]
    gaps: dict[Pair, float] = {}
    through: dict[Pair, float] = {}
    limits: dict[Pair, tuple[float, float]] = {}
    for a, b in combinations(range(len(sights)), 2):
        one, other = sights[a][0], sights[b][0]
        gaps[a, b] = apart(one, other, poses[a], poses[b])
        through[a, b] = _through(sights[a], sights[b], poses[a], poses[b], table)
        far = max(float(np.median(seen.surface[:, 2])) for seen in (one, other))
        limits[a, b] = max(APART[0], APART_SHARE[0] * far), max(APART[1], APART_SHARE[1] * far)
    verdicts = {pair: (judged(gaps[pair], *limits[pair]), judged(through[pair], *THROUGH)) for pair in gaps}
    cause = _cause(sights, poses, verdicts, table)
    checks = []
    for (a, b), (of_gap, of_through) in verdicts.items():
        who, gap, share = (sights[a][0].camera.name, sights[b][0].camera.name), 1000 * gaps[a, b], through[a, b]
        if np.isfinite(gap):
            text, found = f"their clouds are {gap:.1f} mm apart", cause if of_gap != "good" else ("", "")
            checks.append(Check("clouds", who, gap, "mm", 1000 * limits[a, b][0], of_gap, text, *found))
        if np.isfinite(share):
            text, found = (
                f"one sees through {share:.0%} of what the other sees",
                cause if of_through != "good" else ("", ""),
            )
            checks.append(Check("outlines", who, share, "1", THROUGH[0], of_through, text, *found))
    return checks


def _through(
    one: Sequence[Sight], other: Sequence[Sight], T_one: np.ndarray, T_other: np.ndarray, table: float
) -> float:
    """How much two cameras see through each other's things, in the frame where it is less, since a hand moves."""
    least = np.nan
    for a, b in zip(one, other, strict=True):
        shares = seen_through(a, b, T_one, T_other, table), seen_through(b, a, T_other, T_one, table)
        known = [share for share in shares if np.isfinite(share)]
        least = float(np.fmin(least, max(known))) if known else least
    return least


def _cause(
    sights: Sequence[Sequence[Sight]],
    poses: Sequence[np.ndarray],
    verdicts: dict[Pair, tuple[Verdict, Verdict]],
    table: float,
) -> tuple[str, str]:
    """Why cameras do not agree, with the remedy: poses exchanged (which is tried), or one camera that is elsewhere."""
    names = [seen[0].camera.name for seen in sights]
    odd = [pair for pair, found in verdicts.items() if found != ("good", "good")]
    bad = [pair for pair in odd if "bad" in verdicts[pair]]
    if bad:
        for order in sorted(exchanges(range(len(sights))), key=lambda o: sum(o[c] != c for c in o)):
            changed = [poses[order[c]] for c in range(len(sights))]
            if all(_through(sights[a], sights[b], changed[a], changed[b], table) < THROUGH[0] for a, b in verdicts):
                cause = swap_cause(order, [c for c in order if order[c] != c], names)
                return cause.text, cause.remedy
    alone = [k for k in range(len(sights)) if all(k in pair for pair in odd)]
    if odd and len(alone) == 1:
        who = names[alone[0]]
        return (
            f"{who} alone disagrees: it stands elsewhere than its pose says, or shows another time",
            f"calibrate {who}",
        )
    who = listed([names[k] for k in range(len(sights)) if any(k in pair for pair in odd)]) if odd else ""
    return f"{who} do not stand as their poses say, or show different times", "calibrate them together"
