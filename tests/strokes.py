"""Strokes for tests, and their parts, in one place."""

from typing import Any

import torch

from piegraph_cli.dynamics.stroke import Strokes


def make(start: Any, end: Any, mode: Any, held: Any = None) -> Strokes:
    """Strokes from start and end [B, 2] (m), mode [B] or one for all, and held [B, 2]."""
    return Strokes.of(start, end, mode, held)


def start(strokes: Strokes) -> torch.Tensor:
    """[..., 2] metres."""
    return strokes.planar.start


def end(strokes: Strokes) -> torch.Tensor:
    """[..., 2] metres."""
    return strokes.planar.end


def mode(strokes: Strokes) -> torch.Tensor:
    """[...] 0 push, 1 pick."""
    return strokes.mode


def held(strokes: Strokes) -> torch.Tensor:
    """[..., 2] whether a pick holds the object at the stroke's start and end."""
    return strokes.held


def motion(strokes: Strokes) -> torch.Tensor:
    """[..., 3] metres, flat."""
    return torch.nn.functional.pad(strokes.along, (0, 1))


def as_numbers(strokes: Strokes) -> torch.Tensor:
    """[..., 7] all parts in a row, to compare."""
    return strokes.packed()
