"""Stage `plan`: strokes towards a goal, closed loop in a simulated environment or for a cloud seen by a robot."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import MODE_NAMES
from piegraph_cli.physics.tracking import choose_particles
from piegraph_cli.planning.mpc import Step
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages import train
from piegraph_cli.stages.closed_loop import Episode, Goal, check_inside, make_planner, play, step_arrays
from piegraph_cli.stages.points import read_points
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit


def _units(run: Run) -> Sequence[Unit]:
    return [None]


def _inputs(run: Run, unit: Unit) -> Inputs:
    """The trained model, where one is used."""
    label = run.params(STAGE.name).model
    model = train.trained_name(train.model_name(label, run.params("train").seeds_of(label)[0]))
    return {"model": model} if model else {}


STAGE = Stage(
    "plan",
    "plan strokes to a goal",
    ("model",),
    "plan",
    PlanParams,
    version=5,
    run="piegraph_cli.stages.plan:run",
    unit="run",
    on_demand=True,
    units=_units,
    inputs=_inputs,
)


def run(inputs: dict[str, Artifact], params: PlanParams, context: Context) -> Output:
    """Plan in `--env`, or once from `--state`."""
    if (params.env is None) == (params.state is None):
        raise UsageError("give either --env or --state", "piegraph plan", "as in piegraph plan --run RUN --env tblock")
    if params.state is not None and params.goal is None and params.goal_pose is None:
        raise UsageError("--state needs a goal", "piegraph plan", "give --goal FILE or --goal-pose DX,DY,DYAW")
    if params.goal is not None and params.goal_pose is not None:
        raise UsageError("give one goal, not two", "piegraph plan", "--goal or --goal-pose")
    model = inputs.get("model")
    if params.state is not None:
        if model is None:
            raise UsageError(
                f"--state needs a trained model, {params.model} is none", "piegraph plan", "--model piegraph"
            )
        episodes = [_plan_once(model, params)]
    else:

        def wanted(state: np.ndarray, sample: Callable[[], np.ndarray]) -> Goal:
            return _given_goal(params, state) or Goal(sample(), True)

        numbers = context.progress(range(params.episodes), "plan")
        episodes = [play(model, params, wanted, start=i, goal=i)[0] for i in numbers]
    arrays = _arrays(episodes, params)
    return Output(arrays, _quality(arrays, params))


def _plan_once(model: Artifact, params: PlanParams) -> Episode:
    set_up_torch()
    assert params.state is not None
    cloud, particles = read_points(params.state, None), int(model["particles"])
    if len(cloud) < particles:
        raise DataError(
            f"{len(cloud)} points, the model needs {particles} or more", str(params.state), "give the whole cloud"
        )
    state = choose_particles(cloud, particles).astype(np.float32)
    check_inside(state, params, f"the object of {params.state}")
    goal = _given_goal(params, state)
    assert goal is not None
    cost, make_plan = make_planner(model, state, goal, params, None, [params.seed, 2, 0, 0])
    start = float(cost(torch.as_tensor(state)[None])[0])
    if start < params.success:
        return Episode(state, goal.points, [], start, start)
    plan = make_plan(torch.as_tensor(state))
    if plan is None:
        raise DataError(
            "no stroke touches the object inside the workspace", hint="widen plan.workspace or move the object"
        )
    steps, before, unknown = [], state, np.full_like(state, np.nan)
    for k in range(len(plan.strokes)):
        later = replace(
            plan,
            strokes=plan.strokes[k:],
            predicted=plan.predicted[k:],
            cost=float(cost(plan.predicted[k][None])[0]),
        )
        steps.append(Step(later, before, unknown, float("nan"), False, 0.0))
        before = plan.predicted[k].numpy()
    return Episode(state, goal.points, steps, start, float("nan"))


def _given_goal(params: PlanParams, state: np.ndarray) -> Goal | None:
    """The goal that the settings name, for the object's particles now [N, 3] (m)."""
    if params.goal is not None:
        return Goal(read_points(*params.goal_file()), False)
    if params.goal_pose is not None:
        return Goal(move_in_plane(state, params.goal_pose), True)
    return None


def move_in_plane(points: np.ndarray, motion: tuple[float, float, float]) -> np.ndarray:
    """Points [N, 3] (m) turned by DYAW (rad) about their centre and moved by DX, DY (m)."""
    dx, dy, yaw = motion
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    centre = points[:, :2].mean(0)
    moved = points.copy()
    moved[:, :2] = (points[:, :2] - centre) @ rotation.T + centre + [dx, dy]
    return moved.astype(np.float32)


def _arrays(episodes: list[Episode], params: PlanParams) -> dict[str, np.ndarray]:
    particles = len(episodes[0].start)
    return step_arrays([step for episode in episodes for step in episode.steps], particles) | {
        "goal": np.array([episode.goal for episode in episodes]),
        "seed": np.full(len(episodes), params.seed),
        "start_distance": np.array([episode.start_distance for episode in episodes]),
        "end_distance": np.array([episode.end_distance for episode in episodes]),
        "episode": np.repeat(np.arange(len(episodes)), [len(episode.steps) for episode in episodes]),
    }


def _quality(arrays: dict[str, np.ndarray], params: PlanParams) -> str:
    if params.state is not None and len(arrays["stroke"]) == 0:
        start = arrays["start_distance"][0] * 100
        return f"no stroke: {start:.1f} cm from the goal already, success is {params.success * 100:g} cm"
    if params.state is not None:
        return f"{len(arrays['stroke'])} strokes, predicted distance {arrays['cost'][-1] * 100:.1f} cm"
    solved = arrays["end_distance"] < params.success
    counts = [int((arrays["episode"] == i).sum()) for i in np.flatnonzero(solved)]
    mean = f", {np.mean(counts):.1f} strokes each" if counts else ""
    return f"{int(solved.sum())} of {len(solved)} goals below {params.success * 100:g} cm{mean}"


def describe(plan: Artifact) -> tuple[dict[str, Any], list[str]]:
    """A plan as one object and as lines for people; strokes are in the world frame, metres."""
    rows, lines = [], [plan.quality]
    for k, (start, end) in enumerate(plan["stroke"].tolist()):
        episode = int(plan["episode"][k])
        row = {"episode": episode, "mode": MODE_NAMES[int(plan["mode"][k])], "start": start, "end": end}
        row |= {"predicted_distance": float(plan["cost"][k])}
        if np.isfinite(plan["distance"][k]):
            row |= {"distance": float(plan["distance"][k]), "blocked": bool(plan["blocked"][k])}
        rows.append(row)
        reached = f", reached {row['distance'] * 100:.1f} cm" if "distance" in row else ""
        lines.append(
            f"episode {episode}: {row['mode']} from ({start[0]:+.3f}, {start[1]:+.3f}) to ({end[0]:+.3f}, {end[1]:+.3f}) m, "
            f"predicted {row['predicted_distance'] * 100:.1f} cm from the goal{reached}"
        )
    ends = plan["end_distance"].tolist()
    value = {"plan": str(plan.path), "quality": plan.quality, "strokes": rows, "frame": "world", "units": "m"}
    return value if np.isnan(ends).all() else value | {"end_distance": ends}, lines
