"""The cross-entropy method over stroke proposals."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from piegraph_cli.errors import DataError
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.proposals import PushSpace

Predict = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
INFEASIBLE = 10.0
"""Metres added to the cost of a stroke that misses or leaves the workspace: more than any real distance."""


@dataclass(frozen=True)
class Plan:
    """The best candidate: strokes [H, 5], predicted states [H, N, 3] (m) and cost (m)."""

    strokes: torch.Tensor
    predicted: torch.Tensor
    cost: float


def plan_strokes(
    state: torch.Tensor,
    predict: Predict,
    cost: Cost,
    space: PushSpace,
    *,
    horizon: int,
    samples: int,
    iterations: int,
    elites: float,
    generator: torch.Generator,
) -> Plan:
    """The best of `samples` x `iterations` candidate stroke sequences from state [N, 3] (m).

    The first iteration is uniform; each later one draws from a Gaussian fitted to the elites (a wrapped one in the heading) and
    keeps the best candidate so far. Raises `DataError` when no feasible stroke was found.
    Source: paper, III-E.
    """
    count = max(2, round(elites * samples))
    proposals = space.sample((samples, horizon), generator)
    best: Plan | None = None
    kept = proposals[:0]
    for _ in range(iterations):
        strokes, predicted, costs = rollout(state, proposals, predict, cost, space)
        order = costs.argsort()
        leader = int(order[0])
        if best is None or float(costs[leader]) < best.cost:
            best = Plan(strokes[leader], predicted[leader], float(costs[leader]))
            kept = proposals[leader : leader + 1]
        fresh = _resample(proposals[order[:count]], samples - 1, generator)
        proposals = torch.cat([kept, space.clip(fresh)])
    if best is None or best.cost >= INFEASIBLE:
        raise DataError(
            "no stroke touches the object inside the workspace", hint="widen plan.workspace or move the object"
        )
    return best


def _resample(elites: torch.Tensor, samples: int, generator: torch.Generator) -> torch.Tensor:
    """Draw [samples, H, 3] from a Gaussian fitted to elites [E, H, 3]; headings are fitted around the leader's."""
    heading = elites[..., :1]
    offset = torch.remainder(heading - heading[:1] + torch.pi, 2 * torch.pi) - torch.pi
    flat = torch.cat([heading[:1] + offset, elites[..., 1:]], -1)
    mean, deviation = flat.mean(0), flat.std(0) + 1e-4
    return mean + deviation * torch.randn(samples, *mean.shape, generator=generator)


def rollout(
    state: torch.Tensor, proposals: torch.Tensor, predict: Predict, cost: Cost, space: PushSpace
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Strokes [B, H, 5], predicted states [B, H, N, 3] and costs [B] of proposals [B, H, 3] from state [N, 3]."""
    positions = state.expand(len(proposals), -1, -1)
    penalty = torch.zeros(len(proposals))
    strokes, predicted = [], []
    for step in proposals.unbind(1):
        stroke, feasible = space.strokes(positions, step)
        positions = predict(positions, stroke)
        penalty = penalty + INFEASIBLE * (~feasible)
        strokes.append(stroke)
        predicted.append(positions)
    return torch.stack(strokes, 1), torch.stack(predicted, 1), cost(positions) + penalty
