"""Experiments by name: their settings, and the recipes of the runs that they need."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from piegraph_cli.dynamics.params import BUILT_IN, BY_GRADIENT, LEARNED, TrainParams, split_label, trained_label
from piegraph_cli.errors import UsageError
from piegraph_cli.experiments.params import MEASURED, ExperimentParams
from piegraph_cli.params import Params, validated
from piegraph_cli.planning.params import ENVIRONMENT, PlanParams
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.recipe import SHIPPED, Recipe, load_recipe

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

FOLDER = SHIPPED / "experiments"


def names() -> list[str]:
    """The experiments, in the order in which `all` runs them."""
    return sorted(p.stem for p in FOLDER.glob("[!.]*.toml"))


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
    values = with_changes(values | smaller if quick else values, changes)
    has = values["interactions"]
    if environments and isinstance(has, dict):
        values["interactions"] = {env: counts for env, counts in has.items() if env in environments}
        if not values["interactions"]:
            raise UsageError(f"{name} is not done for {', '.join(environments)}", hint=f"of {', '.join(has)}")
    params = validated(ExperimentParams, values, name, str(path), HINT)
    check_names(params, str(path))
    return params


HINT = "correct the experiment"


def check_names(params: ExperimentParams, where: str) -> None:
    """Raises `UsageError` for a model, a variant or a setting that nothing knows: before an hour is spent."""
    for key, settings in params.variants.items():
        name, _, variant = key.partition(":")
        if name not in LEARNED or not variant:
            known = f"MODEL:VARIANT, with one of {', '.join(LEARNED)}"
            raise UsageError(f'variants."{key}" is no variant of a model that learns', where, known)
        validated(LEARNED[name], LEARNED[name]().model_dump() | settings, f'variants."{key}"', where, HINT)
    for environment in params.interactions:
        labels = params.labels(environment)
        for label in [*labels, *(params.trial_labels(environment) if params.trials else ())]:
            name, variant, _ = split_label(trained_label(label) or label)
            if variant and f"{name}:{variant}" not in BUILT_IN | params.variants:
                raise UsageError(f'no variants."{name}:{variant}", which {label} is', where, HINT)
        trained = {trained_label(label) for label in labels}
        for label in params.trial_labels(environment) if params.trials else ():
            own = trained_label(label)
            if own and own not in trained:
                raise UsageError(
                    f"trials.models: {label} plans with {own}, which is not trained", where, "add it to models"
                )
    if params.trials:
        validated(PlanParams, params.trials.plan, "trials.plan", where, HINT)


def with_changes(values: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """Values with those of SETTING=VALUE texts in their place."""
    for text in changes:
        try:
            values = _merge(values, tomllib.loads(text))
        except (ValueError, RecursionError):  # no TOML, a number of thousands of digits, a depth
            raise UsageError(
                f"cannot read --set {text:.80}", hint="SETTING=VALUE, as in --set trials.seeds=3"
            ) from None
    return values


def _merge(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Values with those of `changes` in their place, table by table."""
    merged = dict(values)
    for name, value in changes.items():
        table = isinstance(value, dict) and isinstance(merged.get(name), dict)
        merged[name] = _merge(merged[name], value) if table else value
    return merged


def recipe_of(params: ExperimentParams, environment: str, recording: Path | None) -> Recipe:
    """The shipped recipe of an environment with the experiment's models, seeds and sizes.

    What others measured is a `recording` for `import`, and models have their settings of the T-block.
    """
    measured = environment == MEASURED
    recipe = load_recipe(SHIPPED / f"{'tblock' if measured else environment}.toml", STAGES)

    def put(stage: str, **values: Any) -> None:
        nonlocal recipe
        recipe = recipe.with_values(STAGES[stage], values, "experiment", Path.cwd())

    if recording is None and not measured:
        count = params.training + params.validation + params.test
        put("simulate", sequences=count, strokes=params.strokes, seed=params.simulation)
    else:
        recipe = replace(recipe, sections={k: v for k, v in recipe.sections.items() if k != "simulate"})
        if recording is None or measured:
            put("import", sources=[str(recording.resolve())] if recording else [])
        else:
            put("ingest", recording=str(recording.resolve()))
    put("dataset", train=params.training, validation=params.validation)
    put("train", seeds=list(params.seeds), variants=params.variants)
    train = recipe.params(STAGES["train"])
    assert isinstance(train, TrainParams)
    labels = [label for label in params.labels(environment) if not _repeats(label, params.labels(environment), train)]
    trained = list(dict.fromkeys(own for label in labels if (own := trained_label(label))))
    put("train", models=trained or ["piegraph"])
    if params.steps != 1:
        steps = {name: train.of(name).model_dump()["steps"] for name in BY_GRADIENT}
        put("train", **{f"{name}.steps": max(10, round(count * params.steps)) for name, count in steps.items()})
    put("evaluate", models=labels, horizons=list(params.horizons))
    return recipe


UNTOLD = {"sources", "recording"}
"""Settings that name files."""


def _told(params: Params) -> dict[str, Any]:
    """What results depend on of settings, but for files."""
    files = UNTOLD | params.files().keys()
    return {name: value for name, value in params.content().items() if name not in files}


def in_force(recipe: Recipe, label: str) -> dict[str, dict[str, Any]]:
    """The settings, by stage, that a model's predictions depend on."""
    found = {stage.name: _told(recipe.params(stage)) for stage in recipe.chain() if stage.name != "plan"}
    train, own = recipe.params(STAGES["train"]), trained_label(label)
    assert isinstance(train, TrainParams)
    del found["train"], found["evaluate"]["models"]
    return found | ({"train": train.of(own).content()} if own else {})


def trials_in_force(params: ExperimentParams, environment: str) -> dict[str, dict[str, Any]]:
    """The settings that the trials of all models of an environment share."""
    assert params.trials is not None
    usual = {"look"} if params.trials.look == "particles" else set()
    trials = params.trials.model_dump(mode="json", exclude={"models", "tasks", *usual})
    plan = _told(recipe_of(params, environment, None).params(STAGES["plan"])) | trials.pop("plan")
    return {"trials": trials, "plan": {name: value for name, value in plan.items() if name not in OF_GRID}}


OF_GRID = {"env", "model", "planner", "strokes", "success", "episodes", "fixed_goals", "seed", "look"}
"""Settings of `plan` that the grid of trials gives."""


def recording_of(params: ExperimentParams, environment: str, folder: Path) -> Path | None:
    """Where what an environment's run reads lies under the experiment's folder; None where it simulates itself."""
    return folder / "recordings" / environment if params.recordings or environment == MEASURED else None


def _repeats(label: str, labels: Sequence[str], train: TrainParams) -> bool:
    """Whether a variant has the very settings of its model, which is among the labels too."""
    own, colon_variant = trained_label(label), f":{split_label(label)[1]}"
    if own is None or label.replace(colon_variant, "") not in labels:
        return False
    return colon_variant in own and train.of(own) == train.of(own.replace(colon_variant, ""))


def trial_recipe(params: ExperimentParams, environment: str, folder: Path) -> Recipe:
    """The grid of trials of an experiment in one environment."""
    assert params.trials is not None
    values = params.trials.model_dump(mode="json", exclude={"tasks"}) | {
        "envs": params.tasks(environment),
        "models": params.trial_labels(environment),
        "trained": str(folder.resolve() / (params.run_name(ENVIRONMENT) if params.recordings else "")),
    }
    return Recipe(STAGES).with_values(STAGES["trials"], values, "experiment", Path.cwd())
