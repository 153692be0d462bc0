"""Finding the object: what stands above the table or differs from it in colour, is no hand, and is handled."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.apart import apart_elsewhere
from piegraph_cli.perception.choice import CLEAR, Choice, Chooser
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.parts import Part, boxed, parts_of, view_of
from piegraph_cli.perception.reach import told_cut
from piegraph_cli.recording.camera import Camera

MAX_TRIED = 24
"""Frames looked at before the best so far is taken."""
UNTOUCHED, UNCLEAR = 2, 3
"""Ranks of a choice that no touch speaks for, and that neither touch nor motion speaks for."""


@dataclass(frozen=True)
class ObjectSeed:
    """Where the object is in one frame, agreed on by the cameras, and what else lies there."""

    frame: int
    masks: Sequence[np.ndarray]
    """[H, W] bool of each camera; one that does not see the object there has an empty mask."""
    others: list[Part] = field(default_factory=list)
    """Other things that lie on the table in that frame, those first that would have done as well."""
    warnings: list[str] = field(default_factory=list)
    """What a user should know of the choice."""


def find_object(
    images: Sequence[Sequence[np.ndarray]],
    depths: Sequence[Sequence[np.ndarray]],
    cameras: Sequence[Camera],
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
    tips: np.ndarray | None = None,
) -> ObjectSeed:
    """Find the object in the first frame in which it is clear of the hand, else in the one where it is clearest.

    `images[camera][frame]` RGB uint8 [H, W, 3], `depths[camera][frame]` [H, W] in units of the camera's depth scale
    (0 = no reading), both read lazily; `hand_px` [F, C, 21, 2] (NaN where no hand is); `workspace` [3, 2] bounds (m);
    `tips` [F, 3] the end-effector (m; NaN where unknown). Of several parts the one is taken that the end-effector
    touches and that moves, and among equals the largest away from the workspace's edge. Cameras may differ in image size.
    Raises DataError when nothing in the workspace stands out from the table in any frame tried.
    """
    frames = np.unique(np.linspace(0, len(hand_px) - 1, min(len(hand_px), MAX_TRIED)).astype(int))
    chooser = Chooser(images, depths, cameras, np.full((len(hand_px), 3), np.nan) if tips is None else tips, params)

    def parts_in(f: int, box: np.ndarray = workspace, given: SegmentParams = params) -> list[Part]:
        seen = (view_of(images[c][f], depths[c][f], k, hand_px[f, c], box, given) for c, k in enumerate(cameras))
        return parts_of(list(seen), box, given)

    best = _clearest(frames, chooser, parts_in)
    if best is None:
        raise _not_found(frames, cameras, params, lambda f, given: parts_in(f, given=given))
    frame, choice = apart_elsewhere(chooser, *best, parts_in) or best
    warnings = [*_doubts(frame, choice, cameras), *told_cut(choice.part, workspace, partial(parts_in, frame))]
    return ObjectSeed(frame, choice.part.masks, choice.others, warnings)


def _clearest(frames: np.ndarray, chooser: Chooser, parts_in: Callable[[int], list[Part]]) -> tuple[int, Choice] | None:
    """The choice in the first of the frames in which it is clear of the hand and of rivals, else in the best one."""
    best: tuple[int, Choice] | None = None
    several = False
    for f in frames:
        parts = parts_in(f)
        if not parts:
            continue
        first_doubt = not several and (len(parts) > 1 or bool(parts[0].pieces))
        if first_doubt and best is not None:
            best = best[0], chooser.choose(best[0], [best[1].part])
        several = several or first_doubt
        choice = chooser.choose(int(f), parts) if several else Choice(parts[0], 0)
        if best is None or _worth(choice) > _worth(best[1]):
            best = int(f), choice
        if best[1].part.clearance >= CLEAR and (best[1].rank < UNCLEAR or not best[1].rivals):
            break
    return best


def _not_found(
    frames: np.ndarray,
    cameras: Sequence[Camera],
    params: SegmentParams,
    parts_in: Callable[[int, SegmentParams], Sequence[Part]],
) -> DataError:
    """The error, with what would find something: thresholds at a half are tried on the first frame."""
    weaker = [
        (f"segment.{name} = {getattr(params, name) / 2:g}", params.model_copy(update={name: getattr(params, name) / 2}))
        for name in ("min_contrast", "min_height", "min_area")
    ]
    found = [
        f"with {setting} there is something at x, y = ({x:+.2f}, {y:+.2f}) m"
        for setting, given in weaker
        for x, y in [part.centre for part in parts_in(frames[0], given)[:1]]
    ]
    usual = "check ingest.workspace and the table plane (z = 0), or lower segment.min_height or segment.min_contrast"
    return DataError(
        f"no object found: nothing inside the workspace stands out from the table in {len(frames)} frames tried",
        f"cameras {', '.join(camera.name for camera in cameras)}",
        "; ".join(found) or usual,
    )


def _worth(choice: Choice) -> tuple[int, float]:
    """What is handled goes before what is clear of the hand."""
    return 0 if choice.rank < UNTOUCHED else -choice.rank, choice.part.clearance


def _doubts(frame: int, choice: Choice, cameras: Sequence[Camera]) -> list[str]:
    """Says so where another thing would have done as well, and how to choose."""
    told = [
        f"the thing beside the object at x, y = ({part.centre[0]:+.2f}, {part.centre[1]:+.2f}) m is moved from frame {f} "
        "on: masks may take in what of it comes to the object"
        for part, f in choice.leaving
    ]
    if not choice.rivals:
        return told
    why = ("touched and moved", "touched", "moved", "neither touched nor moved")[choice.rank]
    found = [choice.part, *choice.rivals]
    where = "; ".join(f"({x:+.2f}, {y:+.2f}) m" for x, y in (part.centre for part in found))
    boxes = "; ".join(box for box in (boxed(part, cameras) for part in choice.rivals) if box)
    advice = f"To take another, give its box in the first frame as segment.prompts, as {boxes}" if boxes else ""
    return [
        *told,
        f"{len(found)} things on the table are {why} (frame {frame}), in the middle at x, y = {where}: the first is "
        f"taken, since it is the largest. {advice or 'Narrow ingest.workspace to the object'}",
    ]
