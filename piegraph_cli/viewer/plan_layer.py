"""A plan: the goal, the state before a stroke, what was searched, what was predicted, and what came of it."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from piegraph_cli.evaluation.colors import GOAL, OBJECT, PREDICTED
from piegraph_cli.viewer.arrays import rgb, segments, spring_graph
from piegraph_cli.viewer.layer import Layer
from piegraph_cli.workspace.slices import Slices

BEFORE = (150, 150, 150)
ELITE = (240, 140, 0)
HEIGHT = 0.012
"""Metres above the table at which strokes are drawn."""


@dataclass(frozen=True)
class Shown:
    """What of a plan is looked at."""

    step: int
    iteration: int
    candidates: bool


def candidate_lines(strokes: np.ndarray, height: float = HEIGHT) -> np.ndarray:
    """First strokes [B, 2, 3] (m) of candidates [B, H, 2, 2] at a height above the table; those that were not made are NaN."""
    first = strokes[:, 0, :, :2]
    return np.concatenate([first, np.full((*first.shape[:-1], 1), height, first.dtype)], -1)


def cost_colors(costs: np.ndarray) -> np.ndarray:
    """A colour uint8 [B, 3] per cost [B]: dark where cheap, pale where dear, NaN the palest."""
    known = np.isfinite(costs)
    order = np.ones(len(costs))
    if known.any():
        low, high = costs[known].min(), np.quantile(costs[known], 0.9)
        order[known] = np.clip((costs[known] - low) / max(high - low, 1e-9), 0, 1)
    cheap, dear = np.array([40, 70, 160.0]), np.array([215, 222, 240.0])
    return (cheap + order[:, None] * (dear - cheap)).astype(np.uint8)


class PlanLayer(Layer):
    """One stroke of a plan. The panel of plans gives the `plan` and what of it is `looked` at."""

    name: ClassVar[str] = "plan"
    shown: ClassVar[bool] = False
    listed: ClassVar[bool] = False
    plan: Slices | None = None
    looked: Shown = Shown(0, 0, True)

    def missing(self) -> str:
        """Plans belong to the run, not to a sequence."""
        return "" if self.plan is not None else "no plan that can be read: see the tab Plan"

    def open(self) -> None:
        """Nothing is kept between plans."""
        self.drawn: tuple[Any, ...] | None = None

    def draw(self, frame: int) -> None:
        """Draw the stroke that is looked at; the time line has nothing to do with it."""
        plan, looked = self.plan, self.looked
        if plan is None or self.drawn == (plan.key, looked):
            return
        self.drawn = plan.key, looked
        episode = int(plan["episode"][looked.step])
        self._state("goal", plan.row("goal", episode), rgb(GOAL), springs=False)
        self._state("before", plan.row("before", looked.step), BEFORE)
        self._state("predicted", plan.row("predicted", looked.step), rgb(PREDICTED))
        after = plan.row("after", looked.step)
        self._state("after", after[np.isfinite(after).all(1)], rgb(OBJECT))
        self._strokes(plan, looked)

    def _state(self, name: str, state: np.ndarray, color: tuple[int, int, int], springs: bool = True) -> None:
        self.dots(f"{name}/points", state, color)
        if springs and len(state):
            self.lines(f"{name}/springs", segments(state, spring_graph(state).pairs), color, 1.0)

    def _strokes(self, plan: Slices, looked: Shown) -> None:
        start_end = candidate_lines(plan.row("stroke", looked.step)[None, None])
        self.scene.add_arrows(
            f"{self.root}/stroke",
            start_end,
            (20, 20, 20),
            shaft_radius=0.003,
            head_radius=0.008,
            head_length=0.02,
        )
        lines = candidate_lines(plan.row("candidate_stroke", looked.step)[looked.iteration])
        costs = plan.row("candidate_cost", looked.step)[looked.iteration]
        elite = plan.row("candidate_weight", looked.step)[looked.iteration] > 0
        made = np.isfinite(lines).all((1, 2)) & looked.candidates
        colors = np.repeat(cost_colors(costs)[:, None], 2, axis=1)
        others = made & ~elite
        self.lines("candidates", lines[others], colors[others], 1.0)
        self.lines("elites", lines[made & elite], ELITE, 2.5)
