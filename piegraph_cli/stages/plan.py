"""Stage `plan`: strokes towards a goal, closed loop in a simulated environment or for a cloud seen by a robot."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import mode_word
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.stages import train
from piegraph_cli.workspace.call import Call
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.planning.episode import Episode
    from piegraph_cli.planning.goals import Goal
    from piegraph_cli.planning.model import Model
    from piegraph_cli.workspace.run import Run


METRICS = {"distance": "particle distance", "emd": "earth mover's distance", "chamfer": "chamfer distance"}
"""What distances to the goal are called."""


def _units(run: "Run") -> Sequence[Unit]:
    return [None]


def _inputs(run: "Run", unit: Unit) -> Inputs:
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
    version=6,
    run="piegraph_cli.stages.plan:run",
    unit="run",
    on_demand=True,
    units=_units,
    inputs=_inputs,
    call=Call(
        first=("env", "state", "goal", "goal_pose", "model", "horizon", "samples", "strokes", "episodes"),
        remembers=False,  # each question stands for itself: an old goal must not move a robot
        describe="piegraph_cli.stages.plan:describe",
    ),
)


def run(inputs: dict[str, Any], params: PlanParams, context: Context) -> Output:
    """Plan in `--env`, or once from `--state`."""
    from piegraph_cli.planning.episode import play, tool_of
    from piegraph_cli.planning.goals import Goal
    from piegraph_cli.planning.model import Model
    from piegraph_cli.planning.planner import tool_warnings
    from piegraph_cli.process import choose_device, set_up_torch
    from piegraph_cli.stages.learning import read_model
    from piegraph_cli.stages.steps import open_environment

    _check_question(params)
    set_up_torch()
    trained, warnings = read_model(inputs["model"]) if "model" in inputs else None, []
    model = Model(params.model, trained, params, choose_device(context.device))
    if params.state is not None:
        episodes = [_plan_once(model, params)]
    else:

        def wanted(state: "np.ndarray", sample: Callable[[], "np.ndarray"]) -> Goal:
            return _given_goal(params, state) or Goal.of_particles(sample())

        environment = open_environment(params, model)
        numbers = context.progress(range(params.episodes), "plan")
        episodes = [play(environment, trained, params, wanted, start=i, goal=i, device=model.device) for i in numbers]
        warnings = tool_warnings(params, tool_of(environment))
    arrays = _arrays(episodes, params)
    return Output(arrays, _quality(arrays, params), warnings)


def _check_question(params: PlanParams) -> None:
    if (params.env is None) == (params.state is None):
        raise UsageError("give either --env or --state", "piegraph plan", "as in piegraph plan --run RUN --env tblock")
    if params.state is not None and params.goal is None and params.goal_pose is None:
        raise UsageError("--state needs a goal", "piegraph plan", "give --goal FILE or --goal-pose DX,DY,DYAW")
    if params.goal is not None and params.goal_pose is not None:
        raise UsageError("give one goal, not two", "piegraph plan", "--goal or --goal-pose")


def _plan_once(model: "Model", params: PlanParams) -> "Episode":
    from piegraph_cli.stages.points import read_points

    assert params.state is not None
    goal = read_points(*params.goal_file()) if params.goal is not None else None
    state = read_points(params.state, None)
    try:
        return model.plan(state, goal=goal, goal_pose=params.goal_pose)
    except DataError as error:
        asked = f"{params.state}, {'--goal ' + params.goal if params.goal else '--goal-pose'}"
        raise DataError(error.message, asked, error.hint) from None


def _given_goal(params: PlanParams, state: "np.ndarray") -> "Goal | None":
    """The goal that the settings name, for the object's particles now [N, 3] (m)."""
    from piegraph_cli.planning.goals import Goal, move_in_plane
    from piegraph_cli.stages.points import read_points

    if params.goal is not None:
        return Goal.of_cloud(read_points(*params.goal_file()), state, state)
    if params.goal_pose is not None:
        return Goal.of_particles(move_in_plane(state, params.goal_pose))
    return None


def _arrays(episodes: list["Episode"], params: PlanParams) -> dict[str, "np.ndarray"]:
    import numpy as np

    from piegraph_cli.stages.steps import step_arrays

    particles = len(episodes[0].start)
    return step_arrays([step for episode in episodes for step in episode.steps], particles) | {
        "goal": np.array([episode.goal for episode in episodes]),
        "metric": np.array([episode.metric for episode in episodes]),
        "seed": np.full(len(episodes), params.seed),
        "start_distance": np.array([episode.start_distance for episode in episodes]),
        "end_distance": np.array([episode.end_distance for episode in episodes]),
        "episode": np.repeat(np.arange(len(episodes)), [len(episode.steps) for episode in episodes]),
    }


def _quality(arrays: dict[str, "np.ndarray"], params: PlanParams) -> str:
    import numpy as np

    of = METRICS[str(arrays["metric"][0])]
    if params.state is not None and len(arrays["stroke"]) == 0:
        start = arrays["start_distance"][0] * 100
        return f"no stroke: {start:.1f} cm of {of} from the goal already, success is {params.success * 100:g} cm"
    if params.state is not None:
        return f"{len(arrays['stroke'])} strokes, predicted {of} {arrays['cost'][-1] * 100:.1f} cm"
    solved = arrays["end_distance"] < params.success
    counts = [int((arrays["episode"] == i).sum()) for i in np.flatnonzero(solved)]
    mean = f", {np.mean(counts):.1f} strokes each" if counts else ""
    return f"{int(solved.sum())} of {len(solved)} goals below {params.success * 100:g} cm of {of}{mean}"


def describe(run: "Run") -> tuple[dict[str, Any], list[str]]:
    """A run's plan as one object and as lines for people; strokes are in the world frame, metres."""
    import numpy as np

    plan = run.read(STAGE.writes)
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
    value |= {"metric": plan.texts("metric")[0], "start_distance": plan["start_distance"].tolist()}
    return value if np.isnan(ends).all() else value | {"end_distance": ends}, lines
