"""Stage `trials`: one episode of planning in a simulated environment, and the summary of all of them."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.metrics import CENTIMETRE, chamfer_distance, particle_distance
from piegraph_cli.evaluation.trials import Trial, compare_trials, summarise_trials, trial_lines
from piegraph_cli.planning.params import PlanParams, TrialParams, TrialsParams
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.artifact import Artifact, read_artifact, read_key
from piegraph_cli.workspace.execute import Context, Output
from piegraph_cli.workspace.grid import split_name
from piegraph_cli.workspace.run import Run


def run(inputs: dict[str, Any], params: TrialParams, context: Context) -> Output:
    """Play one trial. Distances along it are kept: `pd` and `cd` [strokes + 1] (m), the first before any stroke."""
    # torch takes seconds to import, which the summary does not need
    from piegraph_cli.planning.episode import play, tool_of
    from piegraph_cli.planning.planner import tool_warnings
    from piegraph_cli.process import set_up_torch
    from piegraph_cli.stages.steps import open_environment, step_arrays
    from piegraph_cli.stages.train import read_model

    set_up_torch()
    model = _read_model(params)
    trained = None if model is None else read_model(model)
    environment = open_environment(params.plan, trained)
    episode = play(environment, trained, params.plan, start=params.seed, goal=params.goal)
    states = episode.states
    arrays = step_arrays(episode.steps, len(episode.start)) | {
        "goal": episode.goal,
        "start_distance": np.array(episode.start_distance),
        "end_distance": np.array(episode.end_distance),
        "pd": np.array([particle_distance(state, episode.goal) for state in states]) / CENTIMETRE,
        "cd": np.array([chamfer_distance(state, episode.goal) for state in states]) / CENTIMETRE,
    }
    quality = _quality(episode.end_distance, len(episode.steps), params.plan)
    return Output(arrays, quality, tool_warnings(params.plan, tool_of(environment)))


def _quality(end: float, strokes: int, plan: PlanParams) -> str:
    if end < plan.success:
        return f"{end * 100:.1f} cm from the goal after {strokes} strokes"
    return f"{end * 100:.1f} cm from the goal after {strokes} strokes, not below {plan.success * 100:g} cm"


def _read_model(params: TrialParams) -> Artifact | None:
    if params.network is None:
        return None
    key = read_key(params.network, "model")
    if key is None and not params.network.exists():
        env, folder = params.plan.env, params.network.parent.parent
        raise DataError(
            f"{params.plan.model} is not trained for {env}",
            str(params.network),
            f"piegraph run {env} --run {folder}, or piegraph train --run {folder} --model {params.plan.model}",
        )
    return _read_once(params.network, key)


@lru_cache(maxsize=8)
def _read_once(path: Path, key: str | None) -> Artifact:
    """The model artifact, read once per process as long as its key stays."""
    return read_artifact(path, "model")


def read_trials(run: Run) -> list[Trial]:
    """The trials of a run's grid that are fresh, with their distances; environments and models in the grid's order."""
    stage, trials = STAGES["trials"], []
    params = run.recipe.params(stage)
    assert isinstance(params, TrialsParams)
    for name in run.units(stage):
        if run.state(stage, name) != "fresh":
            continue
        artifact = read_artifact(run.path(stage.writes, name), stage.writes, ("pd", "cd", "seconds"))
        trials.append(Trial(*split_name(str(name)), artifact["pd"], artifact["cd"], artifact["seconds"]))
    return sorted(trials, key=lambda t: (params.envs.index(t.environment), params.models.index(t.model)))


def describe(folder: Path) -> tuple[dict[str, Any], list[str]]:
    """A run's trials as one object and as lines for people."""
    run = Run.open(folder)
    params = run.recipe.params(STAGES["trials"])
    assert isinstance(params, TrialsParams)
    trials = read_trials(run)
    results, comparisons = summarise_trials(trials, params.thresholds), compare_trials(trials, params.thresholds)
    value = {"trials": str(folder / "trials"), "units": "m", "results": results, "cliffs_delta": comparisons}
    return value, trial_lines(results, comparisons, params.strokes)
