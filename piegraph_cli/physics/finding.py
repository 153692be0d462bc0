"""Finding an object again in a cloud, after it was out of sight."""

import math
from collections.abc import Iterator, Sequence

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


def find(
    soft: SoftAssignment, positions: Tensor, cloud: Tensor, views: Sequence[View], upright: bool, enough: float
) -> Tensor:
    """The place of particles [N, 3] (m) that explains a cloud [P, 6] best, when they may be anywhere.

    The last shape and the first frame's are tried, each where it was, then in the middle of the cloud in several
    headings. A start that comes to a misfit of `enough` (m) ends the search: things look alike from two sides.
    """
    thinned = cloud[:POINTS]
    whole = round(len(soft.owner) * len(thinned) / len(cloud))
    best, least = positions, float("inf")
    for start in _starts(soft, positions, thinned):
        at = align(start, thinned, _known(start, views), whole, upright, ROUNDS)
        fit = misfit(at, thinned, _known(at, views))
        if fit < BETTER * least:
            best, least = at[:, :3], fit
        if least < enough:
            break
    return best


def _starts(soft: SoftAssignment, positions: Tensor, cloud: Tensor) -> Iterator[Tensor]:
    """Places and normals [N, 6] to begin at: both shapes as they lie, then turned about the vertical, little first."""
    about = soft.rest - soft.rest.mean(0)
    whole = best_rotation((about.T @ (positions - positions.mean(0)))[None])[0]
    shapes = (positions, about @ whole.T + positions.mean(0))
    middle = cloud[:, :3].mean(0)
    for turn in sorted(range(TURNS + 1), key=lambda k: min(k, TURNS + 1 - k)):
        for shape in shapes:
            start = shape
            if turn > 0:
                angle = 2 * math.pi * (turn - 1) / TURNS
                cosine, sine = math.cos(angle), math.sin(angle)
                about_z = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
                start = (shape - shape.mean(0)) @ about_z.T + middle
            yield soft.oriented(start, soft.rotations(start))


def _known(particles: Tensor, views: Sequence[View]) -> Tensor:
    return torch.as_tensor(~look(particles[:, :3].numpy(), views).hidden)
