"""The planner that settings ask for, for one object and one goal."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained, make_foresee, recordable
from piegraph_cli.dynamics.params import trained_label
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK, PUSH, mode_number, mode_word
from piegraph_cli.planning.costs import Cost, make_cost
from piegraph_cli.planning.experience import Tried
from piegraph_cli.planning.goals import Goal
from piegraph_cli.planning.greedy import put_worst_right
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import CLEARANCE, DEPTH, StrokeSpace, solid_edges
from piegraph_cli.planning.search import Plan, Search

MakePlan = Callable[[torch.Tensor, Sequence[Tried]], Plan | None]
"""From particles now [N, 3] (m) and the episode's strokes so far; None where no stroke is feasible."""


@dataclass(frozen=True)
class Tool:
    """What acts: a robot by default."""

    modes: tuple[int, ...] | None = None
    """What it can do; None: everything."""
    pusher_radius: float | None = None
    """Metres; None where it is not known."""


def make_planner(
    trained: Trained | None,
    state: np.ndarray,
    goal: Goal,
    params: PlanParams,
    tool: Tool,
    seed: list[int],
    device: str = "cpu",
) -> tuple[Cost, MakePlan]:
    """The cost, and the function that plans for the object whose rest state is `state` [N, 3].

    `trained` is None where `params.model` is not trained. The search is on `device`, all that is given and returned on the CPU.
    """
    check_inside(goal.points, params, "the goal")
    kind = metric(params, goal)
    target = torch.as_tensor(goal.points if kind != "distance" or goal.particles is None else goal.particles)
    cost = make_cost(kind, target, len(state))
    needed = trained_label(params.model) is not None and params.planner != "greedy"
    modes = choose_modes(params, trained.modes if needed and trained else None, tool.modes)
    if params.planner == "greedy":
        if PICK not in modes or goal.particles is None:
            raise UsageError("the greedy planner picks, and needs to know which particle belongs where", "plan.planner")
        places, radius = torch.as_tensor(goal.particles[0]), pusher_radius(params, tool)
        picks = stroke_space(torch.as_tensor(state), params, (PICK,), radius)
        return cost, lambda positions, _: put_worst_right(positions, places, cost, picks)
    rest = torch.as_tensor(state, device=device)
    calibration = trained.calibration if trained else None
    foresee = make_foresee(params.model, trained, rest, params, calibration is not None)
    space = stroke_space(rest, params, modes, pusher_radius(params, tool))
    generator = torch.Generator(device).manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))
    record = rest.is_cuda and recordable(params.model) and len(modes) == 1 and kind != "emd"
    there = make_cost(kind, target.to(rest), len(state))
    return cost, Search(foresee, there, space, params, generator, record, calibration)


def metric(params: PlanParams, goal: Goal) -> str:
    """What distance decides: the one asked for; of particles where their goal is known; else earth mover's.

    Chamfer distance does not tell a turned thing from one in place: it is used on demand alone.
    """
    return params.cost if params.cost != "auto" else "emd" if goal.particles is None else "distance"


def pusher_radius(params: PlanParams, tool: Tool) -> float:
    """The tool's own (m) where it is known, unless the settings ask for one: for another than their default.

    A value, not whether it was given, decides: keys of artifacts know values alone.
    """
    asked = params.pusher_radius != type(params).model_fields["pusher_radius"].default
    return params.pusher_radius if asked or tool.pusher_radius is None else tool.pusher_radius


def tool_warnings(params: PlanParams, tool: Tool) -> list[str]:
    """What to tell where the settings overrule the tool."""
    planned = pusher_radius(params, tool)
    if tool.pusher_radius is None or planned == tool.pusher_radius:
        return []
    return [
        f"planned with plan.pusher_radius {planned:g} m, while the pusher of {params.env} has {tool.pusher_radius:g} m: "
        "leave the setting out"
    ]


def stroke_space(state: torch.Tensor, params: PlanParams, modes: tuple[int, ...], radius: float) -> StrokeSpace:
    """The strokes to search for an object whose rest state is `state` [N, 3] (m), with a pusher of that radius (m).

    Raises `UsageError` if the longest push ends before it has gone into the object.
    """
    shortest = CLEARANCE + DEPTH * radius
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
        radius,
        params.margin,
        params.workspace,
        params.retreat,
        params.keep_out,
    )


def choose_modes(params: PlanParams, learned: tuple[int, ...] | None, known: tuple[int, ...] | None) -> tuple[int, ...]:
    """The modes to plan with: those asked for, else those that model and environment share; None means all."""
    wanted = tuple(mode_number(name) for name in params.modes) or None
    for has, what in ((learned, "the model was trained on"), (known, f"{params.env} knows")):
        names = [mode_word(m) for m in has or ()]
        missing = [mode_word(m) for m in wanted or () if has is not None and m not in has]
        if missing:
            raise UsageError(f"no {missing[0]} can be planned: {what} {', '.join(names)} only", "plan.modes")
    modes = wanted or tuple(m for m in (PUSH, PICK) if all(has is None or m in has for has in (learned, known)))
    if not modes:
        raise UsageError(
            f"the model was trained on {mode_word((learned or (PUSH,))[0])} strokes, which {params.env} does not know",
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
