"""Model-predictive control: plan, carry out the first stroke, look, plan again."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.search import Plan

Act = Callable[[Strokes], tuple[np.ndarray, bool]]


@dataclass(frozen=True)
class Step:
    """One stroke of an episode: the plan it came from, the states [N, 3] (m) around it, and how far from the goal it left."""

    plan: Plan
    before: np.ndarray
    after: np.ndarray
    distance: float
    blocked: bool
    seconds: float


def run_episode(
    state: np.ndarray,
    make_plan: Callable[[torch.Tensor], Plan | None],
    act: Act,
    cost: Cost,
    *,
    strokes: int,
    success: float,
) -> Iterator[Step]:
    """Steps until the distance to the goal is below `success` (m), `strokes` are spent or no stroke is feasible any more.

    `make_plan(state [N, 3])` plans; `act(stroke)` carries one out and returns the new state and whether it was
    blocked. Source: paper, III-E.
    """
    positions = torch.as_tensor(np.asarray(state, np.float32))
    for _ in range(strokes):
        if float(cost(positions[None])[0]) < success:
            return
        begin = time.monotonic()
        plan = make_plan(positions)
        seconds = time.monotonic() - begin
        if plan is None:
            return
        after, blocked = act(plan.strokes[0])
        before, positions = positions, torch.as_tensor(np.asarray(after, np.float32))
        yield Step(plan, before.numpy(), positions.numpy(), float(cost(positions[None])[0]), blocked, seconds)
