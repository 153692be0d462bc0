"""Experiments by name: their recipes, the runs they need, and what is read from these."""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from piegraph_cli.dynamics.params import LEARNED, TrainParams, split_label, trained_label
from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.errors import DataError, PiegraphError, UsageError
from piegraph_cli.evaluation.tables import as_json
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.files import atomic_file
from piegraph_cli.params import validated
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.recipe import SHIPPED, Recipe, load_recipe
from piegraph_cli.workspace.run import Run

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

log = logging.getLogger("piegraph")

FOLDER = SHIPPED / "experiments"


@dataclass(frozen=True)
class Results:
    """What the runs of an experiment have, by environment."""

    metrics: dict[str, dict[str, list[Artifact]]]
    """By environment and model, the metrics of each seed."""
    models: dict[str, dict[str, list[Artifact]]]
    """By environment and trained model, what each seed learned."""
    trials: list[Trial]
    shown: dict[str, dict[str, Artifact]]
    """By environment and model, one trial to look at."""


def names() -> list[str]:
    """The experiments, in the order in which `all` runs them."""
    return sorted(p.stem for p in FOLDER.glob("*.toml"))


def load_experiment(
    name: str, quick: bool, changes: Sequence[str] = (), environments: Sequence[str] = ()
) -> ExperimentParams:
    """The settings of an experiment, those of its [quick] section in place of others where it shall be quick.

    `changes` are SETTING=VALUE with a TOML value, as in `trials.seeds=3`. Of its environments those in `environments` are
    kept, by default all. Raises `UsageError` for a name or a setting that is not there, and where no environment is left.
    """
    path = FOLDER / f"{name}.toml"
    if name not in names():
        raise UsageError(f"no experiment {name}", hint=f"one of {', '.join(names())}, all")
    values = tomllib.loads(path.read_text())
    smaller = values.pop("quick", {})
    values = values | smaller if quick else values
    for text in changes:
        try:
            values = _merge(values, tomllib.loads(text))
        except tomllib.TOMLDecodeError:
            raise UsageError(f"cannot read --set {text}", hint="SETTING=VALUE, as in --set trials.seeds=3") from None
    has = values["interactions"]
    if environments and isinstance(has, dict):
        values["interactions"] = {env: counts for env, counts in has.items() if env in environments}
        if not values["interactions"]:
            raise UsageError(f"{name} is not done for {', '.join(environments)}", hint=f"of {', '.join(has)}")
    return validated(ExperimentParams, values, name, str(path), "correct the experiment")


