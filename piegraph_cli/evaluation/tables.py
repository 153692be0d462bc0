"""Metrics of many windows as a few rows, and rows as text."""

from typing import Any

import numpy as np

from piegraph_cli.evaluation.statistics import bootstrap_mean

METRICS = ("cd", "s", "pd", "pd_truth")


def summarise(metrics: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """One row per model and horizon: windows, and (mean, low, high) of each metric."""
    rows = []
    models = metrics["model"].astype("S128")
    for horizon in np.unique(metrics["horizon"]):
        for model in dict.fromkeys(models.tolist()):
            chosen = (models == model) & (metrics["horizon"] == horizon)
            row: dict[str, Any] = {"model": model.decode(), "horizon": int(horizon), "windows": int(chosen.sum())}
            for name in METRICS:
                values = metrics[name][chosen]
                row[name] = bootstrap_mean(values[np.isfinite(values)])
            row["cd+s"] = bootstrap_mean(metrics["cd"][chosen] + metrics["s"][chosen])
            rows.append(row)
    return rows


def summarise_scores(metrics: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Perception and tracking against the truth, over all frames of all sequences: mean, median and 90th percentile."""
    rows = []
    for name in dict.fromkeys(metrics["score_name"].tolist()):
        values = metrics["score_value"][metrics["score_name"] == name]
        values = values[np.isfinite(values)]
        if len(values):
            median, high = np.quantile(values, [0.5, 0.9])
            rows.append(
                {"score": name.decode(), "values": len(values), "mean": values.mean(), "median": median, "p90": high}
            )
    return rows


def table_lines(rows: list[dict[str, Any]], scores: list[dict[str, Any]]) -> list[str]:
    """The summaries as a table for people."""
    heads = f"{'PD [cm]':>18s} {'CD [cm]':>8s} {'S [cm2]':>8s} {'CD+S':>8s} {'PD truth [cm]':>14s}"
    lines = [f"{'H':>2s} {'model':14s} {'windows':>7s} {heads}"]
    for row in rows:
        mean, low, high = row["pd"]
        text = f"{mean:6.2f} [{low:5.2f},{high:5.2f}]"
        truth = f"{row['pd_truth'][0]:14.2f}" if np.isfinite(row["pd_truth"][0]) else f"{'-':>14s}"
        lines.append(
            f"{row['horizon']:2d} {row['model']:14s} {row['windows']:7d} {text:>18s} {row['cd'][0]:8.2f} "
            f"{row['s'][0]:8.2f} {row['cd+s'][0]:8.2f} {truth}"
        )
    if scores:
        lines += ["", f"{'against the truth':40s} {'values':>7s} {'mean':>8s} {'median':>8s} {'p90':>8s}"]
        lines += [
            f"{s['score']:40s} {s['values']:7d} {s['mean']:8.3f} {s['median']:8.3f} {s['p90']:8.3f}" for s in scores
        ]
    return lines
