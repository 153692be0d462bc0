"""Searching the best strokes among proposals: the cross-entropy method and MPPI."""

from dataclasses import dataclass

import torch

from piegraph_cli.dynamics.stroke import Predict, Strokes
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import StrokeSpace

INFEASIBLE = 10.0
"""Metres added to the cost of a stroke that misses or leaves the workspace: more than any real distance."""


@dataclass(frozen=True)
class Candidates:
    """What a search looked at, in I iterations of B candidates; NaN and weight 0 in those that convergence spared."""

    strokes: Strokes
    """[I, B, H]."""
    costs: torch.Tensor
    """[I, B] metres, `INFEASIBLE` added per stroke that cannot be carried out."""
    weights: torch.Tensor
    """[I, B] with which each shaped the next iteration: equal for the elites of CEM, 0 for all others."""


@dataclass(frozen=True)
class Plan:
    """The best candidate: strokes [H], predicted states [H, N, 3] (m), their mean cost (m); and all that were looked at."""

    strokes: Strokes
    predicted: torch.Tensor
    cost: float
    candidates: Candidates


def plan_strokes(
    state: torch.Tensor,
    predict: Predict,
    cost: Cost,
    space: StrokeSpace,
    params: PlanParams,
    generator: torch.Generator,
) -> Plan | None:
    """The best of `samples` x `cem_iterations` candidate stroke sequences from state [N, 3] (m); None if none is feasible.

    The first iteration is uniform. Each later one is drawn around the weighted candidates of the one before, and keeps the
    best so far: CEM weighs the elites equally and fits the deviation, MPPI weighs all by exp(-cost / temperature) and
    keeps the deviation. CEM ends early when its elites are as good as the best within `converged` (m).
    Source: paper, III-E (CEM); MPPI as in the paper's baseline PGND.
    """
    proposals = space.sample((params.samples, params.horizon), generator)
    best: tuple[float, Strokes, torch.Tensor] | None = None
    kept, seen = proposals[:0], []
    for _ in range(params.cem_iterations):
        strokes, predicted, costs = rollout(state, proposals, predict, cost, space)
        leader = int(costs.argmin())
        if best is None or float(costs[leader]) < best[0]:
            best = (float(costs[leader]), strokes[leader], predicted[leader])
            kept = proposals[leader : leader + 1]
        weights = _weights(costs, params)
        seen.append((strokes, costs, weights))
        agreed = best[0] < INFEASIBLE and float(costs[weights > 0].max()) - best[0] < params.converged
        if params.planner == "cem" and agreed:
            break
        noise = params.noise if params.planner == "mppi" else None
        proposals = torch.cat([kept, space.refit(proposals, weights, noise, params.samples - 1, generator)])
    if best is None or best[0] >= INFEASIBLE:
        return None
    return Plan(best[1], best[2], best[0], _candidates(seen, params.cem_iterations))


def _candidates(seen: list[tuple[Strokes, torch.Tensor, torch.Tensor]], iterations: int) -> Candidates:
    """Of strokes [B, H], costs and weights [B] of each iteration that there was."""
    strokes, costs, _ = seen[0]
    nowhere = torch.full_like(strokes.start, torch.nan)
    spared = Strokes(nowhere, nowhere, torch.zeros_like(strokes.mode), torch.zeros_like(strokes.held))
    never = iterations - len(seen)
    seen = seen + [(spared, torch.full_like(costs, torch.nan), torch.zeros_like(costs))] * never
    looked, found, weights = zip(*seen, strict=True)
    return Candidates(Strokes.stack(looked), torch.stack(found), torch.stack(weights))


def _weights(costs: torch.Tensor, params: PlanParams) -> torch.Tensor:
    """Weights [B] of candidates with costs [B], summing to 1."""
    if params.planner == "mppi":
        return torch.softmax(-costs / params.temperature, 0)
    weights = torch.zeros_like(costs)
    elites = costs.argsort()[: max(2, round(params.elites * params.samples))]
    weights[elites] = 1 / len(elites)
    return weights


def rollout(
    state: torch.Tensor, proposals: torch.Tensor, predict: Predict, cost: Cost, space: StrokeSpace
) -> tuple[Strokes, torch.Tensor, torch.Tensor]:
    """Strokes [B, H], predicted states [B, H, N, 3] and costs [B] of proposals [B, H, 5] from state [N, 3].

    The cost is the mean over the states, not that of the last alone: a first stroke that wanders would cost nothing.
    """
    positions = state.expand(len(proposals), -1, -1)
    total = torch.zeros(len(proposals))
    strokes, predicted = [], []
    for step in proposals.unbind(1):
        stroke, feasible = space.strokes(positions, step)
        positions = predict(positions, stroke)
        total = total + cost(positions) / proposals.shape[1] + INFEASIBLE * (~feasible)
        strokes.append(stroke)
        predicted.append(positions)
    return Strokes.stack(strokes, 1), torch.stack(predicted, 1), total
