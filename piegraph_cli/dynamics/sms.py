"""A spring-mass system alone: the stroke's hand pushes or carries it, and its few numbers are fitted to strokes."""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import DECIMETRE
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.losses import mean_seen
from piegraph_cli.dynamics.params import SMSParams
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PICK
from piegraph_cli.physics import spring_kernel
from piegraph_cli.physics.pushing import PushParams
from piegraph_cli.physics.springs import SpringGraph, build_springs, contour, stability_bound

GRIP = 0.02
"""Particles within this of where a pick starts are held [m]."""
STABLE = 0.8
"""Largest share of the stability bound that a stiffness may take."""
SETS = 16
"""Sets of numbers tried at a time, in pairs to either side."""
SPREAD = 0.15
"""Their standard deviation, of logarithms and of the damping's logit."""


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


def object_springs(rest: np.ndarray, radius: float) -> SpringGraph:
    """The springs of an object at rest [N, 3] (m), with the contour that a pusher touches."""
    return replace(build_springs(rest, radius), contour=contour(rest))


class SMS(nn.Module):
    """Stiffness, damping, the table's friction, the pusher's reach and grip, as logarithms or a logit: so they stay in range.

    Source: paper, IV-B, ablations SMS(NO), as made, and SMS(O), after training.
    """

    def __init__(self, params: SMSParams):
        super().__init__()
        self.params = params
        numbers = (params.stiffness, params.friction, params.reach, params.grip)
        self.stiffness, self.friction, self.reach, self.grip = (
            nn.Parameter(torch.tensor(math.log(number))) for number in numbers
        )
        self.damping = nn.Parameter(torch.logit(torch.tensor(params.damping)))

    def fitted(self) -> Tensor:
        """What is fitted, [5]."""
        return torch.stack([self.stiffness, self.damping, self.friction, self.reach, self.grip])

    def numbers(self, graph: SpringGraph, fitted: Tensor | None = None) -> PushParams:
        """What the simulation takes of `fitted` [5] or [5, B]; the stiffness at most `STABLE` of what these springs bear."""
        stiffness, damping, friction, reach, grip = self.fitted() if fitted is None else fitted
        damping = damping.sigmoid()
        # the bound at any damping, from that at 0.5
        bound = STABLE * stability_bound(graph, 0.5) * (1 + damping) / damping / 3
        stiffness = torch.minimum(stiffness.exp(), bound)
        reach = reach.exp().clamp_min(self.params.stride)
        return PushParams(
            stiffness, damping, friction.exp(), reach, grip.exp(), self.params.tension_only, self.params.settle
        )

    def move(
        self, push, positions: Tensor, strokes: Strokes, graph: SpringGraph, fitted: Tensor | None = None
    ) -> Tensor:
        """Positions [B, N, 3] (m) after strokes [B], by `push` of `physics.pushing` or of the kernel.

        `fitted` [5, B]: numbers of each scene, in place of the network's own.
        """
        path = stroke_path(strokes, self.params.stride, self.params.settle)
        held = held_particles(positions, strokes) if bool((strokes.mode == PICK).any()) else None
        return push(positions, path, graph, self.numbers(graph, fitted), held)


class WholeStrokes:
    """Training examples of a spring-mass system: a sequence each, all its strokes from their true starts."""

    def __init__(self, data: Sequences, radius: float, device: str = "cpu"):
        strokes = data.whole().to(device)
        self.sequences = []
        for index in np.unique(data.owner):
            first, last = data.strokes[data.owner == index].T
            graph = object_springs(data.rest[index], radius)
            states = (torch.as_tensor(data.positions[rows], device=device) for rows in (first, last))
            seen = None
            if data.seen is not None:
                seen = torch.as_tensor(data.seen[first] & data.seen[last], device=device)
            self.sequences.append((graph, strokes[torch.as_tensor(data.owner == index)], *states, seen))

    def __len__(self) -> int:
        return len(self.sequences)

    def loss(self, network: nn.Module, chosen: Tensor, rng: np.random.Generator | None = None) -> Tensor:
        """Mean squared particle error (dm^2) at the ends of the strokes of the chosen sequences [B].

        With `rng` the mean over numbers drawn around the network's own, whose gradient is that of this mean: whether a
        stroke catches or slides past is a step in the error itself, and says nothing of the way to it.
        """
        assert isinstance(network, SMS)
        fitted = network.fitted()
        if rng is None:
            return self._errors(network, chosen, fitted.detach()[None]).mean()
        away = torch.as_tensor(rng.normal(0, SPREAD, (SETS // 2, len(fitted)))).to(fitted)
        away = torch.cat([away, -away])
        errors = self._errors(network, chosen, fitted.detach() + away)
        gradient = (errors[:, None] * away).mean(0) / SPREAD**2
        return errors.mean() + ((fitted - fitted.detach()) * gradient).sum()

    @torch.no_grad()
    def _errors(self, network: SMS, chosen: Tensor, fitted: Tensor) -> Tensor:
        """The mean squared error (dm^2) under each set of numbers [K, 5]."""
        errors = []
        for index in chosen.tolist():
            graph, strokes, start, end, seen = self.sequences[index]
            sets, count = len(fitted), len(strokes)
            every = torch.arange(count, device=start.device).repeat(sets)
            numbers = fitted.repeat_interleave(count, 0).T
            moved = network.move(spring_kernel.push, start[every], strokes[every], graph, numbers)
            error = ((moved - end[every]) * DECIMETRE).square().sum(-1)
            errors.append(mean_seen(error, None if seen is None else seen[every]).reshape(sets, count).mean(1))
        return torch.stack(errors).mean(0)

    def static_loss(self, network: nn.Module, chosen: Tensor) -> Tensor:
        """The same if nothing moves."""
        moved = [(self.sequences[index][2:4], self.sequences[index][4]) for index in chosen.tolist()]
        errors = [mean_seen(((b - a) * DECIMETRE).square().sum(-1), seen).mean() for (a, b), seen in moved]
        return torch.stack(errors).mean()
