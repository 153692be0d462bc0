"""What a prior is given of a recording's object beside real strokes: its traits, and strokes of it that are simulated."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from torch import Tensor

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.prior import Chunk
from piegraph_cli.dynamics.rigid_body import WIDE

SIMULATED = 6000
"""Strokes of the object that are simulated."""
HINT = "train without --from; look at the hand and the strokes with `piegraph report`"
"""What to try where strokes are no pushes of such an object."""
CHAIN, NEAR = 0.4, 6.0
"""How wide a piece of a rope is beside its length, at most, and into how many pieces of an object that is looked at."""


@dataclass(frozen=True)
class Own:
    """One object as its physics, fitted to the recording, knows it."""

    traits: Tensor
    """[TRAITS] as the prior of its family was told them."""
    chunk: Chunk
    """Simulated strokes."""
    doubts: list[str]
    """What the user is told of the fit."""


def is_chain(rest: np.ndarray) -> bool:
    """Whether particles [N, 3] (m) lie along a line, straight or not: pieces of it are long and narrow."""
    apart = cdist(rest[:, :2], rest[:, :2])
    near = apart < max(apart.max() / NEAR, 2.5 * float(np.median(np.sort(apart, 1)[:, 2])))
    pieces = [rest[row, :2] for row in near]
    shapes = [np.linalg.svd(p - p.mean(0), compute_uv=False) / np.sqrt(len(p)) for p in pieces]
    ratio, width = np.median([(narrow / max(wide, 1e-9), narrow) for wide, narrow in shapes], 0)
    return bool(ratio < CHAIN and width < WIDE)


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
