"""Episodes of planning in a simulated environment, for `plan` and `trials`, and the planner that both make from settings."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.dynamics.models import make_predict
from piegraph_cli.dynamics.params import trained_label
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import MODE_NAMES, PICK, PUSH
from piegraph_cli.planning.costs import Cost, make_cost
from piegraph_cli.planning.greedy import put_worst_right
from piegraph_cli.planning.mpc import Step, run_episode
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import CLEARANCE, DEPTH, StrokeSpace, solid_edges
from piegraph_cli.planning.search import Plan, plan_strokes
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages.learning import read_model
from piegraph_cli.stages.simulate import make_environment
from piegraph_cli.workspace.artifact import Artifact


@dataclass(frozen=True)
class Episode:
    """One attempt at a goal."""

    start: np.ndarray
    """[N, 3] metres."""
    goal: np.ndarray
    """[G, 3] metres."""
    steps: list[Step]
    start_distance: float
    """To the goal, by the planner's cost, metres."""
    end_distance: float
    """NaN where nothing was carried out."""


@dataclass(frozen=True)
class Goal:
    """Where the object shall be."""

    points: np.ndarray
    """[G, 3] metres."""
    corresponds: bool
    """Whether its points are the object's particles, one by one."""


def play(
    model: Artifact | None,
    params: PlanParams,
    choose_goal: Callable[[np.ndarray, Callable[[], np.ndarray]], Goal] | None = None,
    *,
    start: int,
    goal: int,
) -> tuple[Episode, np.ndarray]:
    """Plan in `params.env` from start number `start` to goal number `goal`: the episode, and the last state [N, 3] (m).

    Starts and goals follow from `params.seed` and their numbers alone, so that every model meets the same ones; a goal
    is drawn relative to the start. `choose_goal(state, sample)` may give another goal than the environment's.
    `model` may be None where `params.model` is not trained; there are 50 particles then.
    """
    set_up_torch()
    particles = int(model["particles"]) if model is not None else 50
    environment = make_environment(str(params.env), particles, params)
    state, _ = environment.reset(seed=int(np.random.SeedSequence([params.seed, 0, start]).generate_state(1)[0]))
    rng = np.random.default_rng([params.seed, 1, goal])
    wanted = choose_goal(state, lambda: environment.goal(rng)) if choose_goal else Goal(environment.goal(rng), True)
    cost, make_plan = make_planner(model, state, wanted, params, environment.modes, [params.seed, 2, start, goal])

    def act(stroke: torch.Tensor) -> tuple[np.ndarray, bool]:
        begin, end = stroke[:4].numpy().astype(float).reshape(2, 2)
        after, _, _, _, info = environment.step({"start": begin, "end": end, "mode": int(stroke[4])})
        return after, info["blocked"]

    seeing = np.random.default_rng([params.seed, 3, start, goal])

    def look(positions: torch.Tensor) -> Plan | None:
        return make_plan(positions + torch.as_tensor(seeing.normal(0, params.state_noise, positions.shape)).float())

    steps = list(run_episode(state, look, act, cost, strokes=params.strokes, success=params.success))
    first = float(cost(torch.as_tensor(state)[None])[0])
    last = steps[-1].after if steps else state
    return Episode(state, wanted.points, steps, first, steps[-1].distance if steps else first), last


def make_planner(
    model: Artifact | None,
    state: np.ndarray,
    goal: Goal,
    params: PlanParams,
    known: tuple[int, ...] | None,
    seed: list[int],
) -> tuple[Cost, Callable[[torch.Tensor], Plan | None]]:
    """The cost, and the function that plans from positions [N, 3] (m), for the object whose rest state is `state` [N, 3].

    `known` are the modes of the environment (None: a robot, which has all).
    """
    check_inside(goal.points, params, "the goal")
    kind = params.cost if params.cost != "auto" else "distance" if goal.corresponds else "chamfer"
    target = torch.as_tensor(goal.points)
    cost = make_cost(kind, target, len(state))
    needed = trained_label(params.model) is not None and params.planner != "greedy"
    learned = tuple(int(m) for m in model["modes"]) if needed and model is not None else None
    modes = choose_modes(params, learned, known)
    if params.planner == "greedy":
        if PICK not in modes or not goal.corresponds:
            raise UsageError("the greedy planner picks, and needs to know which particle belongs where", "plan.planner")
        return cost, lambda positions: put_worst_right(positions, target, cost)
    trained = read_model(model) if needed and model is not None else None
    predict = make_predict(params.model, trained, torch.as_tensor(state), params)
    space = stroke_space(torch.as_tensor(state), params, modes)
    generator = torch.Generator().manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))
    return cost, lambda positions: plan_strokes(positions, predict, cost, space, params, generator)


