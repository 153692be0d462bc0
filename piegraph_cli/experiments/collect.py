"""Pieces of the runs of an experiment: what is fresh there, read as it is kept."""

import hashlib
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.dynamics.params import LEARNED, split_label, trained_label
from piegraph_cli.evaluation.tables import sequence_means
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import METRICS, Made, Piece, Training, rounded
from piegraph_cli.experiments.recipes import in_force, recipe_of, recording_of, trial_recipe, trials_in_force
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.train import split_model, trained_name
from piegraph_cli.stages.trials import split_name
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.run import Run

NO_WEIGHTS = ("weights/edges", "weights/shape", "weights/others", "weights/other_edges")
"""Of a rigid body: its outline, which is measured and not fitted, and the numbers that it might have as well."""


def collect(name: str, params: ExperimentParams, folder: Path, command: str) -> list[Piece]:
    """Every piece of an experiment whose artifacts are fresh, or that failed; of trials those whose grid is whole."""
    pieces: list[Piece] = []
    for environment in params.interactions:
        pieces += model_pieces(params, environment, folder, command)
        if params.trials:
            pieces += trial_pieces(name, params, environment, folder, command)
    return pieces


def model_pieces(
    params: ExperimentParams, environment: str, folder: Path, command: str, only: Sequence[str] = ()
) -> Iterator[Piece]:
    """The pieces of one environment's models, or `only` some: their predictions, or in a search their trainings."""
    place = params.run_name(environment)
    run = open_run(folder / place, recipe_of(params, environment, recording_of(params, environment, folder)))
    last = STAGES["train" if params.table == "search" else "evaluate"]
    for unit in only or run.units(last):
        failed = run.failure(last, unit) or _failed_training(run, str(unit))
        if run.fresh(last, unit) or failed:
            yield _model_piece(run, environment, place, str(unit), last.name == "evaluate", failed, command)


def _failed_training(run: Run, unit: str) -> str | None:
    own = trained_name(unit)
    return run.failure(STAGES["train"], own) if own else None


def _model_piece(
    run: Run, environment: str, place: str, unit: str, evaluated: bool, failed: str | None, command: str
) -> Piece:
    (label, seed), own = split_model(unit), trained_name(unit)
    stages = [s for s in run.chain if s.name not in ("plan", *(() if evaluated else ("evaluate",)))]
    keys = {"dataset": run.key(STAGES["dataset"], None)} | ({"model": run.key(STAGES["train"], own)} if own else {})
    artifact = training = None
    if own and run.fresh(STAGES["train"], own):
        artifact = read_artifact(run.path("model", own), "model")
        training = _training(artifact)
    more: dict[str, Any] = {}
    if evaluated:
        keys["metrics"] = run.key(STAGES["evaluate"], unit)
        if not failed:
            artifact = read_artifact(run.path("metrics", unit), "metrics")
            more = _rows(artifact)
    return Piece(
        kind="model",
        place=place,
        environment=environment,
        model=label,
        seed=seed if own else None,
        command=command,
        made=_made([artifact] if artifact else []),
        versions={s.name: s.version for s in stages if own or s.name != "train"} | _revision(label),
        keys=keys,
        settings=in_force(run.recipe, label),
        training=training,
        failed=failed,
        **more,
    )


def _training(model: Artifact) -> Training:
    losses = model["validation_loss"]
    checked = losses[np.isfinite(losses)]
    weights = [
        value.size for name, value in model.arrays.items() if name.startswith("weights/") and name not in NO_WEIGHTS
    ]
    return Training(
        steps=int(model["step"][-1]),
        parameters=sum(weights),
        loss=rounded(checked.min() if len(checked) else model["train_loss"][-1]),
        static_loss=rounded(model["static_loss"]) if "static_loss" in model else None,
        made=_made([model]),
    )


def _rows(metrics: Artifact) -> dict[str, Any]:
    """Windows, columns and rows of a piece."""
    horizons = sorted({int(h) for h in metrics["horizon"]})
    names = sorted({name.decode() for name in metrics["sequence"]})
    columns, values = ["sequence"], [names]
    for horizon in horizons:
        for metric in METRICS:
            found = _means(metrics.arrays, metric, horizon, names)
            if any(value is not None for value in found):
                columns.append(f"{metric} {horizon}")
                values.append(found)
    windows = {horizon: int((metrics["horizon"] == horizon).sum()) for horizon in horizons}
    return {"windows": windows, "columns": columns, "rows": [list(row) for row in zip(*values, strict=True)]}


def _means(arrays: dict[str, np.ndarray], metric: str, horizon: int, names: list[str]) -> list[float | None]:
    """Mean of a metric over the windows of each sequence by name; None where it has none."""
    there = (arrays["horizon"] == horizon) & np.isfinite(arrays[metric])
    of = sorted({name.decode() for name in arrays["sequence"][there]})
    means = dict(zip(of, sequence_means([arrays], metric, horizon)[0], strict=True))
    return [rounded(means[name]) if name in means else None for name in names]


