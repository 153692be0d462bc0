"""What a prior is given of a recording's object beside real strokes: its traits, and strokes of it that are simulated."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.prior import Chunk

SIMULATED = 6000
"""Strokes of the object that are simulated."""


@dataclass(frozen=True)
class Own:
    """One object as its physics, fitted to the recording, knows it."""

    traits: Tensor
    """[TRAITS] as the prior of its family was told them."""
    chunk: Chunk
    """Simulated strokes."""
    doubts: list[str]
    """What the user is told of the fit."""


def stroke_parts(data: Sequences, reach: float) -> np.ndarray:
    """How far the strokes [S, 2] (m) go before they come near the object, and from there on."""
    strokes, before = data.whole(), torch.as_tensor(data.positions[data.strokes[:, 0]])
    relative = ((before[..., :2] - strokes.start[:, None]) @ strokes.rotation).double()
    spacing = float(np.median(cKDTree(data.rest[0]).query(data.rest[0], k=2)[0][:, 1]))
    near = reach + spacing / 2
    ahead, aside = relative.unbind(-1)
    touch = torch.where(aside.abs() < near, ahead - (near**2 - aside**2).clamp_min(0).sqrt(), torch.inf).amin(1)
    free = torch.minimum(touch.clamp_min(0), strokes.length)
    return torch.stack([free, strokes.length - free], 1).numpy()
