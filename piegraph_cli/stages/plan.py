"""Stage `plan`: strokes towards a goal, closed loop in a simulated environment or for a cloud seen by a robot."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError, UsageError, command_line
from piegraph_cli.planning.params import Place, PlanParams
from piegraph_cli.stages import evaluate, train
from piegraph_cli.stages.seen import true_distances
from piegraph_cli.stages.steps import check_environments
from piegraph_cli.text import counted
from piegraph_cli.workspace.call import Call
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from piegraph_cli.planning.episode import Episode
    from piegraph_cli.planning.goals import Goal
    from piegraph_cli.planning.model import Model
    from piegraph_cli.planning.question import Answer
    from piegraph_cli.workspace.run import Run


HELPLESS = "no stroke is expected to help"
"""Of `planning.mpc.Ending`, which is not imported here: it imports torch."""

METRICS = {"distance": "particle distance", "emd": "earth mover's distance", "chamfer": "chamfer distance"}
"""What distances to the goal are called."""


def _units(run: "Run") -> Sequence[Unit]:
    return [None]


def _inputs(run: "Run", unit: Unit) -> Inputs:
    """The trained model, where one is used, and its metrics, where it was evaluated: they say how far off it may be."""
    label = run.params(STAGE.name).model
    name = train.model_name(label, run.params("train").seeds_of(label)[0])
    model = train.trained_name(name)
    read: Inputs = {"model": model} if model else {}
    return read | {"metrics": name} if model and evaluate.measured(run, name) else read


def _settings(run: "Run", unit: Unit) -> PlanParams:
    """A robot's clouds lie in the world of the cameras: the table is where it is in the run's recording."""
    params: PlanParams = run.params(STAGE.name)
    if params.state is None or params.table is not None:
        return params
    return params.model_copy(update={"table": run.params("ingest").table})


def _check(run: "Run", units: Sequence[Unit], processes: int) -> list[str]:
    params: PlanParams = run.params(STAGE.name)
    return check_environments([(params.env, params)], processes)


SAME = 1e-6
"""Metres, and parts of a rotation, within which the robot stands where it stood in another recording."""

STAGE = Stage(
    "plan",
    "plan strokes to a goal",
    ("model",),
    "plan",
    PlanParams,
    version=8,
    run="piegraph_cli.stages.plan:run",
    unit="run",
    optional=("metrics",),
    on_demand=True,
    units=_units,
    settings=_settings,
    inputs=_inputs,
    check=_check,
    call=Call(
        first=(
            "env",
            "state",
            "goal",
            "goal_pose",
            "goal_at",
            "model",
            "look",
            "horizon",
            "samples",
            "strokes",
            "episodes",
        ),
        remembers=False,  # each question stands for itself: an old goal must not move a robot
        describe="piegraph_cli.stages.plan:describe",
        refuses="piegraph_cli.stages.seen:refused",
        out=True,
    ),
)


def run(inputs: dict[str, Any], params: PlanParams, context: Context) -> Output:
    """Plan in `--env`, or once from `--state`."""
    from piegraph_cli.process import choose_device, imports_at_once, set_up_torch

    _check_question(context.run, params)
    with imports_at_once():
        from piegraph_cli.planning.model import Model
        from piegraph_cli.planning.told import plan_arrays
        from piegraph_cli.stages.learning import calibrated, read_model
    set_up_torch()
    trained = calibrated(read_model(inputs["model"]), inputs.get("metrics")) if "model" in inputs else None
    model = Model(params.model, trained, params, choose_device(context.device))
    if params.state is None:
        episodes, warnings = _play(model, params, context)
    else:
        state, warnings = _state(params, context)
        found = _answer(model, params, state)
        warnings += [f"{params.state}: {warning}" for warning in found.warnings]
        episodes = [found]
    arrays = plan_arrays(episodes, params) | true_distances(episodes)
    return Output(arrays, _quality(arrays, params), warnings)


def _play(model: "Model", params: PlanParams, context: Context) -> tuple[list["Episode"], list[str]]:
    """Closed loop in the environment `params.env`, and what is to be said of the tool."""
    from piegraph_cli.planning.episode import play, tool_of
    from piegraph_cli.planning.planner import tool_warnings
    from piegraph_cli.planning.question import wanted
    from piegraph_cli.planning.seeing import play_seen
    from piegraph_cli.stages.points import read_points
    from piegraph_cli.stages.steps import open_environment

    cloud = read_points(*params.goal_place()) if params.goal is not None else None
    asked = cloud is not None or params.goal_pose is not None or params.goal_at is not None

    def choose(state: "np.ndarray") -> "Goal":
        return wanted(model.trained, params, state, state, cloud)

    environment = open_environment(params, model)
    numbers, goals = context.progress(range(params.episodes), "episodes"), choose if asked else None
    episodes = []
    for i in numbers:
        task: dict[str, Any] = {"start": i, "goal": i, "device": model.device}
        if params.look == "cameras":
            episodes.append(play_seen(environment, model.trained, params, cloud, **task))
        else:
            episodes.append(play(environment, model.trained, params, goals, **task))
    said = [f"episode {i}: {text}" for i, episode in enumerate(episodes) for text in episode.said]
    return episodes, [*tool_warnings(params, tool_of(environment)), *said]


def _check_question(run: "Run", params: PlanParams) -> None:
    if (params.env is None) == (params.state is None):
        raise UsageError("give either --env or --state", "piegraph plan", "as in piegraph plan --run RUN --env tblock")
    goals = sum(goal is not None for goal in (params.goal, params.goal_pose, params.goal_at))
    if params.state is not None and not goals:
        hint = "give --goal FILE, --goal-pose DX,DY,DYAW (from where it is) or --goal-at X,Y,YAW (in the world)"
        raise UsageError("--state needs a goal", "piegraph plan", hint)
    if goals > 1:
        raise UsageError("give one goal, not two", "piegraph plan", "--goal, --goal-pose or --goal-at")
    if params.env is None and params.look == "cameras":
        raise UsageError(
            "--look is for --env: --state names what cameras see", "piegraph plan", "--state RECORDING/SEQUENCE"
        )
    if params.env is not None and (params.frame != "world" or params.table is not None):
        raise UsageError("--frame and --table are for --state: --env has a world of its own", "piegraph plan")
    told_in(run, params)


def _state(params: PlanParams, context: Context) -> tuple["np.ndarray", list[str]]:
    """The cloud [P, 3] (m) of the object now, and what is to be said of it: read, or seen in images."""
    place = params.state_place()
    if not place.file.is_dir():
        return _cloud(place, params), []
    from piegraph_cli.perception.look import look
    from piegraph_cli.stages.look import look_settings, read_scene

    run = context.run.folder
    of_run = run if (run / "recipe.toml").is_file() else None
    settings = look_settings(of_run, accept=params.accept, ingest={"table": params.table or (0, 0, 0)})
    seen = look(*read_scene(str(params.state)), settings)
    try:
        seen.require()
    except DataError as error:
        hint = f"{command_line('look', params.state, '--run', run, '--picture', 'now.png')} shows it; {error.hint}"
        raise DataError(error.message, str(params.state), hint) from None
    return seen.cloud, [f"{params.state}: {finding.text}" for finding in seen.findings]


def _answer(model: "Model", params: PlanParams, state: "np.ndarray") -> "Answer":
    from piegraph_cli.planning.question import answer

    goal = _cloud(params.goal_place(), params) if params.goal is not None else None
    try:
        return answer(model.trained, params, state, goal, rest=_rest(model, params), device=model.device)
    except DataError as error:
        asked = f"{params.state}, {_goal_given(params)}"
        raise DataError(error.message, asked, error.hint) from None


def _goal_given(params: PlanParams) -> str:
    """How the goal was given, as an option."""
    return f"--goal {params.goal}" if params.goal else "--goal-pose" if params.goal_pose else "--goal-at"


def _cloud(place: Place, params: PlanParams) -> "np.ndarray":
    """Points [P, 3] (m) of a file in the cameras' world."""
    from piegraph_cli.stages.points import read_points

    return _in_world(read_points(*place), place, params)


