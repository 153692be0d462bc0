"""Stage `plan`: strokes towards a goal, closed loop in a simulated environment or for a cloud seen by a robot."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import make_predict
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PlanParams
from piegraph_cli.physics.tracking import choose_particles
from piegraph_cli.planning.cem import Plan, plan_strokes
from piegraph_cli.planning.costs import Cost, make_cost
from piegraph_cli.planning.mpc import Step, run_episode
from piegraph_cli.planning.proposals import PushSpace, solid_edges
from piegraph_cli.stages.train import read_network
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
    torch.set_num_threads(1)
    network, particles = read_network(inputs["model"]), int(inputs["model"]["particles"])
    if params.state is not None:
        episodes = [_plan_once(network, particles, params)]
    else:
        episodes = [_episode(network, particles, params, i) for i in context.progress(range(params.episodes), "plan")]
    arrays = _arrays(episodes, params)
    return Output(arrays, _quality(arrays, params))


Episode = tuple[np.ndarray, float, float, list[Step]]
"""Goal [G, 3], distance at the start and at the end (m), steps."""


def _episode(network: Any, particles: int, params: PlanParams, index: int) -> Episode:
    from piegraph_cli.environments import make

    rng = np.random.default_rng([params.seed, index])
    environment = make(str(params.env), particles=particles)
    state, _ = environment.reset(seed=int(rng.integers(1 << 31)))
    goal, corresponds = _goal(params, state, lambda: environment.goal(rng))
    cost, make_plan = _planner(network, state, goal, corresponds, params, [params.seed, index])

    def act(stroke: torch.Tensor) -> tuple[np.ndarray, bool]:
        action = {
            "start": stroke[:2].numpy().astype(float),
            "end": stroke[2:4].numpy().astype(float),
            "mode": int(stroke[4]),
        }
        after, _, _, _, info = environment.step(action)
        return after, info["blocked"]

    steps = list(run_episode(state, make_plan, act, cost, strokes=params.strokes, success=params.success))
    start = float(cost(torch.as_tensor(state)[None])[0])
    return goal, start, steps[-1].distance if steps else start, steps


def _plan_once(network: Any, particles: int, params: PlanParams) -> Episode:
    assert params.state is not None
    cloud = read_points(params.state, None)
    if len(cloud) < particles:
        raise DataError(
            f"{len(cloud)} points, the model needs {particles} or more", str(params.state), "give the whole cloud"
        )
    state = choose_particles(cloud, particles).astype(np.float32)
    _check_inside(state, params, f"the object of {params.state}")
    goal, corresponds = _goal(params, state, None)
    cost, make_plan = _planner(network, state, goal, corresponds, params, [params.seed, 0])
    start = float(cost(torch.as_tensor(state)[None])[0])
    if start < params.success:
        return goal, start, start, []
    plan = make_plan(torch.as_tensor(state))
    steps, before, unknown = [], state, np.full_like(state, np.nan)
    for k in range(len(plan.strokes)):
        single = Plan(plan.strokes[k:], plan.predicted[k:], float(cost(plan.predicted[k][None])[0]))
        steps.append(Step(single, before, unknown, float("nan"), False, 0.0))
        before = plan.predicted[k].numpy()
    return goal, start, float("nan"), steps


def _planner(
    network: Any, state: np.ndarray, goal: np.ndarray, corresponds: bool, params: PlanParams, seed: list[int]
) -> tuple[Cost, Callable[[torch.Tensor], Plan]]:
    _check_inside(goal, params, "the goal")
    kind = params.cost if params.cost != "auto" else "distance" if corresponds else "chamfer"
    cost = make_cost(kind, torch.as_tensor(goal), len(state))
    predict = make_predict(params.model, network, torch.as_tensor(state), params)
    edges = solid_edges(torch.as_tensor(state))
    space = PushSpace(edges, params.min_length, params.max_length, params.pusher_radius, params.workspace)
    generator = torch.Generator().manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))

    def make_plan(positions: torch.Tensor) -> Plan:
        return plan_strokes(
            positions,
            predict,
            cost,
            space,
            horizon=params.horizon,
            samples=params.samples,
            iterations=params.cem_iterations,
            elites=params.elites,
            generator=generator,
        )

    return cost, make_plan


def _check_inside(points: np.ndarray, params: PlanParams, what: str) -> None:
    xmin, xmax, ymin, ymax = params.workspace[:4]
    x, y = points[:, :2].mean(0)
    if not (xmin <= x <= xmax and ymin <= y <= ymax):
        raise DataError(
            f"{what} lies around ({x:.2f}, {y:.2f}) m, outside plan.workspace",
            hint="points are metres in the world frame; correct them, or widen --workspace",
        )


def _goal(params: PlanParams, state: np.ndarray, sample: Callable[[], np.ndarray] | None) -> tuple[np.ndarray, bool]:
    """The goal [G, 3] (m), and whether its points correspond to the particles."""
    if params.goal is not None:
        return read_points(*params.goal_file()), False
    if params.goal_pose is not None:
        return move_in_plane(state, params.goal_pose), True
    assert sample is not None
    return sample().astype(np.float32), True


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
    steps = [(index, step) for index, (_, _, _, all_steps) in enumerate(episodes) for step in all_steps]
    size = len(episodes[0][0])
    particles = len(steps[0][1].before) if steps else 0
    strokes = np.array([s.plan.strokes[0].numpy() for _, s in steps]).reshape(-1, 5)

    def states(values: list[np.ndarray]) -> np.ndarray:
        return np.array(values, np.float32).reshape(len(values), particles, 3)

    return {
        "goal": np.array([goal for goal, *_ in episodes]).reshape(-1, size, 3),
        "seed": np.full(len(episodes), params.seed),
        "start_distance": np.array([start for _, start, _, _ in episodes]),
        "end_distance": np.array([end for _, _, end, _ in episodes]),
        "episode": np.array([index for index, _ in steps], np.int64),
        "stroke": strokes[:, :4].reshape(-1, 2, 2),
        "mode": strokes[:, 4],
        "before": states([s.before for _, s in steps]),
        "predicted": states([s.plan.predicted[0].numpy() for _, s in steps]),
        "after": states([s.after for _, s in steps]),
        "cost": np.array([s.plan.cost for _, s in steps], float),
        "distance": np.array([s.distance for _, s in steps], float),
        "blocked": np.array([s.blocked for _, s in steps], bool),
        "seconds": np.array([s.seconds for _, s in steps], float),
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
        row = {"episode": episode, "mode": ("push", "pick")[int(plan["mode"][k])], "start": start, "end": end}
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
