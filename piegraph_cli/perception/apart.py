"""Things that touch in one frame and lie apart in another: told by motion, since only the handled one leaves its place."""

from collections.abc import Callable, Sequence

import numpy as np

from piegraph_cli.perception.choice import CLEAR, SAME_PLACE, Choice, Chooser
from piegraph_cli.perception.parts import Part

FRAMES = 3
"""Frames, clear of the hand, in which it is looked whether the object is two things."""
SPREAD = 9
"""Frames spread over the sequence among which these are chosen, the last ones first."""
SAME_AREA = 0.2
"""Share by which a thing's area may differ: where it is alone and no smaller, no other frame is looked at."""
COVERED = 0.5
"""Share of a thing's place that the object must have covered for it to have been part of it."""


def apart_elsewhere(
    chooser: Chooser, frame: int, choice: Choice, parts_in: Callable[[int], Sequence[Part]]
) -> tuple[int, Choice] | None:
    """The frame, and the choice there, in which what was one part in `frame` lies apart; None where there is none.

    It is two things if a piece of it stays where it was in all frames seen while the rest is handled. `parts_in` finds
    the parts of a frame.
    """
    looked = 0
    for other in np.linspace(len(chooser.tips) - 1, 0, SPREAD).round().astype(int):
        if other == frame or looked == FRAMES:
            continue
        parts = parts_in(int(other))
        if not any(part.clearance >= CLEAR for part in parts):
            continue
        looked += 1
        pieces = [piece for part in parts for piece in part.pieces or (part,)]
        if len(pieces) == 1 and abs(pieces[0].area / choice.part.area - 1) < SAME_AREA:
            break
        left = [piece for piece in pieces if _stayed(chooser, frame, choice.part, int(other), piece)]
        if not left or len(pieces) < 2:
            continue
        found = chooser.choose(int(other), parts)
        clear = found.part.clearance >= CLEAR  # a hand in between might have parted one thing
        if clear and found.rank <= choice.rank and not _same_place(found.part, left):
            return int(other), found
    return None


def _stayed(chooser: Chooser, frame: int, whole: Part, other: int, piece: Part) -> bool:
    """Whether a piece seen in frame `other` lay there as a piece of `whole` in `frame`, and never moves."""
    if _covered(piece, whole) < COVERED or chooser.change(other, piece, frame) >= SAME_PLACE:
        return False
    return chooser.trait(other, piece).stays


def _covered(piece: Part, whole: Part) -> float:
    """Share of a piece's place on the table that is the whole's."""
    place = piece.away == 0
    return float((whole.away[place] == 0).mean())


def _same_place(part: Part, others: Sequence[Part]) -> bool:
    return any(_covered(part, other) > COVERED for other in others)
