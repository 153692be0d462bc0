"""One planning question: how an object is seen now, where it shall be, and the strokes that bring it there.

The stage `plan`, `Model.plan` and whoever keeps a model warm ask through `answer` alone.
"""

from dataclasses import dataclass

import numpy as np

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.errors import DataError
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.planning.episode import Episode, plan_once
from piegraph_cli.planning.goals import Goal, move_in_plane, thinned
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.recording.ground import level, moved

STATE_POINTS = 20_000
"""A cloud of more is thinned to these before particles are chosen among them."""
HIGH = 0.05
"""Metres above the table at which nothing lies on it."""
PARTICLES = 50
"""Of an object, for models that are not trained."""


@dataclass(frozen=True)
class Answer(Episode):
    """Strokes that nobody has carried out yet, on the table z = 0; none where the goal is reached already.

    `strokes`, `predicted` (the particles after each stroke), `metric` and `start_distance` are those of an `Episode`;
    `steps[k].plan.candidates` holds all that was looked at, with costs. `planning.told` makes arrays and rows of it.
    """

    warnings: tuple[str, ...] = ()
    """What is to be said beside it."""


def answer(
    trained: Trained | None,
    params: PlanParams,
    state: np.ndarray,
    goal: np.ndarray | None = None,
    *,
    corresponds: bool = False,
    device: str = "cpu",
) -> Answer:
    """The next strokes for an object whose cloud or particles are `state` [P, 3] (m), in the world of `params.table`.

    The goal is a cloud [G, 3] (m) in that world, whose points are the object's particles in their order where it
    `corresponds`; without one it is the pose that the settings name. `trained` is None where `params.model` is not trained;
    the search is on `device`. Raises `DataError` for states and goals, and `UsageError` for settings, that cannot be used.
    """
    T = level(params.table or (0, 0, 0))
    cloud = moved(finite(state, "state"), T)
    particles = trained.particles if trained else PARTICLES
    if len(cloud) < particles:
        raise DataError(f"{len(cloud)} points, the model needs {particles} or more", "state", "give the whole cloud")
    warnings = _above_table(cloud)
    seen = choose_particles(thinned(cloud, STATE_POINTS), particles).astype(np.float32)
    if (goal is None) == (params.goal_pose is None):
        raise DataError("one goal is needed", "plan", "give goal or goal_pose")
    if params.goal_pose is not None:
        target = Goal.of_particles(move_in_plane(seen, params.goal_pose))
    elif corresponds:
        target = Goal.of_particles(moved(finite(goal, "goal"), T))
    else:
        target = Goal.of_cloud(moved(finite(goal, "goal"), T), cloud, seen)
    found = plan_once(trained, seen, target, params, device)
    return Answer(**vars(found), warnings=tuple(warnings))


def finite(points: object, what: str) -> np.ndarray:
    """Points [P, 3] float32 of anything that is an array of them. Raises `DataError` where some are not finite."""
    array = np.array(points, np.float32)  # a copy: what is read-only is no tensor
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise DataError(
            f"not finite points [P, 3] but an array {list(array.shape)}", what, "give metres in the world frame"
        )
    return array


def _above_table(cloud: np.ndarray) -> list[str]:
    """A word on an object [P, 3] (m) that cannot lie on the table."""
    low, high = float(cloud[:, 2].min()), float(cloud[:, 2].max())
    if high > 0 and low < HIGH:
        return []
    where = f"{1000 * low:.0f} mm above" if low >= HIGH else f"{-1000 * high:.0f} mm and more below"
    return [f"the object lies {where} the table\n  try: --table HEIGHT, where the table is not at z = 0"]
