"""Predictions over windows of held-out strokes, measured."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained, make_foresee
from piegraph_cli.evaluation.metrics import CENTIMETRE, SHAPE_RADIUS, chamfer_distance, particle_distance, shape_error
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.physics.springs import build_springs


def rollouts(
    sequence: dict[str, Any], trained: Trained | None, params: ModelEvaluateParams, longest: int, device: str = "cpu"
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """For each horizon up to `longest` strokes: it, the particles [W, N, 3] (m) predicted at the end of each window, and the
    signs [W, 2] (m) of how far off they may be, summed over the strokes: see `dynamics.reliability`.

    All windows advance as one batch: window w starts before stroke w. `sequence` as for `window_metrics`.
    """
    strokes = sequence["strokes"].to(device, torch.float32)
    foresee = make_foresee(params.label, trained, torch.as_tensor(sequence["rest"], device=device), params)
    positions = torch.as_tensor(sequence["before"], device=device)
    total = torch.zeros(len(strokes), 2, device=device)
    for horizon in range(1, min(longest, len(strokes)) + 1):
        windows = len(strokes) - horizon + 1
        positions, signs = foresee(positions[:windows], strokes[horizon - 1 :])
        total = total[:windows] + signs
        yield horizon, positions.cpu().numpy(), total.cpu().numpy()


def window_metrics(
    sequence: dict[str, Any],
    true: np.ndarray | None,
    trained: Trained | None,
    params: ModelEvaluateParams,
    device: str = "cpu",
):
    """Rows (horizon, first stroke, CD, S, PD, PD to the truth, two signs of the error (cm)) of all windows.

    `sequence`: rest [N, 3], before and after [S, N, 3] (m), strokes and frames [S, 2], and whether each stroke follows [S] on
    the one before with nothing unknown in between: where one does not, no window goes on. Particles that were not `seen`
    [2, S, N] before the window or after it do not count. `true` [F, N, 3] (m) or None. The model predicts on `device`.
    """
    edges = build_springs(sequence["rest"], SHAPE_RADIUS).pairs
    for horizon, positions, signs in rollouts(sequence, trained, params, max(params.horizons), device):
        if horizon not in params.horizons:
            continue
        for window, found in enumerate(positions):
            last = window + horizon - 1
            if not sequence["follows"][window + 1 : last + 1].all():
                continue
            target = sequence["after"][last]
            known = sequence["seen"][0, window] & sequence["seen"][1, last]
            metrics = _measured(found, target, known, edges)
            if metrics is None:
                continue
            at_end = None if true is None else true[sequence["frames"][last, 1]]
            metrics.append(float("nan") if at_end is None else particle_distance(found, at_end))
            yield horizon, window, *metrics, *(signs[window] * CENTIMETRE)


def _measured(found: np.ndarray, target: np.ndarray, known: np.ndarray, edges: np.ndarray) -> list[float] | None:
    """CD, S and PD over the particles that are known [N]; None where no two of them are joined by an edge."""
    joined = edges[known[edges].all(1)]
    if not len(joined):
        return None
    found_known, target_known = found[known], target[known]
    return [
        chamfer_distance(found_known, target_known),
        shape_error(found, target, joined),
        particle_distance(found_known, target_known),
    ]
