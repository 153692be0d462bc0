"""Stage `evaluate`: predictions on held-out sequences, and scores of a simulated recording against its truth."""

from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.action import make_strokes
from piegraph_cli.dynamics.egnn import EGNN
from piegraph_cli.dynamics.models import make_predict
from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.metrics import chamfer_distance, particle_distance, shape_error
from piegraph_cli.evaluation.tables import METRICS, summarise
from piegraph_cli.params import EvaluateParams
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages.dataset import TEST
from piegraph_cli.stages.scores import score_sequence, true_positions
from piegraph_cli.stages.train import read_network
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.execute import Context, Output


def run(inputs: dict[str, Any], params: EvaluateParams, context: Context) -> Output:
    """Measure every model on every window of held-out strokes."""
    set_up_torch()
    data, network = inputs["dataset"], read_network(inputs["model"])
    names = data.texts("sequence_name")
    rows: dict[str, list] = {name: [] for name in ("model", "horizon", "sequence", "first_stroke", *METRICS)}
    truth = _truth(inputs, context)
    for index in context.progress(np.flatnonzero(data["sequence_split"] == TEST), "evaluate"):
        sequence = read_sequence(data, int(index))
        true = truth.get(names[index])
        for row in _evaluate_sequence(sequence, true, network, params):
            for column, value in zip(rows, (row[0], row[1], names[index], *row[2:]), strict=True):
                rows[column].append(value)
    if not rows["model"]:
        raise DataError(
            f"no held-out sequence has {min(params.horizons)} strokes in a row", hint="record longer sequences"
        )
    scores = [(score, name, value) for name in truth for score, value in score_sequence(inputs, name, context.run)]
    arrays = {name: np.array(values) for name, values in rows.items()}
    arrays |= {
        "score_name": np.array([s[0] for s in scores], "S128"),
        "score_sequence": np.array([s[1] for s in scores], "S128"),
        "score_value": np.array([s[2] for s in scores], float),
    }
    return Output(arrays, _quality(arrays, params), _warnings(arrays, params))


def read_sequence(data: Artifact, index: int) -> dict[str, np.ndarray]:
    """One sequence: `rest` [N, 3], and per stroke `before`, `after` [S, N, 3], `strokes` [S, 5], `frames` [S, 2]."""
    chosen = data["stroke_sequence"] == index
    first, last = data["strokes"][chosen].T
    hand = data["end_effector"]
    start = int(data["sequence_start"][index])
    return {
        "rest": data["positions"][start],
        "before": data["positions"][first],
        "after": data["positions"][last],
        "strokes": make_strokes(hand[first], hand[last], data["stroke_mode"][chosen]).numpy(),
        "frames": np.stack([first, last], 1) - start,
    }


def _evaluate_sequence(sequence: dict[str, np.ndarray], true: np.ndarray | None, network: EGNN, params: EvaluateParams):
    """Rows (model, horizon, first stroke, metrics) of all windows of one sequence; all windows advance as one batch."""
    count = len(sequence["strokes"])
    edges = build_springs(sequence["rest"], params.spring_radius).pairs
    rest, strokes = (torch.as_tensor(sequence[name], dtype=torch.float32) for name in ("rest", "strokes"))
    for name in params.models:
        predict = make_predict(name, network, rest, params)
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
                yield name, horizon, window, *metrics


def _truth(inputs: dict[str, Any], context: Context) -> dict[str, np.ndarray]:
    """True positions [F, N, 3] of the tracked particles, for the sequences of a simulated recording."""
    if "frames" not in inputs:
        return {}
    found = {name: true_positions(inputs, name, context.run) for name in inputs["tracks"]}
    return {name: true for name, true in found.items() if true is not None}


def _quality(arrays: dict[str, np.ndarray], params: EvaluateParams) -> str:
    rows = {(r["model"], r["horizon"]): r["pd"][0] for r in summarise(arrays)}
    name = "piegraph" if "piegraph" in params.models else params.models[0]
    parts = [f"H={h} {rows[name, h]:.2f}" for h in params.horizons if (name, h) in rows]
    return f"{name} PD [cm] {', '.join(parts)} on {len(np.unique(arrays['sequence']))} held-out sequences"


def _warnings(arrays: dict[str, np.ndarray], params: EvaluateParams) -> list[str]:
    absent = [h for h in params.horizons if h not in arrays["horizon"]]
    return [f"no held-out sequence has {absent[0]} strokes in a row: that horizon is left out"] if absent else []