def trial_pieces(name: str, params: ExperimentParams, environment: str, folder: Path, command: str) -> Iterator[Piece]:
    """The pieces of one environment's trials, one for each of its tasks and each model, where all of them were tried."""
    grid = open_run(folder / name / environment, trial_recipe(params, environment, folder))
    recipe = recipe_of(params, environment, recording_of(params, environment, folder))
    trained = open_run(folder / params.run_name(environment), recipe)
    stage = STAGES["trials"]
    for task, label in product(params.tasks(environment), dict.fromkeys(params.trial_labels(environment))):
        units = [str(unit) for unit in grid.units(stage) if split_name(str(unit))[:2] == (task, label)]
        failures = {unit: why for unit in units if (why := grid.failure(stage, unit))}
        if not all(unit in failures or grid.fresh(stage, unit) for unit in units):
            continue
        artifacts = [
            read_artifact(grid.path("trials", u), "trials", ("pd", "cd", "seconds")) for u in units if u not in failures
        ]
        of_network = trained_name(f"{label}.seed0") is not None
        together = hashlib.sha256(" ".join(grid.key(stage, unit) for unit in units).encode()).hexdigest()
        failed = "; ".join(f"{unit}: {why.splitlines()[0]}" for unit, why in failures.items())
        yield Piece(
            kind="trials",
            place=f"{name}/{task}",
            environment=task,
            model=label,
            seed=None,
            command=command,
            made=_made(artifacts),
            versions={stage.name: stage.version} | (_versions(trained, label) if of_network else {}),
            keys=({"dataset": trained.key(STAGES["dataset"], None)} if of_network else {}) | {"trials": together},
            settings=trials_in_force(params, environment),
            failed=failed or None,
            columns=["goal", "seed", "pd", "cd", "seconds"],
            rows=[_trial_row(u, a) for u, a in zip([u for u in units if u not in failures], artifacts, strict=True)],
        )


def _versions(run: Run, label: str) -> dict[str, int]:
    """Of the stages that a run's networks are from, and of the model itself."""
    of_stages = {stage.name: stage.version for stage in run.chain if stage.name not in ("evaluate", "plan")}
    return of_stages | _revision(label)


def _revision(label: str) -> dict[str, int]:
    """What a model has learned by, from its second revision on: `{"sms-o": 2}`."""
    name = split_label(trained_label(label) or "")[0]
    revision = LEARNED[name].revision if name else 1
    return {name: revision} if revision > 1 else {}


def _trial_row(unit: str, trial: Artifact) -> list[Any]:
    _, _, goal, seed = split_name(unit)
    return [goal, seed, rounded(trial["pd"]), rounded(trial["cd"]), rounded(trial["seconds"], 3)]


def _made(artifacts: list[Artifact]) -> Made:
    """When and where artifacts were made, the last date and every machine, and what all of them took together."""
    told = [one.made for one in artifacts]

    def together(name: str) -> float | None:
        times = [made[name] for made in told if name in made]
        return sum(times) / 1000 if times and len(times) == len(told) else None

    def every(name: str) -> str:
        return "; ".join(sorted({made[name] for made in told if name in made}))

    date = max((made.get("created", "")[:10] for made in told), default="")
    return Made(
        date=date,
        software=every("software"),
        machine=every("machine"),
        wall_s=together("wall_ms"),
        cpu_s=together("cpu_ms"),
    )


def shown_trials(name: str, params: ExperimentParams, folder: Path) -> dict[str, dict[str, Artifact]]:
    """By task and model one trial to look at: from that start to that goal where the first model's end is the median one."""
    shown: dict[str, dict[str, Artifact]] = {}
    for environment in params.interactions if params.trials else ():
        grid = open_run(folder / name / environment, trial_recipe(params, environment, folder))
        trials = [t for p in trial_pieces(name, params, environment, folder, "") for t in p.trials]
        for task in dict.fromkeys(trial.environment for trial in trials):
            shown[task] = _one_of_each([trial for trial in trials if trial.environment == task], grid)
    return shown


def _one_of_each(trials: list[Trial], run: Run) -> dict[str, Artifact]:
    """For every model its trial from that start to that goal where the first model's final distance is the median one."""
    first = sorted((t for t in trials if t.model == trials[0].model), key=lambda t: t.pd[-1])
    task = first[len(first) // 2]
    same = [t for t in trials if (t.goal, t.seed) == (task.goal, task.seed)]
    paths = {t.model: f"{t.environment}.{t.model}.goal{t.goal:02d}.seed{t.seed:02d}" for t in same}
    return {model: read_artifact(run.path("trials", unit), "trials") for model, unit in paths.items()}
