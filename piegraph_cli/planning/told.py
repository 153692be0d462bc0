"""What a plan is kept and told as: arrays of the steps of episodes, and rows for a robot, in the frame it asks for."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from piegraph_cli.params import mode_word
from piegraph_cli.planning.goals import thinned
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.path import PICK_PARTS, PUSH_PARTS, WAY_POINTS, tool_path
from piegraph_cli.planning.search import INFEASIBLE
from piegraph_cli.recording.ground import moved

if TYPE_CHECKING:
    from piegraph_cli.planning.episode import Episode
    from piegraph_cli.planning.mpc import Step
    from piegraph_cli.planning.question import Answer


def plan_arrays(episodes: "Sequence[Episode]", params: PlanParams) -> dict[str, np.ndarray]:
    """What is kept of episodes [E], with S steps in all: the datasets of the artifact `plan`, in its units."""
    particles, steps = len(episodes[0].start), [step for episode in episodes for step in episode.steps]
    least = min(len(episode.goal) for episode in episodes)  # clouds have as many points as were seen
    return (
        step_arrays(steps, particles)
        | _path_arrays(steps, params)
        | {
            "goal": np.array([thinned(episode.goal, least) for episode in episodes]),
            "metric": np.array([episode.metric for episode in episodes]),
            "seed": np.full(len(episodes), params.seed),
            "start_distance": np.array([episode.start_distance for episode in episodes]),
            "end_distance": np.array([episode.end_distance for episode in episodes]),
            "ending": np.array([episode.ending for episode in episodes]),
            "episode": np.repeat(np.arange(len(episodes)), [len(episode.steps) for episode in episodes]),
        }
    )


def _path_arrays(steps: "Sequence[Step]", params: PlanParams) -> dict[str, np.ndarray]:
    """The tool's path [S, W, 3] (m) of each step, with its times [S, W] (s); NaN where there are fewer way points."""
    found = {
        "path": np.full((len(steps), WAY_POINTS, 3), np.nan, np.float32),
        "path_time": np.full((len(steps), WAY_POINTS), np.nan),
        "path_closed": np.zeros((len(steps), WAY_POINTS), bool),
    }
    for k, step in enumerate(steps):
        stroke = step.plan.strokes[0]
        path = tool_path(stroke.ends.numpy(), int(stroke.mode), step.before, params)
        for name, values in (("path", path.points), ("path_time", path.times), ("path_closed", path.closed)):
            found[name][k, : len(values)] = values
    return found


def step_arrays(steps: "list[Step]", particles: int) -> dict[str, np.ndarray]:
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
        "expected_error": np.array([float(s.plan.errors[0]) for s in steps], float),
        "distance": np.array([s.distance for s in steps], float),
        "blocked": np.array([s.blocked for s in steps], bool),
        "seconds": np.array([s.seconds for s in steps], float),
        "candidate_stroke": np.array([c.strokes.ends.numpy() for c in looked]).reshape(*shape, 2, 2),
        "candidate_mode": np.array([c.strokes.mode.numpy() for c in looked]).reshape(shape),
        "candidate_cost": np.array([c.costs.numpy() for c in looked]).reshape(shape[:3]),
        "candidate_weight": np.array([c.weights.numpy() for c in looked]).reshape(shape[:3]),
    }


def answer_value(answer: "Answer", params: PlanParams, T: np.ndarray | None, candidates: int = 0) -> dict[str, Any]:
    """An answer under these settings as one object of plain numbers: strokes with the tool's path, the particles after each,
    distances (m), warnings; and, where `candidates` are asked for, so many of the best that were looked at.

    Told by `T_frame_table` [4, 4] as in `stroke_in`.
    """
    strokes = stroke_rows(plan_arrays([answer], params), T)
    for row, points in zip(strokes, answer.predicted, strict=True):
        row["predicted"] = (points if T is None else moved(points, T)).tolist()
        del row["episode"]
    value = {
        "strokes": strokes,
        "metric": answer.metric,
        "start_distance": answer.start_distance,
        "expected_gain": _number(answer.expected_gain),
        "warnings": list(answer.warnings),
        "units": "m",
    }
    return value | ({"candidates": _best(answer, T, candidates)} if candidates and strokes else {})


