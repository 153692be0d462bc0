"""Finding an object again in a cloud, after it was out of sight."""

from collections.abc import Sequence

import torch
from torch import Tensor

from piegraph_cli.physics.association import SoftAssignment, align, misfit
from piegraph_cli.physics.rigid import best_rotation
from piegraph_cli.physics.visibility import View, look

TURNS = 8
"""Headings that are tried, evenly spread: alignment finds its way from half of their distance."""

BETTER = 0.8
"""Times the misfit of an earlier start that a later one has to reach: the nearest place is the likeliest."""

ROUNDS = 20
POINTS = 300
"""Points of a cloud that are looked at: a search needs no more."""


def find(soft: SoftAssignment, positions: Tensor, cloud: Tensor, views: Sequence[View], upright: bool) -> Tensor:
    """The place of particles [N, 3] (m) that explains a cloud [P, 6] best, when they may be anywhere.

    The last shape and the first frame's are tried, each where it was and in the middle of the cloud in several headings.
    """
    thinned = cloud[:POINTS]
    whole = round(len(soft.owner) * len(thinned) / len(cloud))
    best, least = positions, float("inf")
    for shape in (positions, soft.rest):
        for start in _starts(soft, shape, positions, thinned):
            at = align(start, thinned, _known(start, views), whole, upright, ROUNDS)
            fit = misfit(at, thinned, _known(at, views))
            if fit < BETTER * least:
                best, least = at[:, :3], fit
    return best


def _starts(soft: SoftAssignment, shape: Tensor, positions: Tensor, cloud: Tensor) -> list[Tensor]:
    """A shape [N, 3] as it lies, and turned about the vertical over the middle of the cloud: places and normals [N, 6]."""
    middle = cloud[:, :3].mean(0)
    about = shape - shape.mean(0)
    whole = best_rotation((about.T @ (positions - positions.mean(0)))[None])[0]
    starts = [about @ whole.T + positions.mean(0)]
    for k in range(TURNS):
        angle = torch.tensor(2 * torch.pi * k / TURNS)
        cosine, sine = float(angle.cos()), float(angle.sin())
        turn = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        starts.append(starts[0] @ turn.T - starts[0].mean(0) @ turn.T + middle)
    return [soft.oriented(start, soft.rotations(start)) for start in starts]


def _known(particles: Tensor, views: Sequence[View]) -> Tensor:
    return torch.as_tensor(~look(particles[:, :3].numpy(), views).hidden)
