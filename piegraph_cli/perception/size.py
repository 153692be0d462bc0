"""Whether an object is as large as the one that a model was trained on. Nothing heavy is imported: plans check it too."""

from collections.abc import Sequence

from piegraph_cli.physics.particles import Size, Sizes
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import Check, judged

UNLIKE = (1.2, 1.35)
"""Factor by which a size differs from those of the trained object."""


def check_size(size: Size, trained: Sizes, cameras: Sequence[Camera]) -> Check:
    """Whether the object is as large as the one that the model was trained on."""
    who = tuple(k.name for k in cameras)
    apart = trained.apart(size, one_side=len(cameras) == 1)
    worst = max(apart, key=lambda name: apart[name])
    verdict = judged(apart[worst], *UNLIKE)
    seen = f"{_span(size.length)} × {_span(size.width)} cm, {_span(size.height)} high, particles {_span(size.spacing)} apart"
    known = " × ".join(f"{_range(trained, name)}" for name in ("length", "width"))
    known += f" cm, {_range(trained, 'height')} high, particles {_range(trained, 'spacing')} apart"
    text = f"it is {seen}, the trained object {known}" + (f": another {worst}" if verdict != "good" else "")
    remedy = "look whether the mask holds the whole object and nothing else; else train on this one"
    return Check("size", who, apart[worst], "1", UNLIKE[0], verdict, text, remedy=remedy if verdict != "good" else "")


def _span(metres: float) -> str:
    return f"{metres * 100:.1f}"


def _range(sizes: Sizes, name: str) -> str:
    low, high = _span(getattr(sizes.least, name)), _span(getattr(sizes.most, name))
    return low if low == high else f"{low} to {high}"
