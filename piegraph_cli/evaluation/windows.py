"""Predictions over windows of held-out strokes, measured."""

from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained, make_predict
from piegraph_cli.evaluation.metrics import SHAPE_RADIUS, chamfer_distance, particle_distance, shape_error
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.physics.springs import build_springs


def window_metrics(
    sequence: dict[str, Any],
    true: np.ndarray | None,
    trained: Trained | None,
    params: ModelEvaluateParams,
    device: str = "cpu",
):
    """Rows (horizon, first stroke, CD, S, PD, PD to the truth) of all windows; all of them advance as one batch.

    `sequence`: rest [N, 3], before and after [S, N, 3] (m), strokes and frames [S, 2], and whether each stroke follows [S] on
    the one before with nothing unknown in between: where one does not, no window goes on. Particles that were not `seen`
    [2, S, N] before the window or after it do not count. `true` [F, N, 3] (m) or None. The model predicts on `device`.
    """
    count = len(sequence["strokes"])
    edges = build_springs(sequence["rest"], SHAPE_RADIUS).pairs
    rest = torch.as_tensor(sequence["rest"], device=device)
    strokes = sequence["strokes"].to(device, torch.float32)
    predict = make_predict(params.label, trained, rest, params)
    positions = torch.as_tensor(sequence["before"], device=device)
    for horizon in range(1, min(max(params.horizons), count) + 1):
        windows = count - horizon + 1
        positions = predict(positions[:windows], strokes[horizon - 1 :])
        if horizon not in params.horizons:
            continue
        for window in range(windows):
            last = window + horizon - 1
            if not sequence["follows"][window + 1 : last + 1].all():
                continue
            found, target = positions[window].cpu().numpy(), sequence["after"][last]
            known = sequence["seen"][0, window] & sequence["seen"][1, last]
            joined = edges[known[edges].all(1)]
            if not len(joined):
                continue
            metrics = [
                chamfer_distance(found[known], target[known]),
                shape_error(found, target, joined),
                particle_distance(found[known], target[known]),
            ]
            at_end = None if true is None else true[sequence["frames"][last, 1]]
            metrics.append(float("nan") if at_end is None else particle_distance(found, at_end))
            yield horizon, window, *metrics
