"""Metrics of many windows as a few rows, and rows as text."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from piegraph_cli.evaluation.statistics import bootstrap_grid
from piegraph_cli.text import Column, Line, Table

METRICS = ("cd", "s", "cd+s", "pd", "pd_truth")

Metrics = Mapping[str, Sequence[Mapping[str, np.ndarray]]]
"""By model, the metrics of each of its seeds."""


def sequence_means(metrics: Sequence[Mapping[str, np.ndarray]], metric: str, horizon: int) -> np.ndarray:
    """Mean of a metric over the windows of each sequence [seed, sequence]; sequences without a finite value are left out."""
    rows = []
    for one in metrics:
        values = one["cd"] + one["s"] if metric == "cd+s" else one[metric]
        chosen = (one["horizon"] == horizon) & np.isfinite(values)
        names, place = np.unique(one["sequence"][chosen], return_inverse=True)
        rows.append(
            np.bincount(place, values[chosen], len(names)) / np.maximum(np.bincount(place, minlength=len(names)), 1)
        )
    return np.array(rows)


def summarise(metrics: Metrics) -> list[dict[str, Any]]:
    """One row per horizon and model: windows, seeds, and (mean, low, high) of each metric."""
    rows = []
    horizons = sorted({int(h) for seeds in metrics.values() for one in seeds for h in one["horizon"]})
    for horizon in horizons:
        for model, seeds in metrics.items():
            windows = int((seeds[0]["horizon"] == horizon).sum())
            row: dict[str, Any] = {"model": model, "horizon": horizon, "windows": windows, "seeds": len(seeds)}
            rows.append(row | {m: bootstrap_grid(sequence_means(seeds, m, horizon)) for m in METRICS})
    return rows


def difference(metrics: Metrics, first: str, second: str, metric: str, horizon: int) -> tuple[float, float, float]:
    """How much larger a metric of `second` is than that of `first` (mean, low, high), paired by seed and sequence.

    A model that is not trained is compared with every seed of the other.
    """
    a, b = (sequence_means(metrics[name], metric, horizon) for name in (first, second))
    return bootstrap_grid(b - a)


def score_values(scores: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Finite values of each named score, over all sequences."""
    if not scores:
        return {}
    names, values = (np.concatenate([one[part] for one in scores]) for part in ("score_name", "score_value"))
    return {n.decode(): values[(names == n) & np.isfinite(values)] for n in dict.fromkeys(names.tolist())}


def summarise_scores(scores: Sequence[Mapping[str, np.ndarray]]) -> list[dict[str, Any]]:
    """Perception and tracking against the truth, over all frames of all sequences: mean, median and 90th percentile."""
    rows = []
    for name, values in score_values(scores).items():
        if len(values):
            median, high = np.quantile(values, [0.5, 0.9])
            rows.append({"score": name, "values": len(values), "mean": values.mean(), "median": median, "p90": high})
    return rows


def as_json(value: Any) -> str:
    """JSON text of a result, arrays as lists, `null` for what is not finite: NaN is not JSON."""

    def finite(part: Any) -> Any:
        if isinstance(part, (np.ndarray, np.generic)):
            part = part.tolist()
        if isinstance(part, dict):
            return {name: finite(inner) for name, inner in part.items()}
        if isinstance(part, (list, tuple)):
            return [finite(inner) for inner in part]
        return None if isinstance(part, float) and not math.isfinite(part) else part

    return json.dumps(finite(value), indent=1)


def interval(of: tuple[float, float, float], sign: str = "") -> str:
    """`1.20 [1.10, 1.31]`; `1.20` alone where there is no interval."""
    return f"{of[0]:{sign}.2f}" + (f" [{of[1]:{sign}.2f}, {of[2]:{sign}.2f}]" if math.isfinite(of[1]) else "")


def table_lines(rows: list[dict[str, Any]], scores: list[dict[str, Any]]) -> list[Line]:
    """The summaries as tables for people."""
    heads = [("H", 2), ("model", 14), ("windows", 7), ("PD [cm]", 20), ("CD [cm]", 8), ("S [cm2]", 8), ("CD+S", 8)]
    columns = [Column(name, width, right=name != "model") for name, width in [*heads, ("PD truth [cm]", 14)]]
    told = [
        (
            *(str(row["horizon"]), row["model"], str(row["windows"]), interval(row["pd"])),
            *(f"{row[name][0]:.2f}" for name in ("cd", "s", "cd+s")),
            f"{row['pd_truth'][0]:.2f}" if np.isfinite(row["pd_truth"][0]) else "-",
        )
        for row in rows
    ]
    lines: list[Line] = [Table(columns, told)]
    if scores:
        heads = [("against the truth", 40), ("values", 7), ("mean", 8), ("median", 8), ("p90", 8)]
        columns = [Column(name, width, right=name != "against the truth") for name, width in heads]
        told = [(s["score"], str(s["values"]), *(f"{s[n]:.3f}" for n in ("mean", "median", "p90"))) for s in scores]
        lines += ["", Table(columns, told)]
    return lines
