"""What the strokes of an episode have shown: one that did not do what was predicted is not to be trusted again."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from piegraph_cli.dynamics.stroke import Strokes

LIKE_STROKE = 0.015
"""Metres between the ends of two strokes at which what one has shown of the other falls to 0.6."""
LIKE_STATE = 0.01
"""The same between the particles of the two states that they started from."""


@dataclass(frozen=True)
class Tried:
    """A stroke that was carried out."""

    before: torch.Tensor
    """The object [N, 3] (m) before it."""
    ends: torch.Tensor
    """Its start and end [2, 2] (m)."""
    error: float
    """Metres between the particles as they were predicted and as they came out, on average."""


def shown(state: torch.Tensor, ends: torch.Tensor, tried: Sequence[Tried]) -> torch.Tensor:
    """Errors [B] (m) that strokes with these ends [B, 2, 2] (m) from a state [N, 3] (m) have shown; NaN where none was tried.

    The error of a stroke that was tried counts as much as that stroke and its state are like these.
    """
    if not tried:
        return torch.full_like(ends[:, 0, 0], torch.nan)
    states, strokes = (torch.stack(parts).to(ends) for parts in zip(*((t.before, t.ends) for t in tried), strict=True))
    errors = ends.new_tensor([t.error for t in tried])
    moved = (states - state).norm(dim=-1).mean(-1) / LIKE_STATE
    aside = (ends[:, None] - strokes).norm(dim=-1).mean(-1) / LIKE_STROKE
    return (errors * (-(moved.square() + aside.square()) / 2).exp()).amax(1)


def tried(before: torch.Tensor, stroke: Strokes, predicted: torch.Tensor, after: torch.Tensor) -> Tried:
    """Of states [N, 3] (m) before one stroke, as it was predicted after it, and as it came out."""
    return Tried(before, stroke.ends, float((predicted - after).norm(dim=-1).mean()))
