"""What the runs of an experiment have, read together."""

from dataclasses import dataclass
from pathlib import Path

from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.recipes import recipe_of, recording_of, trial_recipe
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.evaluate import read_metrics
from piegraph_cli.stages.train import split_model
from piegraph_cli.stages.trials import read_trials
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.run import Run


@dataclass(frozen=True)
class Results:
    """What the runs of an experiment have, by environment."""

    metrics: dict[str, dict[str, list[Artifact]]]
    """By environment and model, the metrics of each seed."""
    models: dict[str, dict[str, list[Artifact]]]
    """By environment and trained model, what each seed learned."""
    trials: list[Trial]
    shown: dict[str, dict[str, Artifact]]
    """By task and model, one trial to look at."""


def read_results(name: str, params: ExperimentParams, folder: Path) -> Results:
    """What the experiment's runs have that is fresh."""
    metrics: dict[str, dict[str, list[Artifact]]] = {}
    models: dict[str, dict[str, list[Artifact]]] = {}
    trials: list[Trial] = []
    shown: dict[str, dict[str, Artifact]] = {}
    for environment in params.interactions:
        recording = recording_of(params, environment, folder)
        run = open_run(folder / params.run_name(environment), recipe_of(params, environment, recording))
        metrics[environment] = read_metrics(run)[0]
        models[environment] = _read_models(run)
        if params.trials:
            grid = open_run(folder / name / environment, trial_recipe(params, environment, folder))
            found = read_trials(grid)
            trials += found
            for task in dict.fromkeys(trial.environment for trial in found):
                shown[task] = _one_of_each([trial for trial in found if trial.environment == task], grid)
    return Results(metrics, models, trials, shown)


def _read_models(run: Run) -> dict[str, list[Artifact]]:
    stage, found = STAGES["train"], {}  # type: ignore[var-annotated]
    for unit in run.units(stage):
        if run.fresh(stage, unit):
            model = read_artifact(run.path("model", unit), "model", ("validation_loss", "step"))
            found.setdefault(split_model(str(unit))[0], []).append(model)
    return found


def _one_of_each(trials: list[Trial], run: Run) -> dict[str, Artifact]:
    """For every model its trial from that start to that goal where the first model's final distance is the median one."""
    first = sorted((t for t in trials if t.model == trials[0].model), key=lambda t: t.pd[-1])
    task = first[len(first) // 2]
    same = [t for t in trials if (t.goal, t.seed) == (task.goal, task.seed)]
    paths = {t.model: f"{t.environment}.{t.model}.goal{t.goal:02d}.seed{t.seed:02d}" for t in same}
    return {model: read_artifact(run.path("trials", unit), "trials") for model, unit in paths.items()}
