"""Episodes of planning in a simulated environment, closed loop."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.planning.experience import Tried
from piegraph_cli.planning.goals import Goal
from piegraph_cli.planning.mpc import Ending, Step, run_episode
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Tool, check_inside, make_planner, metric
from piegraph_cli.planning.search import Plan

APART = 0.05
"""Mean distance of particles between a start and a goal in place at least, metres: nearer, there is nothing to plan."""

TRIES = 100
"""Starts that are drawn until one is that far away."""


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
    metric: str
    """What distances are: `distance` of particles, `emd` or `chamfer`."""
    ending: Ending
    """Why it ended."""
    true: tuple[np.ndarray, ...] = ()
    """[N, 3] metres each: the states as they were, at the start and after each stroke, where `steps` has what cameras saw."""
    copies: np.ndarray | None = None
    """[K, N, 3] metres: the goal's particles in every way of lying there that no cloud can tell apart, where it is known."""
    said: tuple[str, ...] = ()
    """What was wrong with looks."""

    @property
    def strokes(self) -> Strokes | None:
        """The strokes [S] in their order; None where there is none."""
        return Strokes.stack([step.plan.strokes[0] for step in self.steps]) if self.steps else None

    @property
    def predicted(self) -> np.ndarray:
        """The object [S, N, 3] (m) as it is expected after each stroke."""
        return np.array([step.plan.predicted[0].numpy() for step in self.steps]).reshape(-1, *self.start.shape)

    @property
    def states(self) -> list[np.ndarray]:
        """The object [N, 3] (m) at the start, and after each stroke."""
        return [self.start, *(step.after for step in self.steps)]


def play(
    environment: Any,
    trained: Trained | None,
    params: PlanParams,
    choose_goal: Callable[[np.ndarray], Goal] | None = None,
    *,
    start: int,
    goal: int,
    device: str = "cpu",
) -> Episode:
    """Plan in an environment (`environments.base.Environment`) from start number `start` to goal number `goal`.

    Starts and goals follow from `params.seed` and their numbers alone, so that every model meets the same ones.
    `choose_goal(state)` may give another goal than the environment's. `trained` may be None where `params.model` is not
    trained. Strokes are searched on `device`.
    """
    state, wanted = _task(environment, params, choose_goal, start, goal)
    params = within(params, environment.walls)
    tool, seed = tool_of(environment), [params.seed, 2, start, goal]
    cost, make_plan = make_planner(trained, state, wanted, params, tool, seed, device)

    def act(stroke: Strokes) -> tuple[np.ndarray, bool]:
        after, _, _, _, info = environment.step(stroke.action())
        return after, info["blocked"]

    seeing = np.random.default_rng([params.seed, 3, start, goal])

    def look(positions: torch.Tensor, tried: Sequence[Tried]) -> Plan | None:
        noise = torch.as_tensor(seeing.normal(0, params.state_noise, positions.shape)).float()
        return make_plan(positions + noise, tried)

    limits = {name: getattr(params, name) for name in ("strokes", "success", "look_every", "stop")}
    steps, ending = run_episode(state, look, act, cost, **limits)
    first = float(cost(torch.as_tensor(state)[None])[0])
    last = steps[-1].distance if steps else first
    return Episode(state, wanted.points, steps, first, last, metric(params, wanted), ending)


def within(params: PlanParams, walls: tuple[float, float, float, float] | None) -> PlanParams:
    """The settings with strokes inside an environment's walls, at which a tool would stop short of where it was sent."""
    if walls is None:
        return params
    given = params.workspace
    bounds = [(min if k % 2 else max)(given[k], wall) for k, wall in enumerate(walls)]
    return params.model_copy(update={"workspace": (*bounds, *given[4:])})


def _task(
    environment: Any, params: PlanParams, choose_goal: Callable[[np.ndarray], Goal] | None, start: int, goal: int
) -> tuple[np.ndarray, Goal]:
    """Particles [N, 3] (m) of a start, at which the environment then is, and the goal."""
    state, drawn = draw_task(environment, params, start, goal, None if choose_goal else environment.goal)
    return state, choose_goal(state) if choose_goal else Goal.of_particles(drawn)


def draw_task(
    environment: Any, params: PlanParams, start: int, goal: int, draw: Callable | None
) -> tuple[np.ndarray, Any]:
    """Particles [N, 3] (m) of a start, at which the environment then is, and what `draw(rng)` makes its goal, if anything.

    A goal in place is one from a start of its own number; a start that coincides with it is drawn again.
    """
    rng = np.random.default_rng([params.seed, 1, goal])
    if draw is None or not params.fixed_goals:
        state = _start(environment, params.seed, start)
        return state, None if draw is None else draw(rng)
    environment.reset(seed=_number(params.seed, 4, goal))
    drawn = draw(rng)
    place = getattr(drawn, "particles", drawn)
    for again in range(TRIES):
        state = _start(environment, params.seed, start, again)
        if np.linalg.norm(state - place, axis=1).mean() > APART:
            return state, drawn
    hint = "a larger object, or options of the environment with goals that differ from its starts"
    raise DataError(f"every start lies within {APART * 100:g} cm of goal {goal}", str(params.env), hint)


def _start(environment: Any, seed: int, start: int, again: int = 0) -> np.ndarray:
    """Reset to start number `start`, as it is drawn for the first time or again: particles [N, 3] (m)."""
    return environment.reset(seed=_number(seed, 0, start, *[again] * (again > 0)))[0]


def _number(*entropy: int) -> int:
    return int(np.random.SeedSequence(entropy).generate_state(1)[0])


def tool_of(environment: Any) -> Tool:
    """What acts in an environment that has been reset: only then is the pusher of some known."""
    return Tool(environment.modes, environment.pusher_radius)


def plan_once(
    trained: Trained | None,
    state: np.ndarray,
    goal: Goal,
    params: PlanParams,
    device: str = "cpu",
    rest: np.ndarray | None = None,
) -> Episode:
    """Plan strokes for a robot that sees the object's particles `state` [N, 3] (m): steps that nobody has carried out.

    `rest` [N, 3] (m) is its rest shape, by default the state.

    No steps where the goal is reached already. Raises `DataError` where no stroke is feasible.
    """
    check_inside(state, params, "the object")
    shape = state if rest is None else rest
    cost, make_plan = make_planner(trained, shape, goal, params, Tool(), [params.seed, 2, 0, 0], device)
    start = float(cost(torch.as_tensor(state)[None])[0])
    if start < params.success:
        return Episode(state, goal.points, [], start, start, metric(params, goal), "reached")
    plan = make_plan(torch.as_tensor(state), ())
    if plan is None:
        clear = " and outside the boxes of plan.keep_out" if params.keep_out else ""
        hint = f"widen plan.workspace{', make the boxes smaller' if params.keep_out else ''} or move the object"
        raise DataError(f"no stroke touches the object inside the workspace{clear}", hint=hint)
    steps, before, unknown = [], state, np.full_like(state, np.nan)
    for k in range(len(plan.strokes)):
        steps.append(Step(plan.later(k, cost), before, unknown, float("nan"), False, 0.0))
        before = plan.predicted[k].numpy()
    return Episode(state, goal.points, steps, start, float("nan"), metric(params, goal), "planned")