def _merge(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Values with those of `changes` in their place, table by table."""
    merged = dict(values)
    for name, value in changes.items():
        table = isinstance(value, dict) and isinstance(merged.get(name), dict)
        merged[name] = _merge(merged[name], value) if table else value
    return merged


def recipe_of(params: ExperimentParams, environment: str, recording: Path | None) -> Recipe:
    """The shipped recipe of an environment with the experiment's models, seeds and sizes."""
    recipe = load_recipe(SHIPPED / f"{environment}.toml", STAGES)

    def put(stage: str, **values: Any) -> None:
        nonlocal recipe
        recipe = recipe.with_values(STAGES[stage], values, "experiment", Path.cwd())

    if recording is None:
        put("simulate", sequences=params.training + params.validation + params.test, strokes=params.strokes)
    else:
        simulate = recipe.sections["simulate"]
        recipe = replace(recipe, sections={k: v for k, v in recipe.sections.items() if k != "simulate"})
        put("ingest", recording=str(recording.resolve()))
        if simulate.get("modes") or environment in ("tshirt", "cloth"):
            put("track", mode="pick")
    put("dataset", train=params.training, validation=params.validation)
    put("train", seeds=list(params.seeds), variants=params.variants)
    train = recipe.params(STAGES["train"])
    assert isinstance(train, TrainParams)
    labels = [label for label in params.labels(environment) if not _repeats(label, params.labels(environment), train)]
    trained = list(dict.fromkeys(own for label in labels if (own := trained_label(label))))
    put("train", models=trained or ["piegraph"])
    if params.steps != 1:
        put("train", **{f"{name}.steps": max(10, round(train.of(name).steps * params.steps)) for name in LEARNED})
    put("evaluate", models=labels, horizons=list(params.horizons))
    return recipe


def _repeats(label: str, labels: Sequence[str], train: TrainParams) -> bool:
    """Whether a variant has the very settings of its model, which is among the labels too."""
    own, colon_variant = trained_label(label), f":{split_label(label)[1]}"
    if own is None or label.replace(colon_variant, "") not in labels:
        return False
    return colon_variant in own and train.of(own) == train.of(own.replace(colon_variant, ""))


def run_experiment(name: str, params: ExperimentParams, folder: Path, options: Options) -> list[PiegraphError]:
    """Do what the experiment's runs under `folder` lack; returns what failed."""
    failed: list[PiegraphError] = []
    last = "train" if params.table == "search" else "evaluate"
    for environment in params.interactions:
        own, recording = folder / environment, None
        if params.recordings:
            own, recording = folder / f"{environment}-recorded", folder / "recordings" / environment
            _render(recording, params, environment, options.jobs)
        recipe = recipe_of(params, environment, recording)
        log.info("%s: %s", name, own)
        run = open_run(own, recipe)
        outcomes = run_chain(run, last, options)
        failed += [o.error for o in outcomes if o.error]
        run.save_recipe()
    for environment in params.interactions if params.trials else ():
        log.info("%s: %s", name, folder / name / environment)
        grid = open_run(folder / name / environment, trial_recipe(params, environment, folder))
        outcomes = run_stage(grid, STAGES["trials"], options)
        failed += [o.error for o in outcomes if o.error]
        grid.save_recipe()
    return failed


def _render(recording: Path, params: ExperimentParams, environment: str, jobs: int) -> None:
    from piegraph_cli.stages.simulate import record_sequences

    shipped = load_recipe(SHIPPED / f"{environment}.toml", STAGES).params(STAGES["simulate"])
    assert isinstance(shipped, SimulateParams)
    count = params.training + params.validation + params.test
    settings = shipped.model_copy(update={"sequences": count, "strokes": params.strokes})
    record_sequences(recording, settings, jobs=jobs, force=False)


def trial_recipe(params: ExperimentParams, environment: str, folder: Path) -> Recipe:
    """The grid of trials of an experiment in one environment."""
    assert params.trials is not None
    values = params.trials.model_dump(mode="json") | {
        "envs": [environment],
        "models": params.trial_labels(environment),
        "trained": str(folder.resolve()),
    }
    return Recipe(STAGES).with_values(STAGES["trials"], values, "experiment", Path.cwd())


def read_results(name: str, params: ExperimentParams, folder: Path) -> Results:
    """What the experiment's runs have that is fresh."""
    from piegraph_cli.stages.evaluate import read_metrics
    from piegraph_cli.stages.trials import read_trials

    metrics: dict[str, dict[str, list[Artifact]]] = {}
    models: dict[str, dict[str, list[Artifact]]] = {}
    trials: list[Trial] = []
    shown: dict[str, dict[str, Artifact]] = {}
    for environment in params.interactions:
        recording = folder / "recordings" / environment if params.recordings else None
        own = folder / (f"{environment}-recorded" if params.recordings else environment)
        run = open_run(own, recipe_of(params, environment, recording))
        metrics[environment] = read_metrics(run)[0]
        models[environment] = _read_models(run)
        if params.trials:
            grid = open_run(folder / name / environment, trial_recipe(params, environment, folder))
            found = read_trials(grid)
            trials += found
            shown[environment] = _one_of_each(found, grid)
    return Results(metrics, models, trials, shown)


def _read_models(run: Run) -> dict[str, list[Artifact]]:
    from piegraph_cli.stages.train import split_model

    stage, found = STAGES["train"], {}  # type: ignore[var-annotated]
    for unit in run.units(stage):
        if run.state(stage, unit) == "fresh":
            model = read_artifact(run.path("model", unit), "model", ("validation_loss", "step"))
            found.setdefault(split_model(str(unit))[0], []).append(model)
    return found


def _one_of_each(trials: list[Trial], run: Run) -> dict[str, Artifact]:
    """For every model its trial at the task in which the first model's final distance is the median one."""
    if not trials:
        return {}
    first = sorted((t for t in trials if t.model == trials[0].model), key=lambda t: t.pd[-1])
    task = first[len(first) // 2]
    same = [t for t in trials if (t.goal, t.seed) == (task.goal, task.seed)]
    paths = {t.model: f"{t.environment}.{t.model}.goal{t.goal:02d}.seed{t.seed:02d}" for t in same}
    return {model: read_artifact(run.path("trials", unit), "trials") for model, unit in paths.items()}


def write_report(name: str, params: ExperimentParams, folder: Path) -> tuple[dict[str, Any], list[str], list[Path]]:
    """The experiment's tables as an object and as lines, and its pictures; all are kept in `folder`/report.

    Raises `DataError` when nothing has been done yet.
    """
    from piegraph_cli.experiments.figures import draw
    from piegraph_cli.experiments.tables import describe

    results = read_results(name, params, folder)
    if not any(results.metrics.values()) and not any(results.models.values()):
        raise DataError("no run of this experiment has results yet", str(folder), f"piegraph reproduce {name}")
    value, lines = describe(params, results)
    out = folder / "report"
    for suffix, text in (("txt", "\n".join(lines)), ("json", as_json(value))):
        with atomic_file(out / f"{name}.{suffix}") as temporary:
            temporary.write_text(text + "\n")
    pictures = []
    for kind, figure in draw(params, results):
        path = out / f"{name}_{kind}.png"
        with atomic_file(path) as temporary:
            figure.savefig(temporary, dpi=110, format="png")
        pictures.append(path)
    return value, lines, pictures
