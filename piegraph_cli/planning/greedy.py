"""Planning without a model: what needs no dynamics to be right about."""

import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PICK
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.proposals import StrokeSpace
from piegraph_cli.planning.search import Candidates, Plan


def put_worst_right(positions: torch.Tensor, goal: torch.Tensor, cost: Cost, space: StrokeSpace) -> Plan | None:
    """Pick the particle of positions [N, 3] (m) that is furthest from its place in goal [N, 3], and carry it there.

    None where that enters a box of `keep_out`. The floor for planning with picks. What it predicts is that nothing else moves.
    """
    worst = (positions - goal)[:, :2].norm(dim=-1).argmax()
    strokes = Strokes.of(positions[None, worst, :2], goal[None, worst, :2], PICK)
    if space.keep_out and not space.clear(strokes.start, strokes.end, strokes.mode).all():
        return None
    predicted = positions.clone()
    predicted[worst, :2] = goal[worst, :2]
    costs = cost(predicted[None])
    candidates = Candidates(Strokes.stack([Strokes.stack([strokes])]), costs[None], torch.ones(1, 1))
    return Plan(strokes, predicted[None], float(costs[0]), candidates, torch.full((1,), torch.nan))
