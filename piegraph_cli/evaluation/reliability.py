"""Whether models know how far off they are: expected errors against real ones on held-out strokes, as rows and text."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from piegraph_cli.dynamics.reliability import Calibration, calibrated_apart
from piegraph_cli.evaluation.metrics import CENTIMETRE
from piegraph_cli.evaluation.tables import Metrics
from piegraph_cli.text import Column, Line, Table

BINS = 5
"""Groups of as many predictions each, from the surest to the least sure."""
FEWEST = 20
"""Predictions of a model below which nothing is said."""


def signs_and_errors(metrics: Mapping[str, np.ndarray], horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signs [n, 2] and errors [n] (m) of the windows of one horizon in the arrays of `metrics`, and their sequences [n]."""
    own = metrics["horizon"] == horizon
    signs = np.stack([metrics["motion"][own], metrics["correction"][own]], 1)
    return signs / CENTIMETRE, metrics["pd"][own] / CENTIMETRE, metrics["sequence"][own]


def calibration_of(metrics: Mapping[str, np.ndarray]) -> Calibration | None:
    """What error to expect of a model with these metrics; None where it was not measured one stroke ahead."""
    signs, errors, _ = signs_and_errors(metrics, 1)
    return Calibration.fit(signs, errors) if len(errors) else None


def reliability(metrics: Metrics) -> list[dict[str, Any]]:
    """A row per horizon and model whose predictions tell how sure they are, from calibrations on other sequences (m).

    `rank` is the rank correlation of expected and real errors, `within` the share of real errors below the bound that should
    hold for nine in ten; of each bin the mean expected error and the mean real one. Expected errors of several strokes are
    those of single strokes together, see `dynamics.reliability`.
    """
    from scipy.stats import spearmanr  # a plan, which takes calibrations alone, does without

    horizons = sorted({int(h) for seeds in metrics.values() for one in seeds for h in one["horizon"]})
    rows = []
    for horizon in horizons:
        for model, seeds in metrics.items():
            expected, errors, bounds = (
                np.concatenate(part) for part in zip(*(_expected(s, horizon) for s in seeds), strict=True)
            )
            if len(errors) < FEWEST or not any(one["motion"].any() for one in seeds):
                continue
            parts = np.array_split(np.argsort(expected, kind="stable"), BINS)
            row = {"model": model, "horizon": horizon, "predictions": len(errors), "seeds": len(seeds)}
            row |= {"rank": float(spearmanr(expected, errors)[0]), "within": float((errors < bounds).mean())}
            row["bins"] = [{"expected": float(expected[p].mean()), "error": float(errors[p].mean())} for p in parts]
            rows.append(row)
    return rows


def _expected(metrics: Mapping[str, np.ndarray], horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Expected and real errors [n] (m) of one seed's windows, and bounds, each calibrated on the other sequences."""
    known = calibrated_apart(*signs_and_errors(metrics, 1))
    signs, errors, sequences = signs_and_errors(metrics, horizon)
    own = np.isin(sequences, list(known))
    signs, errors, sequences = signs[own], errors[own], sequences[own]
    expected = np.array([known[s].expected(sign, horizon) for s, sign in zip(sequences, signs, strict=True)])
    return expected, errors, expected * np.array([known[s].bound for s in sequences])


def reliability_lines(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """The rows as a table for people."""
    if not rows:
        return []
    heads = [("H", 2), ("model", 14), ("n", 5), ("rank", 5), ("within 0.9", 10), ("expected > real error [cm]", 60)]
    columns = [Column(name, width, right=name != "model") for name, width in heads]
    told = [
        (
            *(str(row["horizon"]), row["model"], str(row["predictions"]), f"{row['rank']:.2f}", f"{row['within']:.2f}"),
            ", ".join(f"{b['expected'] * 100:.2f} > {b['error'] * 100:.2f}" for b in row["bins"]),
        )
        for row in rows
    ]
    note = "What error was expected of predictions, and what it was, from the surest fifth to the least sure"
    return ["", note, Table(columns, told)]
