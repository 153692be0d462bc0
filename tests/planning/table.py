"""A table without physics for planning: what is pushed or picked moves with the stroke, and everything asked is noted."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import sure
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.planning import episode, planner
from piegraph_cli.planning.goals import Goal
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import StrokeSpace
from piegraph_cli.stages import plan, steps
from tests import strokes as of_strokes

SQUARE = np.array([[x, y, 0.01] for x in np.linspace(-0.05, 0.05, 5) for y in np.linspace(-0.05, 0.05, 5)], np.float32)
"""Particles of an object of 10 cm."""
ANYWHERE = (-9.0, 9.0, -9.0, 9.0, -1.0, 1.0)


class Table:
    """A simulated environment as planning knows it."""

    modes = (PUSH, PICK)
    pusher_radius = 0.01
    walls = None

    def __init__(self):
        self.resets, self.actions = [], []

    def reset(self, seed: int):
        self.resets.append(seed)
        self.now = SQUARE + np.array([*np.random.default_rng(seed).uniform(-0.05, 0.05, 2), 0], np.float32)
        return self.now, {}

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        return self.now + np.array([0.2, *rng.uniform(-0.05, 0.05, 1), 0], np.float32)

    def step(self, action: dict):
        self.actions.append(action)
        self.now = self.now + np.append(action["end"] - action["start"], 0).astype(np.float32)
        return self.now, 0.0, False, False, {"blocked": len(self.actions) == 2}


class Rehearsal:
    """Episodes at a table with a model that carries everything along; notes what was made from what."""

    def __init__(self, patch: pytest.MonkeyPatch):
        self.table, self.made, self.seen = Table(), [], []
        self.environments: list[tuple[str, int, Any]] = []
        patch.setattr(steps, "make_environment", self._environment)
        patch.setattr(planner, "make_foresee", self._model)

    def _environment(self, name: str, particles: int, params: Any) -> Table:
        self.environments.append((name, particles, params))
        return self.table

    def _model(self, name: str, trained: Any, rest: torch.Tensor, params: Any, *_: bool):
        self.made.append((name, trained, rest, params))

        def predict(positions: torch.Tensor, strokes: Any) -> torch.Tensor:
            self.seen.append(positions.clone())
            return positions + of_strokes.motion(strokes)[:, None]

        return sure(predict)

    def play(self, start: int = 0, goal: int = 0, **settings: Any):
        """The episode, and the last state."""
        params = PlanParams(**{"env": "tblock"} | settings)
        environment = steps.open_environment(params, Model(params.model, None, params))
        found = episode.play(environment, None, params, start=start, goal=goal)
        return found, found.states[-1]


def planner_of(
    state: np.ndarray, goal: np.ndarray, corresponds: bool = True, known: Any = (PUSH, PICK), **settings: Any
):
    """The cost, and the function that plans, for an object at rest."""
    wanted = Goal.of_particles(goal) if corresponds else Goal(goal)
    tool = planner.Tool(known)
    return planner.make_planner(None, state, wanted, PlanParams(**settings), tool, [0])


def choose_modes(asked: tuple[str, ...], learned: Any, known: Any) -> tuple[int, ...]:
    return planner.choose_modes(PlanParams(modes=asked, env="tblock"), learned, known)


def space_of(state: np.ndarray, modes: tuple[int, ...] = (PUSH,), **settings: Any) -> StrokeSpace:
    """The strokes that settings allow on an object at rest."""
    params = PlanParams(**settings)
    return planner.stroke_space(torch.as_tensor(state), params, modes, params.pusher_radius)


def plan_stage(**settings: Any) -> dict[str, np.ndarray]:
    """What the stage `plan` makes without a trained model."""
    context = SimpleNamespace(
        progress=lambda items, *_: iter(items), run=SimpleNamespace(folder=Path("nowhere")), device="cpu"
    )
    return plan.run({}, PlanParams(**settings), context).arrays