def stroke_space(state: torch.Tensor, params: PlanParams, modes: tuple[int, ...]) -> StrokeSpace:
    """The strokes to search for an object whose rest state is `state` [N, 3] (m).

    Raises `UsageError` if the longest push ends before it has gone into the object.
    """
    shortest = CLEARANCE + DEPTH * params.pusher_radius
    if PUSH in modes and params.max_length <= shortest:
        raise UsageError(
            f"pushes of {params.max_length:g} m at most do not go into the object with this pusher",
            "plan.max_length",
            f"more than {shortest:g}",
        )
    return StrokeSpace(
        modes,
        solid_edges(state),
        params.min_length,
        params.max_length,
        params.max_carry,
        params.pusher_radius,
        params.margin,
        params.workspace,
    )


def choose_modes(params: PlanParams, learned: tuple[int, ...] | None, known: tuple[int, ...] | None) -> tuple[int, ...]:
    """The modes to plan with: those asked for, else those that model and environment share; None means all."""
    wanted = tuple(MODE_NAMES.index(name) for name in params.modes) or None
    for has, what in ((learned, "the model was trained on"), (known, f"{params.env} knows")):
        names = [MODE_NAMES[m] for m in has or ()]
        missing = [MODE_NAMES[m] for m in wanted or () if has is not None and m not in has]
        if missing:
            raise UsageError(f"no {missing[0]} can be planned: {what} {', '.join(names)} only", "plan.modes")
    modes = wanted or tuple(m for m in (PUSH, PICK) if all(has is None or m in has for has in (learned, known)))
    if not modes:
        raise UsageError(
            f"the model was trained on {MODE_NAMES[(learned or (PUSH,))[0]]} strokes, which {params.env} does not know",
            "plan",
            "train on strokes of this environment",
        )
    return modes


def check_inside(points: np.ndarray, params: PlanParams, what: str) -> None:
    """Refuse points [P, 3] (m) whose middle lies outside the workspace. Raises DataError."""
    xmin, xmax, ymin, ymax = params.workspace[:4]
    x, y = points[:, :2].mean(0)
    if not (xmin <= x <= xmax and ymin <= y <= ymax):
        raise DataError(
            f"{what} lies around ({x:.2f}, {y:.2f}) m, outside plan.workspace",
            hint="points are metres in the world frame; correct them, or widen --workspace",
        )


def step_arrays(steps: list[Step], particles: int) -> dict[str, np.ndarray]:
    """What is kept of steps, as the datasets that `plan` and `trials` share."""
    strokes = np.array([s.plan.strokes[0].numpy() for s in steps], float).reshape(-1, 7)
    looked = [s.plan.candidates for s in steps]
    candidates = np.array([c.strokes.numpy() for c in looked]) if steps else np.zeros((0, 0, 0, 0, 7))
    shape = candidates.shape[:-1]

    def states(values: list[np.ndarray]) -> np.ndarray:
        return np.array(values, np.float32).reshape(len(values), particles, 3)

    return {
        "stroke": strokes[:, :4].reshape(-1, 2, 2),
        "mode": strokes[:, 4],
        "before": states([s.before for s in steps]),
        "predicted": states([s.plan.predicted[0].numpy() for s in steps]),
        "after": states([s.after for s in steps]),
        "cost": np.array([s.plan.cost for s in steps], float),
        "distance": np.array([s.distance for s in steps], float),
        "blocked": np.array([s.blocked for s in steps], bool),
        "seconds": np.array([s.seconds for s in steps], float),
        "candidate_stroke": candidates[..., :4].reshape(*shape, 2, 2),
        "candidate_mode": np.nan_to_num(candidates[..., 4]),
        "candidate_cost": np.array([c.costs.numpy() for c in looked]).reshape(shape[:3]),
        "candidate_weight": np.array([c.weights.numpy() for c in looked]).reshape(shape[:3]),
    }
