"""What `plan` and `trials` share: the environment they act in, and what is kept of the steps of an episode."""

from typing import Any

import numpy as np

from piegraph_cli.planning.model import Model
from piegraph_cli.planning.mpc import Step
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.stages.simulate import make_environment


def open_environment(params: PlanParams, model: Model) -> Any:
    """The environment `params.env`, with as many particles as the model was trained on."""
    return make_environment(str(params.env), model.particles, params)


def step_arrays(steps: list[Step], particles: int) -> dict[str, np.ndarray]:
    """What is kept of steps, as datasets."""
    strokes = [s.plan.strokes[0] for s in steps]
    looked = [s.plan.candidates for s in steps]
    shape = (len(steps), *(looked[0].strokes.mode.shape if steps else (0, 0, 0)))

    def states(values: list[np.ndarray]) -> np.ndarray:
        return np.array(values, np.float32).reshape(len(values), particles, 3)

    return {
        "stroke": np.array([s.ends.numpy() for s in strokes]).reshape(-1, 2, 2),
        "mode": np.array([int(s.mode) for s in strokes]),
        "before": states([s.before for s in steps]),
        "predicted": states([s.plan.predicted[0].numpy() for s in steps]),
        "after": states([s.after for s in steps]),
        "cost": np.array([s.plan.cost for s in steps], float),
        "distance": np.array([s.distance for s in steps], float),
        "blocked": np.array([s.blocked for s in steps], bool),
        "seconds": np.array([s.seconds for s in steps], float),
        "candidate_stroke": np.array([c.strokes.ends.numpy() for c in looked]).reshape(*shape, 2, 2),
        "candidate_mode": np.array([c.strokes.mode.numpy() for c in looked]).reshape(shape),
        "candidate_cost": np.array([c.costs.numpy() for c in looked]).reshape(shape[:3]),
        "candidate_weight": np.array([c.weights.numpy() for c in looked]).reshape(shape[:3]),
    }
