"""Models of runs, and models as files of their own."""

import math
from dataclasses import asdict, fields, replace
from pathlib import Path

from piegraph_cli.dynamics.params import trained_label
from piegraph_cli.dynamics.reliability import Calibration
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.evaluation.reliability import calibration_of
from piegraph_cli.params import validated
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages import evaluate, open_run, train
from piegraph_cli.stages.learning import calibrated, read_model
from piegraph_cli.workspace.artifact import Artifact, read_artifact, write_artifact


def load_model(source: Path | str, label: str | None = None, *, seed: int | None = None) -> Model:
    """A model of a run folder, by label (`piegraph`) and seed (the first trained), or of one file.

    A file may come from another computer: it is one of RUN/model, or of `save_model`, which keeps the settings to plan with
    too. In a run these are its recipe's. Raises `DataError` where there is no such model.
    """
    return find_model(source, label, seed=seed)[0]


def find_model(
    source: Path | str, label: str | None = None, *, seed: int | None = None
) -> tuple[Model, Artifact | None]:
    """As `load_model`, with the artifact that holds what was learned; None where nothing is."""
    set_up_torch()
    path = Path(source)
    if path.is_dir():
        label = label or "piegraph"
        artifact, metrics, plan = _model_of_run(path, label, seed)
        return Model(label, calibrated(read_model(artifact), metrics) if artifact else None, plan), artifact
    artifact = read_artifact(path, "model", foreign=True)
    own = str(artifact.params.get("label"))
    if label is not None and trained_label(label) != own:
        raise DataError(f"holds {own}, not {label}", str(path), "another file, or no label")
    if seed is not None and seed != artifact.params.get("seed"):
        raise DataError(f"holds seed {artifact.params.get('seed')}, not {seed}", str(path), "another file, or no seed")
    trained = replace(read_model(artifact), calibration=_calibration(artifact))
    try:
        plan = validated(PlanParams, artifact.params.get("plan", {}), "plan", str(path), "another model file")
    except UsageError as error:
        raise DataError(error.message, error.where, error.hint) from None
    return Model(label or own, trained, plan), artifact


def save_model(run: Path | str, path: Path | str, label: str = "piegraph", *, seed: int | None = None) -> None:
    """Write a trained model of a run folder, with the run's settings to plan with, as one file for `load_model`.

    Raises `DataError` where it is not trained, or the disk is full.
    """
    artifact, metrics, plan = _model_of_run(Path(run), label, seed)
    if artifact is not None and trained_label(label) != label:
        raise DataError(f"{label} is what {trained_label(label)} has learned", str(run), f"save {trained_label(label)}")
    if artifact is None:
        raise DataError(f"{label} is not trained: there is nothing to save", str(run), "another label")
    known = calibration_of(metrics.arrays) if metrics else None
    here = {"model", "daxbench_python", "daxbench_repo", "table", "frame", "cameras"}
    settings = plan.model_dump(mode="json", exclude={*PlanParams.query, *here})
    write_artifact(
        Path(path),
        "model",
        artifact.arrays,
        stage=train.STAGE.name,
        stage_version=train.STAGE.version,
        key=artifact.key,
        params=artifact.params | {"plan": settings} | ({"calibration": asdict(known)} if known else {}),
        inputs=artifact.inputs,
        quality=artifact.quality,
    )


def _calibration(artifact: Artifact) -> Calibration | None:
    """What a model file says of the errors to expect. Raises `DataError` where these are no numbers."""
    values = artifact.params.get("calibration")
    if values is None:
        return None
    names = [of.name for of in fields(Calibration)]
    numbers = [x for name in names if isinstance(values, dict) and isinstance(x := values.get(name), float)]
    if len(numbers) < len(names) or not all(0 <= x < math.inf for x in numbers):
        raise DataError("says no numbers of the errors to expect", str(artifact.path), "another model file")
    return Calibration(*numbers)


def _model_of_run(folder: Path, label: str, seed: int | None) -> tuple[Artifact | None, Artifact | None, PlanParams]:
    """What a model of a run has learned, if anything, its metrics where it was evaluated, and the settings to plan with."""
    run = open_run(folder)
    seeds = run.params("train").seeds_of(label)
    name = train.model_name(label, seeds[0] if seed is None else seed)
    own = train.trained_name(name)
    given: PlanParams = run.params("plan")
    table = given.table if given.table is not None else run.params("ingest").table
    plan = given.model_copy(update=dict.fromkeys(PlanParams.query) | {"table": table if any(table) else None})
    metrics = run.read("metrics", name) if own and evaluate.measured(run, name) else None
    return run.read("model", own) if own else None, metrics, plan
