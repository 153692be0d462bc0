"""A spring-mass system alone: the stroke's hand pushes or carries it, and its few numbers may be fitted by gradient."""

import math

import numpy as np
import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import DECIMETRE
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.losses import mean_seen
from piegraph_cli.dynamics.params import SMSParams
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PICK
from piegraph_cli.physics import simulation
from piegraph_cli.physics.simulation import PushParams
from piegraph_cli.physics.springs import SpringGraph, build_springs, stability_bound

GRIP = 0.02
"""Particles within this of where a pick starts are held [m]."""
STABLE = 0.8
"""Largest share of the stability bound that a stiffness may take."""


def stroke_path(strokes: Strokes, stride: float, settle: int) -> Tensor:
    """The hand's path [B, T, 2] (m) under strokes [B], `stride` (m) per iteration.

    At its end it waits for `settle` iterations, and for the longest stroke of the batch.
    """
    start, along, length = strokes.planar.start, strokes.along, strokes.length[:, None]
    count = math.ceil(float(length.max()) / stride)
    travelled = torch.arange(count + settle + 1, dtype=start.dtype, device=start.device) * stride
    return start[:, None] + (along / length)[:, None] * torch.minimum(travelled[None], length)[..., None]


def held_particles(positions: Tensor, strokes: Strokes) -> Tensor:
    """Which particles [B, N] of positions [B, N, 3] (m) picks hold: those near their start, the nearest at least."""
    apart = (positions[..., :2] - strokes.planar.start[:, None]).norm(dim=-1)
    return (apart <= apart.amin(1, keepdim=True).clamp_min(GRIP)) & (strokes.mode == PICK)[:, None]


class SMS(nn.Module):
    """Stiffness, damping, friction, weight and the pusher's reach, as logarithms or logits so that they stay in range.

    Source: paper, IV-B, ablations SMS(NO), as made, and SMS(O), after training.
    """

    def __init__(self, params: SMSParams):
        super().__init__()
        self.params = params
        numbers = (params.stiffness, params.friction, params.gravity, params.reach)
        self.stiffness, self.friction, self.gravity, self.reach = (
            nn.Parameter(torch.tensor(math.log(number))) for number in numbers
        )
        self.damping = nn.Parameter(torch.logit(torch.tensor(params.damping)))

    def numbers(self, graph: SpringGraph) -> PushParams:
        """What the simulation takes; the stiffness at most `STABLE` of what these springs bear."""
        damping = self.damping.sigmoid()
        # the bound at any damping, from that at 0.5
        bound = STABLE * stability_bound(graph, 0.5) * (1 + damping) / damping / 3
        stiffness = torch.minimum(self.stiffness.exp(), bound)
        reach = self.reach.exp().clamp_min(self.params.stride)
        friction, gravity = self.friction.exp(), self.gravity.exp()
        return PushParams(stiffness, damping, friction, gravity, reach, self.params.tension_only)

    def move(self, push, positions: Tensor, strokes: Strokes, graph: SpringGraph) -> Tensor:
        """Positions [B, N, 3] (m) after strokes [B], by `push` of `physics.simulation` or its kernel."""
        path = stroke_path(strokes, self.params.stride, self.params.settle)
        held = held_particles(positions, strokes) if bool((strokes.mode == PICK).any()) else None
        return push(positions, path, graph, self.numbers(graph), held)


class WholeStrokes:
    """Training examples of a spring-mass system: a sequence each, all its strokes from their true starts."""

    def __init__(self, data: Sequences, radius: float, device: str = "cpu"):
        strokes = data.whole().to(device)
        self.sequences = []
        for index in np.unique(data.owner):
            first, last = data.strokes[data.owner == index].T
            graph = build_springs(data.rest[index], radius)
            states = (torch.as_tensor(data.positions[rows], device=device) for rows in (first, last))
            seen = None
            if data.seen is not None:
                seen = torch.as_tensor(data.seen[first] & data.seen[last], device=device)
            self.sequences.append((graph, strokes[torch.as_tensor(data.owner == index)], *states, seen))

    def __len__(self) -> int:
        return len(self.sequences)

    def loss(self, network: nn.Module, chosen: Tensor, rng: np.random.Generator | None = None) -> Tensor:
        """Mean squared particle error (dm^2) at the ends of the strokes of the chosen sequences [B]."""
        assert isinstance(network, SMS)
        errors = []
        for index in chosen.tolist():
            graph, strokes, start, end, seen = self.sequences[index]
            error = (network.move(simulation.push, start, strokes, graph) - end) * DECIMETRE
            errors.append(mean_seen(error.square().sum(-1), seen).mean())
        return torch.stack(errors).mean()

    def static_loss(self, network: nn.Module, chosen: Tensor) -> Tensor:
        """The same if nothing moves."""
        moved = [(self.sequences[index][2:4], self.sequences[index][4]) for index in chosen.tolist()]
        errors = [mean_seen(((b - a) * DECIMETRE).square().sum(-1), seen).mean() for (a, b), seen in moved]
        return torch.stack(errors).mean()
