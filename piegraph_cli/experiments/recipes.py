"""Experiments by name: their settings, and the recipes of the runs that they need."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from piegraph_cli.dynamics.params import BY_GRADIENT, TrainParams, split_label, trained_label
from piegraph_cli.errors import UsageError
from piegraph_cli.experiments.params import MEASURED, ExperimentParams
from piegraph_cli.params import validated
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
    return validated(ExperimentParams, values, name, str(path), "correct the experiment")


def with_changes(values: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """Values with those of SETTING=VALUE texts in their place."""
    for text in changes:
        try:
            values = _merge(values, tomllib.loads(text))
        except tomllib.TOMLDecodeError:
            raise UsageError(f"cannot read --set {text}", hint="SETTING=VALUE, as in --set trials.seeds=3") from None
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
        simulate = recipe.sections["simulate"]
        recipe = replace(recipe, sections={k: v for k, v in recipe.sections.items() if k != "simulate"})
        if recording is None or measured:
            put("import", sources=[str(recording.resolve())] if recording else [])
        else:
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
        steps = {name: train.of(name).model_dump()["steps"] for name in BY_GRADIENT}
        put("train", **{f"{name}.steps": max(10, round(count * params.steps)) for name, count in steps.items()})
    put("evaluate", models=labels, horizons=list(params.horizons))
    return recipe


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
        "envs": params.trials.tasks.get(environment, (environment,)),  # type: ignore[call-overload]
        "models": params.trial_labels(environment),
        "trained": str(folder.resolve()),
    }
    return Recipe(STAGES).with_values(STAGES["trials"], values, "experiment", Path.cwd())
