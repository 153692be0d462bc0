"""Whether one look at the object can be trusted: enough of it, all of it, only it, and as large as it should be.

The checks are like those of a recording's geometry (`recording.checks`): a figure, a threshold, a verdict, what to do.
"""

from collections.abc import Sequence

import numpy as np

from piegraph_cli.perception.parts import CELL, Part, boxed, cells
from piegraph_cli.perception.surroundings import unseen_outline
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import Check, Verdict, judged

JUDGED = ("object", "points", "holes", "hidden", "cut", "candidates", "size")
"""Checks of a look, beside those of geometry."""

FEW = 2.0
"""Points of the cloud for each particle below which it is doubtful; below one it is bad."""
HOLES = (0.4, 0.8)
"""Share of the masks without a depth."""
UNSEEN = (0.008, 0.02)
"""Outline (m) that borders on what no camera sees."""
RIVAL = 0.3
"""Size of another thing, as a share of the object's, from which it could as well be the object."""


def check_cloud(
    cloud: np.ndarray,
    masks: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    particles: int,
) -> list[Check]:
    """Whether a cloud [P, 3] has points enough for so many particles, and its masks [H, W] depth."""
    names = tuple(k.name for k, mask in zip(cameras, masks, strict=True) if mask.any())
    who = names or tuple(k.name for k in cameras)
    verdict: Verdict = "bad" if len(cloud) < particles else "doubtful" if len(cloud) < FEW * particles else "good"
    remedy = "" if verdict == "good" else "look from nearer, with more cameras, or with a smaller fuse.voxel_size"
    text = f"the object's cloud has {len(cloud)} points for {particles} particles"
    found = [Check("points", who, len(cloud), "1", FEW * particles, verdict, text, remedy=remedy)]
    if names:
        pixels = sum(int(mask.sum()) for mask in masks)
        blind = sum(int((mask & (d == 0)).sum()) for mask, d in zip(masks, depths, strict=True)) / pixels
        verdict = judged(blind, *HOLES)
        remedy = (
            "" if verdict == "good" else "the object shines, is black or too near: change light, distance or surface"
        )
        text = f"{blind:.0%} of the object's pixels have no depth"
        found.append(Check("holes", who, blind, "1", HOLES[0], verdict, text, remedy=remedy))
    return found


def check_outline(
    cloud: np.ndarray,
    masks: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    workspace: np.ndarray,
) -> list[Check]:
    """Whether the object of a cloud [P, 3] (m) may go on where no camera sees it; `workspace` [3, 2] (m)."""
    who = tuple(k.name for k in cameras)
    unseen = unseen_outline(cloud, masks, depths, cameras, workspace)
    found = []
    for name, length, where, remedy in (
        (
            "hidden",
            unseen.hidden,
            "something hides what lies beyond",
            "take away what stands before it (a hand, an arm), and look again",
        ),
        (
            "cut",
            unseen.cut,
            "the images or the workspace end there",
            "take hands and tools away from it; else move the object or the cameras, or widen ingest.workspace",
        ),
    ):
        verdict = judged(length, *UNSEEN)
        text = f"{length * 100:.1f} cm of the object's outline is unsure: {where}"
        remedy = "" if verdict == "good" else remedy
        found.append(Check(name, who, length * 100, "cm", UNSEEN[0] * 100, verdict, text, remedy=remedy))
    return found


def check_candidates(cloud: np.ndarray, rivals: Sequence[Part], cameras: Sequence[Camera]) -> Check:
    """Whether one of the other things could be the object of the cloud [P, 3] (m) as well."""
    who = tuple(k.name for k in cameras)
    low, high = cloud[:, :2].min(0), cloud[:, :2].max(0)
    area = cells(cloud, low, tuple(np.ceil((high - low) / CELL).astype(int) + 1)).sum() * CELL**2
    share = max((part.score / area for part in rivals if part.score == part.area), default=0.0)
    verdict = judged(share, 0.0, RIVAL)
    where = "; ".join(f"({x:+.2f}, {y:+.2f}) m" for x, y in (part.centre for part in rivals))
    boxes = "; ".join(box for box in (boxed(part, cameras) for part in rivals) if box)
    count = "one more thing is" if len(rivals) == 1 else f"{len(rivals)} more things are"
    text = f"{count} in view, at x, y = {where}" if rivals else "nothing else is in view"
    remedy = f"point at the object (segment.prompts or segment.points; the others are {boxes})" if boxes else ""
    remedy = remedy if verdict != "good" else ""
    return Check("candidates", who, share, "1", 0.0, verdict, text, remedy=remedy)
