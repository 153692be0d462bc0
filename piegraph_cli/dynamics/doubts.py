"""What is told of numbers that were fitted to strokes, where these say little or the law does not hold."""

from collections.abc import Sequence

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.sides import Recorded, open_side
from piegraph_cli.text import counted

FEW = 5
"""Strokes below which they say little."""
EDGE = 0.02
"""Share of its range within which a number stands at its bound."""
LEFT = 0.6
"""Share of the motion that a fit may leave before it is no fit."""


def unexplained(error: float, motion: float, law: str, thing: str) -> str | None:
    """What is wrong where a law leaves so much (m) of what particles move (m) on average; None where it explains them."""
    if error <= LEFT * motion:
        return None
    left = (
        f"{law} leave{'' if law.endswith('s') else 's'} {error * 100:.1f} of {motion * 100:.1f} cm that particles move"
    )
    return f"{left}: no {thing} fits"


def at_bounds(ended: Sequence[tuple[str, float]], thing: str) -> list[str]:
    """Words on numbers, by name, whose fit ended at a bound: at 1, where 0 is the middle of their range."""
    told = ", ".join(dict.fromkeys(name for name, at in ended if at > 1 - EDGE))
    return [f"the fit of this {thing} ends at a bound: {told}; more strokes, or another pusher"] if told else []


def little_told(data: Sequences) -> list[str]:
    """Words on too few strokes, and on strokes that come from one side of the object."""
    count = len(data.strokes)
    if 0 < count < FEW:
        told = f"{counted(count, 'stroke')} to learn from: friction and pusher are hardly told by them"
        return [f"{told}; record {FEW} or more"]
    return [] if data.picks else open_side(Recorded.of(data).seen, 0.0, "at the first sequence's start faced")
