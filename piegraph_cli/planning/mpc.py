"""Model-predictive control: plan, carry out the first stroke, look, plan again."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.experience import Tried, tried
from piegraph_cli.planning.search import Plan

Act = Callable[[Strokes], tuple[np.ndarray, bool]]
Ending = Literal[
    "reached", "strokes spent", "no stroke is possible", "no stroke is expected to help", "the look is bad", "planned"
]
"""Why an episode ended: `planned` where its strokes are still to be carried out."""


@dataclass(frozen=True)
class Step:
    """One stroke of an episode: the plan it came from, the states [N, 3] (m) around it, and how far from the goal it left."""

    plan: Plan
    before: np.ndarray
    after: np.ndarray
    distance: float
    blocked: bool
    seconds: float


def helps(plan: Plan, now: float, cost: Cost) -> bool:
    """Whether a plan is expected to come nearer to the goal than `now` (m) by more than the error to expect of it."""
    return now - float(cost(plan.predicted[-1:])[0]) > float(plan.errors[-1].nan_to_num())


def run_episode(
    state: np.ndarray,
    make_plan: Callable[[torch.Tensor, Sequence[Tried]], Plan | None],
    act: Act,
    cost: Cost,
    *,
    strokes: int,
    success: float,
    look_every: int = 1,
    stop: bool = False,
) -> tuple[list[Step], Ending]:
    """Steps until the distance to the goal is below `success` (m), and why they ended.

    `make_plan(state [N, 3], strokes so far)` plans; `act(stroke)` carries one out and returns the new state and whether it was
    blocked. `look_every` strokes of a plan are carried out before it is looked again. With `stop` an episode ends before a plan
    that is not expected to help. Source: paper, III-E.
    """
    positions = torch.as_tensor(np.asarray(state, np.float32))
    steps: list[Step] = []
    seen: list[Tried] = []
    while (now := float(cost(positions[None])[0])) >= success:
        if len(steps) >= strokes:
            return steps, "strokes spent"
        begin = time.monotonic()
        plan = make_plan(positions, seen)
        seconds = time.monotonic() - begin
        if plan is None:
            return steps, "no stroke is possible"
        if stop and not helps(plan, now, cost):
            return steps, "no stroke is expected to help"
        for k in range(min(look_every, len(plan.strokes), strokes - len(steps))):
            after, blocked = act(plan.strokes[k])
            before, positions = positions, torch.as_tensor(np.asarray(after, np.float32))
            own = plan.later(k, cost) if k else plan
            distance = float(cost(positions[None])[0])
            steps.append(Step(own, before.numpy(), positions.numpy(), distance, blocked, seconds if k == 0 else 0.0))
            if k == 0:  # of later ones the prediction began elsewhere
                seen.append(tried(before, own.strokes[0], own.predicted[0], positions))
    return steps, "reached"
