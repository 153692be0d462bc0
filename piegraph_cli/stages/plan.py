"""Stage `plan`: strokes towards a goal, closed loop in a simulated environment or for a cloud seen by a robot."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import mode_word
from piegraph_cli.physics.tracking import choose_particles
from piegraph_cli.planning.episode import Episode, play, tool_of
from piegraph_cli.planning.mpc import Step
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Goal, Tool, check_inside, make_planner, tool_warnings
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages.steps import open_environment, step_arrays
from piegraph_cli.stages.train import read_model
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.execute import Context, Output


def run(inputs: dict[str, Artifact], params: PlanParams, context: Context) -> Output:
    """Plan in `--env`, or once from `--state`."""
    if (params.env is None) == (params.state is None):
        raise UsageError("give either --env or --state", "piegraph plan", "as in piegraph plan --run RUN --env tblock")
    if params.state is not None and params.goal is None and params.goal_pose is None:
        raise UsageError("--state needs a goal", "piegraph plan", "give --goal FILE or --goal-pose DX,DY,DYAW")
    if params.goal is not None and params.goal_pose is not None:
        raise UsageError("give one goal, not two", "piegraph plan", "--goal or --goal-pose")
    set_up_torch()
    trained, warnings = read_model(inputs["model"]) if "model" in inputs else None, []
    if params.state is not None:
        if trained is None:
            raise UsageError(
                f"--state needs a trained model, {params.model} is none", "piegraph plan", "--model piegraph"
            )
        episodes = [_plan_once(trained, params)]
    else:

        def wanted(state: np.ndarray, sample: Callable[[], np.ndarray]) -> Goal:
            return _given_goal(params, state) or Goal(sample(), True)

        environment = open_environment(params, trained)
        numbers = context.progress(range(params.episodes), "plan")
        episodes = [play(environment, trained, params, wanted, start=i, goal=i) for i in numbers]
        warnings = tool_warnings(params, tool_of(environment))
    arrays = _arrays(episodes, params)
    return Output(arrays, _quality(arrays, params), warnings)


def _plan_once(trained: Trained, params: PlanParams) -> Episode:
    assert params.state is not None
    cloud, particles = read_points(params.state, None), trained.particles
    if len(cloud) < particles:
        raise DataError(
            f"{len(cloud)} points, the model needs {particles} or more", str(params.state), "give the whole cloud"
        )
    state = choose_particles(cloud, particles).astype(np.float32)
    check_inside(state, params, f"the object of {params.state}")
    goal = _given_goal(params, state)
    assert goal is not None
    cost, make_plan = make_planner(trained, state, goal, params, Tool(), [params.seed, 2, 0, 0])
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


def read_points(path: Path, frame: int | None) -> np.ndarray:
    """Points [P, 3] (m, world) of a .ply, .npz (first array [P, 3] or [F, P, 3]) or .h5 (clouds or tracks) file.

    Of several frames the given one, else the last. Raises `DataError` for no points or unreadable files.
    """
    readers = {".ply": _read_ply, ".npz": _read_npz, ".h5": _read_frames}
    if not path.is_file():
        raise DataError("no such file", str(path), "give a .ply, .npz or .h5 file")
    if path.suffix not in readers:
        raise DataError(
            f"cannot read clouds from {path.suffix or 'a file without suffix'}", str(path), "use .ply, .npz or .h5"
        )
    sets = readers[path.suffix](path)
    index = len(sets) - 1 if frame is None else frame
    if not -len(sets) <= index < len(sets):
        raise DataError(f"has {len(sets)} frames, no frame {frame}", str(path), f"use 0 to {len(sets) - 1}")
    points = np.asarray(sets[index], np.float32)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise DataError(
            f"holds no finite points [P, 3] but an array {points.shape}", f"{path}, frame {index}", "give another file"
        )
    return points


def _read_ply(path: Path) -> list[np.ndarray]:
    import open3d as o3d

    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    return [np.asarray(o3d.io.read_point_cloud(str(path)).points)]


def _read_npz(path: Path) -> list[np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            array = file[file.files[0]]
    except Exception as error:
        raise DataError(f"not a readable .npz file: {error}", str(path)) from None
    return list(array) if array.ndim == 3 else [array]


def _read_frames(path: Path) -> list[np.ndarray]:
    try:
        return list(read_artifact(path, "tracks")["positions"])
    except DataError:
        clouds = read_artifact(path, "clouds")
    return np.split(clouds["points"], clouds["offsets"][1:-1])


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
        row = {"episode": episode, "mode": mode_word(int(plan["mode"][k])), "start": start, "end": end}
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
