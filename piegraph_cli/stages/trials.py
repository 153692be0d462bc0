"""Stage `trials`: one episode of planning in a simulated environment, and the summary of all of them.

A unit is one trial of the grid environments x models x goals x starts, by name; so a larger grid keeps what is done.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.environments import check_options
from piegraph_cli.environments.params import split_task
from piegraph_cli.errors import DataError, command_line
from piegraph_cli.params import validated
from piegraph_cli.planning.params import PlanParams, TrialParams, TrialsParams
from piegraph_cli.stages import train
from piegraph_cli.stages.evaluate import require_apart
from piegraph_cli.stages.steps import check_environments
from piegraph_cli.text import counted
from piegraph_cli.workspace.call import Call
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    from piegraph_cli.evaluation.trials import Trial
    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.run import Run

_QUESTION = {
    *("env", "state", "goal", "goal_pose", "goal_at", "table", "frame", "cameras"),
    *("model", "strokes", "success", "episodes", "fixed_goals", "seed", "look"),
}
"""Settings of `plan` that the grid gives."""


def _units(run: "Run") -> Sequence[Unit]:
    """`tblock.piegraph.goal00.seed03` and so on, models innermost: what is done first can be compared first."""
    params = run.params(STAGE.name)
    return [
        f"{env}.{model}.goal{goal:02d}.seed{seed:02d}"
        for env in dict.fromkeys(params.envs)
        for goal in range(params.goals)
        for seed in range(params.seeds)
        for model in dict.fromkeys(params.models)
    ]


def _settings(run: "Run", unit: str) -> TrialParams:
    """The settings of one trial of the grid, whose trained runs lie side by side in one folder.

    Planning settings are those of the trained run's recipe, where it has one; where that trains from several seeds, the
    starts take turns with them. Raises `UsageError` for options that the environment does not have.
    """
    params: TrialsParams = run.params(STAGE.name)
    task, model, goal, seed = split_name(unit)
    env, goals = split_task(task)
    trained = run.beside(params.trained_run(env, run.folder.resolve().parent))
    kept: PlanParams = trained.params("plan")
    settings = kept.model_dump(exclude=_QUESTION) | {k: v for k, v in params.plan.items() if k not in _QUESTION}
    settings |= {"model": "static", "planner": "greedy"} if model == "greedy" else {"model": model}
    settings["options"] = kept.options | _options_of(params, env) | goals
    check_options(env, settings["options"])
    for interpreter in ("daxbench_python", "daxbench_repo"):
        given = getattr(params, interpreter) or settings[interpreter]
        settings[interpreter] = given if env.startswith("daxbench-") else None
    settings |= {"env": env, "strokes": params.strokes, "success": min(params.thresholds)}
    settings |= {"fixed_goals": params.fixed_goals, "look": params.look}
    plan = validated(PlanParams, settings, "plan", "trials.plan", "piegraph plan --help")
    seeds = trained.params("train").seeds_of(model)
    name = train.model_name(model, seeds[seed % len(seeds)])
    own = train.trained_name(name)
    network = trained.path("model", own) if own else None
    metrics = trained.path("metrics", name) if own and (plan.caution or plan.stop) else None
    return TrialParams(goal=goal, seed=seed, network=network, metrics=metrics, plan=plan)


def _check(run: "Run", units: Sequence[Any], processes: int) -> list[str]:
    """Of each task's environment, with the settings of one of its trials."""
    of = {split_name(unit)[0]: unit for unit in units}
    plans = [_settings(run, unit).plan for unit in of.values()]
    return check_environments([(plan.env, plan) for plan in plans], processes)


def split_name(name: str) -> tuple[str, str, int, int]:
    """Task (an environment, or ENVIRONMENT:GOALS), model, number of the goal and of the start of a trial, from its name."""
    env, model, goal, seed = name.split(".")
    return env, model, int(goal.removeprefix("goal")), int(seed.removeprefix("seed"))


def _options_of(params: TrialsParams, env: str) -> dict[str, float | str]:
    """The options `ENV.NAME` for one environment; those without an ENV are for all of them."""
    split = {name: name.rpartition(".") for name in params.options}
    return {option: params.options[name] for name, (of, _, option) in split.items() if of in ("", env)}


STAGE = Stage(
    "trials",
    "plan in a grid of environments, models, goals and seeds",
    (),
    "trials",
    TrialsParams,
    version=5,
    run="piegraph_cli.stages.trials:run",
    unit="trial",
    on_demand=True,
    units=_units,
    settings=_settings,
    check=_check,
    call=Call(
        first=("envs", "models", "goals", "seeds", "fixed_goals", "look", "strokes", "options"),
        describe="piegraph_cli.stages.trials:describe",
    ),
)


