"""Stage `evaluate`: one model's predictions on held-out sequences."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained, make_predict
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.metrics import SHAPE_RADIUS, chamfer_distance, particle_distance, shape_error
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.evaluation.tables import summarise, summarise_scores, table_lines
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.dataset import TEST
from piegraph_cli.stages.train import read_model
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.execute import Context, Output
from piegraph_cli.workspace.grid import split_model
from piegraph_cli.workspace.run import Run

COLUMNS = ("horizon", "sequence", "first_stroke", "cd", "s", "pd", "pd_truth")


def run(inputs: dict[str, Any], params: ModelEvaluateParams, context: Context) -> Output:
    """Measure a model on every window of held-out strokes."""
    set_up_torch()
    data, trained = inputs["dataset"], read_model(inputs["model"]) if "model" in inputs else None
    names = data.texts("sequence_name")
    rows: dict[str, list] = {name: [] for name in COLUMNS}
    for index in context.progress(np.flatnonzero(data["sequence_split"] == TEST), "evaluate"):
        sequence = read_sequence(data, int(index))
        true = inputs["scores"][names[index]]["true_positions"] if "scores" in inputs else None
        true = None if true is None or len(true) == 0 else true
        for horizon, *values in _evaluate_sequence(sequence, true, trained, params):
            for column, value in zip(rows, (horizon, names[index], *values), strict=True):
                rows[column].append(value)
    if not rows["horizon"]:
        raise DataError(
            f"no held-out sequence has {min(params.horizons)} strokes in a row", hint="record longer sequences"
        )
    arrays = {name: np.array(values) for name, values in rows.items()}
    return Output(arrays, _quality(arrays, params), _warnings(arrays, params))


def read_metrics(run: Run) -> tuple[dict[str, list[Artifact]], list[Artifact]]:
    """The fresh metrics of a run, by model and seed, and the scores of its sequences where it has any."""
    stage, metrics = STAGES["evaluate"], {}  # type: ignore[var-annotated]
    for name in run.units(stage):
        if name is not None and run.state(stage, name) == "fresh":
            metrics.setdefault(split_model(name)[0], []).append(read_artifact(run.path("metrics", name), "metrics"))
    score = STAGES["score"]
    names = run.sequences if score in run.recipe.chain() else []
    paths = [run.path("scores", name) for name in names if run.state(score, name) == "fresh"]
    return metrics, [read_artifact(path, "scores") for path in paths]


def describe(folder: Path) -> tuple[dict[str, Any], list[str]]:
    """A run's metrics and scores as one object and as lines for people."""
    metrics, scores = read_metrics(Run.open(folder))
    rows, values = (
        summarise({m: [a.arrays for a in seeds] for m, seeds in metrics.items()}),
        summarise_scores([a.arrays for a in scores]),
    )
    return {"metrics": str(folder / "metrics"), "rows": rows, "scores": values}, table_lines(rows, values)


def read_sequence(data: Artifact, index: int) -> dict[str, Any]:
    """One sequence: `rest` [N, 3], and per stroke `before`, `after` [S, N, 3], `strokes` [S], `frames` [S, 2]."""
    chosen = data["stroke_sequence"] == index
    first, last = data["strokes"][chosen].T
    hand = data["end_effector"]
    start = int(data["sequence_start"][index])
    return {
        "rest": data["positions"][start],
        "before": data["positions"][first],
        "after": data["positions"][last],
        "strokes": Strokes.of(hand[first], hand[last], data["stroke_mode"][chosen]),
        "frames": np.stack([first, last], 1) - start,
    }


def _evaluate_sequence(
    sequence: dict[str, Any], true: np.ndarray | None, trained: Trained | None, params: ModelEvaluateParams
):
    """Rows (horizon, first stroke, metrics) of all windows of one sequence; all windows advance as one batch."""
    count = len(sequence["strokes"])
    edges = build_springs(sequence["rest"], SHAPE_RADIUS).pairs
    rest = torch.as_tensor(sequence["rest"], dtype=torch.float32)
    strokes = sequence["strokes"].to(torch.float32)
    predict = make_predict(params.label, trained, rest, params)
    positions = torch.as_tensor(sequence["before"])
    for horizon in range(1, min(max(params.horizons), count) + 1):
        windows = count - horizon + 1
        positions = predict(positions[:windows], strokes[horizon - 1 :])
        if horizon not in params.horizons:
            continue
        for window in range(windows):
            last = window + horizon - 1
            found, target = positions[window].numpy(), sequence["after"][last]
            metrics = [
                chamfer_distance(found, target),
                shape_error(found, target, edges),
                particle_distance(found, target),
            ]
            at_end = None if true is None else true[sequence["frames"][last, 1]]
            metrics.append(float("nan") if at_end is None else particle_distance(found, at_end))
            yield horizon, window, *metrics


def _quality(arrays: dict[str, np.ndarray], params: ModelEvaluateParams) -> str:
    means = {h: arrays["pd"][arrays["horizon"] == h].mean() for h in params.horizons if h in arrays["horizon"]}
    parts = [f"H={h} {mean:.2f}" for h, mean in means.items()]
    return f"PD [cm] {', '.join(parts)} on {len(np.unique(arrays['sequence']))} held-out sequences"


def _warnings(arrays: dict[str, np.ndarray], params: ModelEvaluateParams) -> list[str]:
    absent = [h for h in params.horizons if h not in arrays["horizon"]]
    return [f"no held-out sequence has {absent[0]} strokes in a row: that horizon is left out"] if absent else []