def _rest(model: "Model", params: PlanParams) -> "np.ndarray | None":
    """The rest shape [N, 3] (m) of a state that is a frame of a track of the model's particles; else None."""
    from piegraph_cli.stages.points import read_rest

    place = params.state_place()
    rest = read_rest(place.file)
    return None if rest is None or len(rest) != model.particles else _in_world(rest, place, params)


def _in_world(points: "np.ndarray", place: Place, params: PlanParams) -> "np.ndarray":
    """Points [P, 3] (m) of artifacts, which have the table at z = 0, are moved to the cameras' world."""
    import numpy as np

    from piegraph_cli.recording.ground import level, moved

    if place.file.suffix.lower() != ".h5":
        return points
    return moved(points, np.linalg.inv(level(params.table or (0, 0, 0))))


def _quality(arrays: dict[str, "np.ndarray"], params: PlanParams) -> str:
    import numpy as np

    of = METRICS[str(arrays["metric"][0])]
    if params.state is not None and len(arrays["stroke"]) == 0:
        start = arrays["start_distance"][0] * 100
        return f"no stroke: {start:.1f} cm of {of} from the goal already, success is {params.success * 100:g} cm"
    if params.state is not None:
        return f"{counted(len(arrays['stroke']), 'stroke')}, predicted {of} {arrays['cost'][-1] * 100:.1f} cm"
    solved = arrays["end_distance"] < params.success
    counts = [int((arrays["episode"] == i).sum()) for i in np.flatnonzero(solved)]
    mean = f", {np.mean(counts):.1f} strokes each" if counts else ""
    left = int((arrays["ending"] == HELPLESS).sum())
    given_up = f"; {counted(left, 'episode')} ended as {HELPLESS}" if left else ""
    return f"{int(solved.sum())} of {len(solved)} goals below {params.success * 100:g} cm of {of}{mean}{given_up}"