def _best(answer: "Answer", T: np.ndarray | None, count: int) -> list[dict[str, Any]]:
    """The cheapest sequences of strokes that were looked at and can be carried out, each with its cost (m)."""
    looked = answer.steps[0].plan.candidates
    costs = looked.costs.flatten().nan_to_num(nan=torch.inf)
    ends, modes = looked.strokes.ends.flatten(0, 1).numpy(), looked.strokes.mode.flatten(0, 1)
    best = [int(k) for k in costs.argsort(stable=True)[:count] if costs[k] < INFEASIBLE]
    return [
        {
            "cost": float(costs[k]),
            "strokes": [
                {"mode": mode_word(int(mode))} | stroke_in(T, pair)
                for pair, mode in zip(ends[k], modes[k], strict=True)
            ],
        }
        for k in best
    ]


def stroke_rows(plan: Mapping[str, np.ndarray], T: np.ndarray | None) -> list[dict[str, Any]]:
    """The strokes of `plan_arrays`, or of the artifact, one object each; lengths in metres, told by T as in `stroke_in`."""
    rows = []
    for k, ends in enumerate(plan["stroke"]):
        row: dict[str, Any] = {"episode": int(plan["episode"][k]), "mode": mode_word(int(plan["mode"][k]))}
        row |= stroke_in(T, ends) | {"predicted_distance": float(plan["cost"][k])}
        row["expected_error"] = _number(plan["expected_error"][k])
        if np.isfinite(plan["distance"][k]):
            row |= {"distance": float(plan["distance"][k]), "blocked": bool(plan["blocked"][k])}
        row["path"] = _path_rows(plan, k, T)
        rows.append(row)
    return rows


def _number(value: float) -> float | None:
    """None for what is not known: NaN is no JSON."""
    return float(value) if np.isfinite(value) else None


def _path_rows(plan: Mapping[str, np.ndarray], k: int, T: np.ndarray | None) -> list[dict[str, Any]]:
    """The way points of step k: time (s), the tip's place [3] (m), what it ends, whether a gripper is closed from there on."""
    known = np.isfinite(plan["path_time"][k])
    points = plan["path"][k][known].astype(float)
    points = points if T is None else moved(points, T)
    parts = PICK_PARTS if known.all() else PUSH_PARTS
    rows = zip(plan["path_time"][k][known], points, parts, plan["path_closed"][k][known], strict=True)
    return [
        {"time": float(time), "point": point.tolist(), "part": part, "closed": bool(closed)}
        for time, point, part, closed in rows
    ]


def stroke_in(T: np.ndarray | None, ends: np.ndarray) -> dict[str, Any]:
    """A stroke's ends [2, 2] (m) as they are told: on the table (two numbers), or by T [4, 4] in another frame.

    There they have three numbers each, and `quaternion_xyzw` turns that frame's axes to x along the stroke and z up from
    the table; `yaw` (rad) is the stroke's heading about that frame's z.
    """
    if T is None:
        return {"start": ends[0].tolist(), "end": ends[1].tolist()}
    from scipy.spatial.transform import Rotation

    start, end = (T[:3, :3] @ [*xy, 0] + T[:3, 3] for xy in ends.astype(float))
    up, along = T[:3, 2], (end - start) / np.linalg.norm(end - start)
    turn = Rotation.from_matrix(np.column_stack([along, np.cross(up, along), up]))
    return {
        "start": start.tolist(),
        "end": end.tolist(),
        "yaw": float(np.arctan2(along[1], along[0])),
        "quaternion_xyzw": turn.as_quat(canonical=True).tolist(),
    }
