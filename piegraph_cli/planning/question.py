"""One planning question: how an object is seen now, where it shall be, and the strokes that bring it there.

The stage `plan`, `Model.plan` and whoever keeps a model warm ask through `answer` alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.particles import Sizes, choose_particles
from piegraph_cli.planning.episode import Episode, plan_once
from piegraph_cli.planning.expected import (
    check_against,
    check_folds,
    check_goal,
    check_laid,
    check_object,
    check_shape,
    require_level,
    require_order,
)
from piegraph_cli.planning.goals import Goal, move_in_plane, thinned
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.path import top_of
from piegraph_cli.recording.ground import level, moved

Pose = tuple[float, float, float]
"""Of the plane: x, y (m), yaw (rad)."""

STATE_POINTS = 20_000
"""A cloud of more is thinned to these before particles are chosen among them."""
HIGH = 0.05
"""Metres above the table at which nothing lies on it."""
ELSEWHERE = 0.15
"""Metres from the table at which no stroke touches it: the table, or the frame of the points, is another."""
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

    @property
    def expected_gain(self) -> float:
        """How much nearer (m) to the goal its strokes are predicted to bring the object; NaN where there is none."""
        return self.start_distance - self.steps[-1].plan.cost if self.steps else math.nan

    @property
    def expected_error(self) -> float:
        """How far off (m) the last of the predictions may be; NaN where that is not known."""
        return float(self.steps[-1].plan.errors[0]) if self.steps else math.nan


def answer(
    trained: Trained | None,
    params: PlanParams,
    state: np.ndarray,
    goal: np.ndarray | None = None,
    *,
    rest: np.ndarray | None = None,
    corresponds: bool = False,
    device: str = "cpu",
) -> Answer:
    """The next strokes for an object whose cloud or particles are `state` [P, 3] (m), in the world of `params.table`.

    The goal is a cloud [G, 3] (m) in that world; without one it is the pose that the settings name. Where it `corresponds`,
    state and goal are the object's particles in one order. Where `rest` [N, 3] (m) is given, the state are its
    particles in the same order, as a tracker follows them; else particles are chosen in the cloud, and springs and
    neighbours are those of the object as it lies now. `trained` is None where `params.model` is not trained; the search is
    on `device`. Raises `DataError` for states and goals, and `UsageError` for settings, that cannot be used.
    """
    T = level(params.table or (0, 0, 0))
    cloud = moved(finite(state, "state"), T)
    there = None if goal is None else moved(finite(goal, "goal"), T)
    if corresponds and (there is None or len(there) != len(cloud)):
        message = f"{len(cloud)} particles now and {'none' if there is None else len(there)} in the goal"
        raise DataError(
            message, "goal", "give the same particles in the same order, or a goal that does not correspond"
        )
    seen, warnings = chosen_particles(cloud, trained, params, rest, rest is not None or corresponds)
    _check_approach(params, cloud, seen)
    if there is not None and not corresponds:
        require_level(there, cloud)
    target = wanted(trained, params, cloud, seen, there, corresponds)
    if there is not None and trained is not None and trained.sizes is not None:
        warnings += _doubts_of_goal(there, cloud, seen, target, trained.sizes, rest is None)
    shape = seen if rest is None else moved(finite(rest, "rest"), T)
    found = Answer(**vars(plan_once(trained, seen, target, params, device, shape)))
    return replace(found, warnings=(*warnings, *_hopes(found)))


def _doubts_of_goal(
    goal: np.ndarray, cloud: np.ndarray, particles: np.ndarray, target: Goal, sizes: Sizes, whole: bool
) -> list[str]:
    """A word on a goal cloud [G, 3] (m) for an object that is seen as `cloud` [P, 3] with `particles` [N, 3] (m).

    Where the state is a `whole` cloud, and no particles that were tracked, the two are held against each other.
    """
    few, now = thinned(goal, STATE_POINTS), thinned(cloud, STATE_POINTS)
    said, large = check_goal(few, len(particles), sizes), len(goal) >= len(particles)
    if not said and large and whole:
        said = check_against(few, now, len(particles), sizes) or check_laid(few, now, particles, target, sizes)
    return said or (check_shape(target, sizes) if large else [])


def _hopes(found: Answer) -> list[str]:
    """A word where the strokes may as well do harm."""
    gain, error = found.expected_gain, found.expected_error
    if not gain <= error:
        return []
    return [
        f"no stroke is expected to help: {gain * 100:.1f} cm nearer to the goal are predicted, and predictions like this one "
        f"are {error * 100:.1f} cm off\n  try: a nearer goal, strokes of your own, or a model of more sequences"
    ]


def _check_approach(params: PlanParams, cloud: np.ndarray, particles: np.ndarray) -> None:
    """Raises `UsageError` where the tool would come and go outside the workspace, or through the object."""
    (low, high), height, top = params.workspace[4:], params.approach_height, top_of(particles)
    if not low < height <= high:
        text, hint = (
            f"{height:g} m is outside the workspace's heights, {low:g} to {high:g} m",
            "a height within --workspace",
        )
        raise UsageError(text, "plan.approach_height", hint)
    if top >= height and not _above_table(cloud):
        text = f"the tool would come and go at {height:g} m, through an object that is {top:.3f} m high"
        raise UsageError(text, "plan.approach_height", f"more than {top:.3f}")


def wanted(
    trained: Trained | None,
    params: PlanParams,
    cloud: np.ndarray,
    particles: np.ndarray,
    goal: np.ndarray | None,
    corresponds: bool = False,
) -> Goal:
    """The goal for an object that is seen as `cloud` [P, 3] with `particles` [N, 3] (m), on the table z = 0.

    It is the cloud `goal` [G, 3] (m), as in `answer`, or the pose that the settings name: one of the three.
    """
    if sum(one is not None for one in (goal, params.goal_pose, params.goal_at)) != 1:
        raise DataError("one goal is needed", "plan", "give goal, goal_pose or goal_at")
    if params.goal_pose is not None:
        return Goal.of_particles(move_in_plane(particles, params.goal_pose))
    if params.goal_at is not None:
        if trained is None or trained.rest is None:
            raise UsageError(
                f"{params.model} knows no rest shape, whose pose plan.goal_at is",
                "plan.goal_at",
                "a trained model, or --goal FILE, or --goal-pose DX,DY,DYAW",
            )
        return Goal.at(_on_table(params.goal_at, params.table or (0, 0, 0)), trained.rest, cloud, particles)
    assert goal is not None
    if corresponds:
        require_order(cloud, goal, "goal")
    return Goal.of_particles(goal) if corresponds else Goal.of_cloud(goal, cloud, particles)


def _on_table(pose: Pose, table: Sequence[float]) -> Pose:
    """A pose (x, y (m), yaw (rad)) on a table (see `ground.level`), from the world to where the table is z = 0."""
    (x, y, yaw), (height, a, b) = pose, table
    ahead = np.array([[x, y], [x + math.cos(yaw), y + math.sin(yaw)]])
    (x, y), to = moved(np.column_stack([ahead, height + ahead @ [a, b]]), level(table))[:, :2]
    return float(x), float(y), math.atan2(to[1] - y, to[0] - x)


def chosen_particles(
    cloud: np.ndarray, trained: Trained | None, params: PlanParams, rest: np.ndarray | None, ordered: bool
) -> tuple[np.ndarray, list[str]]:
    """The object's particles [N, 3] (m), and what is to be said of them and of the cloud [P, 3].

    They are chosen in the cloud, but where its points are particles that are `ordered` as others are.
    """
    warnings, count = _above_table(cloud), trained.particles if trained else PARTICLES
    if rest is not None and np.shape(rest) != np.shape(cloud):
        raise DataError(f"{len(cloud)} particles, {len(rest)} at rest", "state", "give both of the same particles")
    if rest is not None:
        require_order(cloud, finite(rest, "rest"), "rest")
    if len(cloud) < count:
        raise DataError(f"{len(cloud)} points, the model needs {count} or more", "state", "give the whole cloud")
    few = thinned(cloud, STATE_POINTS)
    seen = cloud if ordered else choose_particles(few, count).astype(np.float32)
    if trained is not None and trained.sizes is not None and not warnings:
        warnings += check_object(few, seen, trained.sizes)
    if trained is not None and rest is None:
        warnings += check_folds(seen, trained, params.spring_radius)
    return seen, warnings


def finite(points: object, what: str) -> np.ndarray:
    """Points [P, 3] float32 of anything that is an array of them. Raises `DataError` where some are not finite."""
    array = np.array(points, np.float32)  # a copy: what is read-only is no tensor
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise DataError(
            f"not finite points [P, 3] but an array {list(array.shape)}", what, "give metres in the world frame"
        )
    return array


def _above_table(cloud: np.ndarray) -> list[str]:
    """A word on an object [P, 3] (m) that cannot lie on the table. Raises `DataError` where it is far from it."""
    low, high = float(cloud[:, 2].min()), float(cloud[:, 2].max())
    if high > 0 and low < HIGH:
        return []
    where = f"{1000 * low:.0f} mm above" if low >= HIGH else f"{-1000 * high:.0f} mm and more below"
    if max(low, -high) > ELSEWHERE:
        text = f"the object lies {where} the table, where no stroke would touch it"
        raise DataError(text, "", "--table HEIGHT says where the table is; or give points in the cameras' world")
    return [f"the object lies {where} the table\n  try: --table HEIGHT, where the table is not at z = 0"]