def run(inputs: dict[str, Any], params: TrialParams, context: Context) -> Output:
    """Play one trial. Distances along it are kept: `pd` and `cd` [strokes + 1] (m), the first before any stroke."""
    import numpy as np

    from piegraph_cli.evaluation.metrics import CENTIMETRE, chamfer_distance, nearest_distance
    from piegraph_cli.planning.episode import play, tool_of
    from piegraph_cli.planning.model import Model
    from piegraph_cli.planning.planner import tool_warnings
    from piegraph_cli.planning.seeing import play_seen
    from piegraph_cli.planning.told import step_arrays
    from piegraph_cli.process import choose_device, set_up_torch
    from piegraph_cli.stages.learning import calibrated, read_model
    from piegraph_cli.stages.steps import open_environment

    set_up_torch()
    model = _read_model(params)
    trained = None if model is None else calibrated(read_model(model), _read_metrics(params))
    environment = open_environment(params.plan, Model(params.plan.model, trained))
    device = choose_device(context.device)
    through = play_seen if params.plan.look == "cameras" else play
    episode = through(environment, trained, params.plan, start=params.seed, goal=params.goal, device=device)
    copies = episode.goal[None] if episode.copies is None else episode.copies
    states = episode.true or episode.states
    arrays = step_arrays(episode.steps, len(episode.start)) | {
        "goal": episode.goal,
        "start_distance": np.array(episode.start_distance),
        "end_distance": np.array(episode.end_distance),
        "ending": np.array(episode.ending),
        "pd": np.array([nearest_distance(state, copies) for state in states]) / CENTIMETRE,
        "cd": np.array([chamfer_distance(state, copies[0]) for state in states]) / CENTIMETRE,
    }
    quality = _quality(episode.end_distance, len(episode.steps), params.plan, episode.ending)
    return Output(arrays, quality, [*tool_warnings(params.plan, tool_of(environment)), *episode.said])


def _quality(end: float, strokes: int, plan: PlanParams, ending: str) -> str:
    text = f"{end * 100:.1f} cm from the goal after {counted(strokes, 'stroke')}"
    if ending == "reached":
        return text
    why = "" if ending == "strokes spent" else f": {ending}"
    return f"{text}, not below {plan.success * 100:g} cm{why}"


def _read_model(params: TrialParams) -> "Artifact | None":
    from piegraph_cli.workspace.artifact import read_key

    if params.network is None:
        return None
    key = read_key(params.network, "model")
    if key is None and not params.network.exists():
        env, folder = params.plan.env, params.network.parent.parent
        raise DataError(
            f"{params.plan.model} is not trained for {env}",
            str(params.network),
            f"{command_line('run', env, '--run', folder)}, or "
            + command_line("train", "--run", folder, "--model", params.plan.model),
        )
    model = _read_once(params.network, "model", key)
    require_apart(model, str(params.plan.env))
    return model


def _read_metrics(params: TrialParams) -> "Artifact | None":
    from piegraph_cli.workspace.artifact import read_key

    if params.metrics is None:
        return None
    if not params.metrics.exists():
        message = f"{params.plan.model} is not evaluated for {params.plan.env}: caution and stop need its errors"
        hint = command_line("evaluate", "--run", params.metrics.parent.parent, "--models", params.plan.model)
        raise DataError(message, str(params.metrics), hint)
    return _read_once(params.metrics, "metrics", read_key(params.metrics, "metrics"))


@lru_cache(maxsize=16)
def _read_once(path: Path, artifact: str, key: str | None) -> "Artifact":
    """An artifact of a trained run, read once per process as long as its key stays."""
    from piegraph_cli.workspace.artifact import read_artifact

    return read_artifact(path, artifact)


def read_trials(run: "Run") -> list["Trial"]:
    """The trials of a run's grid that are fresh, with their distances; environments and models in the grid's order."""
    from piegraph_cli.evaluation.trials import Trial
    from piegraph_cli.workspace.artifact import read_artifact

    params, trials = run.params(STAGE.name), []
    for name in run.units(STAGE):
        if not run.fresh(STAGE, name):
            continue
        artifact = read_artifact(run.path(STAGE.writes, name), STAGE.writes, ("pd", "cd", "seconds"))
        trials.append(Trial(*split_name(str(name)), artifact["pd"], artifact["cd"], artifact["seconds"]))
    return sorted(trials, key=lambda t: (params.envs.index(t.environment), params.models.index(t.model)))


def describe(run: "Run") -> tuple[dict[str, Any], list[str]]:
    """A run's trials as one object and as lines for people."""
    from piegraph_cli.evaluation.trials import compare_trials, summarise_trials, trial_lines

    params = run.params(STAGE.name)
    trials = read_trials(run)
    results, comparisons = summarise_trials(trials, params.thresholds), compare_trials(trials, params.thresholds)
    value = {"trials": str(run.folder / "trials"), "units": "m", "results": results, "cliffs_delta": comparisons}
    return value, trial_lines(results, comparisons, params.strokes)
