"""Planning without a model: what needs no dynamics to be right about."""

import torch

from piegraph_cli.dynamics.stroke import MIN_STROKE, Strokes
from piegraph_cli.params import PICK
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.proposals import StrokeSpace
from piegraph_cli.planning.search import Candidates, Plan


def put_worst_right(positions: torch.Tensor, goal: torch.Tensor, cost: Cost, space: StrokeSpace) -> Plan | None:
    """Pick the particle of positions [N, 3] (m) that is furthest from its place in goal [N, 3], and carry it there.

    The furthest of those that can be carried past the boxes of `keep_out`; None where there is none, or all are in place. The
    floor for planning with picks. What it predicts is that nothing else moves.
    """
    apart = (positions - goal)[:, :2].norm(dim=-1)
    strokes = Strokes.of(positions[:, :2], goal[:, :2], PICK)
    possible = apart >= MIN_STROKE
    if space.keep_out:
        possible = possible & space.clear(strokes.start, strokes.end, strokes.mode)
    if not possible.any():
        return None
    worst = torch.where(possible, apart, -1.0).argmax()
    stroke = strokes[worst[None]]
    predicted = positions.clone()
    predicted[worst, :2] = goal[worst, :2]
    costs = cost(predicted[None])
    candidates = Candidates(Strokes.stack([Strokes.stack([stroke])]), costs[None], torch.ones(1, 1))
    return Plan(stroke, predicted[None], float(costs[0]), candidates, torch.full((1,), torch.nan))