def describe(run: "Run") -> tuple[dict[str, Any], list[str]]:
    """A run's plan as one object and as lines for people; strokes are in the frame that was asked for, metres."""
    import numpy as np

    from piegraph_cli.planning.told import stroke_rows

    plan = run.read(STAGE.writes)
    params = _settings(run, None)
    T = told_in(run, params)
    rows, lines = stroke_rows(plan.arrays, T), [plan.quality]
    for row, true in zip(rows, plan.arrays.get("true_distance", ()), strict=False):
        row["true_distance"] = float(true)
    for row in rows:
        reached = f", reached {row['distance'] * 100:.1f} cm" if "distance" in row else ""
        reached += f" (truly {row['true_distance'] * 100:.1f})" if "true_distance" in row else ""
        unsure = "" if row["expected_error"] is None else f" (± {row['expected_error'] * 100:.1f})"
        start, end = (", ".join(f"{x:+.3f}" for x in row[name]) for name in ("start", "end"))
        lines.append(
            f"episode {row['episode']}: {row['mode']} from ({start}) to ({end}) m, "
            f"predicted {row['predicted_distance'] * 100:.1f} cm from the goal{unsure}{reached}"
        )
    if params.state is not None:
        lines += _path_lines(rows)
        lines.append(f"goal: {_goal_text(params)}")
    if params.frame == "robot":
        lines.append(f"in the robot's frame, by T_world_robot of {cameras_file(run, params)}")
    ends = plan["end_distance"].tolist()
    value = {"plan": str(plan.path), "quality": plan.quality, "strokes": rows, "frame": params.frame, "units": "m"}
    value |= {"goal": _goal_text(params)} if params.state is not None else {}
    value |= {"metric": plan.texts("metric")[0], "start_distance": plan["start_distance"].tolist()}
    if not np.isnan(ends).all():
        return value | {"end_distance": ends, "ending": plan.texts("ending")}, lines
    gain = float(plan["start_distance"][0] - plan["cost"][-1]) if len(plan["cost"]) else None
    return value | {"expected_gain": gain}, lines


def _path_lines(rows: list[dict[str, Any]]) -> list[str]:
    """A line for each stroke on the way of the tool around it."""
    lines = []
    for k, row in enumerate(rows):
        first, last = row["path"][0], row["path"][-1]
        above, to = (", ".join(f"{x:+.3f}" for x in point["point"]) for point in (first, last))
        lines.append(
            f"tool, stroke {k}: from above ({above}) to ({to}) m in {last['time']:.1f} s, way points with --json"
        )
    return lines


def _goal_text(params: PlanParams) -> str:
    """What the goal was, in which frame and units."""
    if params.goal_pose is not None:
        x, y, yaw = params.goal_pose
        return f"the object moved from where it is by ({x:+.3f}, {y:+.3f}) m, turned by {yaw:+.3f} rad about its middle"
    if params.goal_at is not None:
        x, y, yaw = params.goal_at
        return f"the trained rest shape, its middle at ({x:+.3f}, {y:+.3f}) m in the world, turned by {yaw:+.3f} rad"
    return f"the cloud {params.goal}"


def told_in(run: "Run", params: PlanParams) -> "np.ndarray | None":
    """`T_frame_table` of a run's plan, see `told_by`. Raises where the robot's frame is asked for and not known."""
    from piegraph_cli.recording.robot_files import read_robot

    return told_by(params, lambda: read_robot(cameras_file(run, params)))


def told_by(params: PlanParams, robot: "Callable[[], np.ndarray]") -> "np.ndarray | None":
    """`T_frame_table` [4, 4] of the frame that strokes are told in; None where that is the world with the table at z = 0.

    `robot` gives `T_world_robot` [4, 4], and is asked where that frame is wanted: it raises where it is not known.
    """
    import numpy as np

    from piegraph_cli.recording.ground import level

    T = np.linalg.inv(level(params.table or (0, 0, 0)))
    if params.frame == "robot":
        return np.linalg.inv(robot()) @ T
    return T if any(params.table or ()) else None


def cameras_file(run: "Run", params: PlanParams) -> "Path":
    """The cameras.json that says where the robot stands. Raises `UsageError` where there is none, or several disagree."""
    from piegraph_cli.recording.robot_files import read_robot

    files = [params.cameras] if params.cameras else [r / "cameras.json" for r in run.params("ingest").recording]
    if not files:
        message = "where the robot stands is not known: this run has no recording"
        raise UsageError(message, str(run.folder), "give --cameras FILE")
    odd = [file for file in files[1:] if abs(read_robot(file) - read_robot(files[0])).max() > SAME]
    if odd:
        raise UsageError(f"the robot stands elsewhere in {odd[0]}", str(files[0]), "give --cameras FILE")
    return files[0]
