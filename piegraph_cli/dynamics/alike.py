"""Whether the sequences of a dataset show one object, and each of them once."""

from collections.abc import Mapping

import numpy as np

from piegraph_cli.physics.particles import Size, Sizes, size_of

OTHER_SPACING, OTHER_LENGTH = 1.35, 1.25
"""Times that particles of one sequence are farther apart, and that what never bends is longer, than in another."""
STATES = 10
"""Frames of a sequence whose particles tell whether the object bends."""


def find_unlike(tracks: Mapping[str, Mapping[str, np.ndarray]]) -> list[str]:
    """Warnings about sequences, arrays of tracks by name, that show two objects, or two units, or the same twice."""
    return [*_repeated(tracks), *_other_sizes(tracks)]


def _repeated(tracks: Mapping[str, Mapping[str, np.ndarray]]) -> list[str]:
    first: dict[bytes, str] = {}
    pairs = []
    for name, arrays in tracks.items():
        other = first.setdefault(np.ascontiguousarray(arrays["positions"]).tobytes(), name)
        if other != name:
            pairs.append(f"{name} is {other}")
    if not pairs:
        return []
    more = f", and {len(pairs) - 3} more" if len(pairs) > 3 else ""
    text = f"sequences are there twice, and what is learned may be tested on itself: {', '.join(pairs[:3])}{more}"
    return [f"{text}\n  try: leave the copies out"]


def _other_sizes(tracks: Mapping[str, Mapping[str, np.ndarray]]) -> list[str]:
    first = {name: size_of(arrays["positions"][0]) for name, arrays in tracks.items()}
    small, large = _extremes(first, "spacing")
    if first[large].spacing > OTHER_SPACING * first[small].spacing:
        return [_told(first, small, large, "spacing", "particles lie", "apart")]
    bends = any(
        Sizes.of(arrays["positions"][:: max(1, len(arrays["positions"]) // STATES)]).bends for arrays in tracks.values()
    )
    small, large = _extremes(first, "length")
    if not bends and first[large].length > OTHER_LENGTH * first[small].length:
        return [_told(first, small, large, "length", "the object is", "long")]
    return []


def _extremes(sizes: Mapping[str, Size], measure: str) -> tuple[str, str]:
    ordered = sorted(sizes, key=lambda name: getattr(sizes[name], measure))
    return ordered[0], ordered[-1]


def _told(sizes: Mapping[str, Size], small: str, large: str, measure: str, what: str, how: str) -> str:
    low, high = (100 * getattr(sizes[name], measure) for name in (small, large))
    return (
        f"sequences show objects of other sizes: {what} {low:.2g} cm {how} in {small}, {high:.2g} cm in {large}\n"
        "  try: a run for each object; one unit for all sequences"
    )
