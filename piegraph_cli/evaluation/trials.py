"""Trials of planning as a few rows: final distances, success rates, strokes to success, effect sizes; and rows as text."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from piegraph_cli.evaluation.statistics import bootstrap_mean, cliffs_delta_paired


@dataclass(frozen=True)
class Trial:
    """One attempt of a model at one goal from one start."""

    environment: str
    model: str
    goal: int
    seed: int
    pd: np.ndarray
    """[S + 1] particle distance to the goal before the first stroke and after each (m)."""
    cd: np.ndarray
    """[S + 1] chamfer distance, the sum of both directions (m)."""
    seconds: np.ndarray
    """[S] that each plan took."""

    def strokes_to(self, threshold: float) -> float:
        """Strokes until the particle distance was first below the threshold (m); infinite where it never was."""
        below = np.flatnonzero(self.pd < threshold)
        return float(below[0]) if len(below) else np.inf


def select(trials: Sequence[Trial], environment: str, model: str) -> list[Trial]:
    """The trials of one model in one environment."""
    return [t for t in trials if (t.environment, t.model) == (environment, model)]


def summarise_trials(trials: Sequence[Trial], thresholds: Sequence[float]) -> list[dict[str, Any]]:
    """One row per environment and model, distances in metres.

    `pd` and `cd` are final distances. A trial counts as a success below a threshold from the first stroke that brings
    its particle distance there. `strokes` is the median over all trials, where those that never got there (`unsolved`)
    count as larger than any: None where these are half or more.
    """
    rows = []
    for environment, model in dict.fromkeys((t.environment, t.model) for t in trials):
        own = select(trials, environment, model)
        row: dict[str, Any] = {"environment": environment, "model": model, "trials": len(own)}
        for name in ("pd", "cd"):
            final = np.array([getattr(t, name)[-1] for t in own])
            mean, low, high = bootstrap_mean(final)
            row[name] = {"mean": mean, "low": low, "high": high, "median": float(np.median(final))}
        row["success"] = [_success(own, threshold) for threshold in thresholds]
        seconds = np.concatenate([t.seconds for t in own])
        row["seconds_per_plan"] = float(seconds.mean()) if len(seconds) else None
        rows.append(row)
    return rows


def _success(trials: Sequence[Trial], threshold: float) -> dict[str, Any]:
    strokes = np.array([t.strokes_to(threshold) for t in trials])
    unsolved = int(np.isinf(strokes).sum())
    middle = float(np.median(strokes))
    return {
        "below": threshold,
        "rate": 1 - unsolved / len(trials),
        "strokes": middle if np.isfinite(middle) else None,
        "unsolved": unsolved,
    }


def compare_trials(trials: Sequence[Trial], thresholds: Sequence[float]) -> list[dict[str, Any]]:
    """Cliff's delta (delta, low, high) between any two models of an environment, over the tasks that both have.

    `pd` is for the final particle distance, `strokes` for strokes to each threshold (m); positive: `first` is better.
    """
    rows = []
    for environment in dict.fromkeys(t.environment for t in trials):
        models = dict.fromkeys(t.model for t in trials if t.environment == environment)
        for first, second in combinations(models, 2):
            ones, others = ({(t.goal, t.seed): t for t in select(trials, environment, m)} for m in (first, second))
            tasks = sorted(ones.keys() & others.keys())

            def delta(value, ones=ones, others=others, tasks=tasks):
                return cliffs_delta_paired(*(np.array([value(of[task]) for task in tasks]) for of in (ones, others)))

            row: dict[str, Any] = {"environment": environment, "first": first, "second": second, "pairs": len(tasks)}
            if tasks:
                row["pd"] = delta(lambda t: t.pd[-1])
                row["strokes"] = [
                    {"below": limit, "delta": delta(lambda t, limit=limit: t.strokes_to(limit))} for limit in thresholds
                ]
            rows.append(row)
    return rows


def trial_lines(rows: Sequence[dict[str, Any]], comparisons: Sequence[dict[str, Any]], strokes: int) -> list[str]:
    """The summaries as tables for people; `strokes` is the most that a trial may take."""
    if not rows:
        return []
    limits = "/".join(f"{s['below'] * 100:g}" for s in rows[0]["success"])
    distance = "mean [95 %]  median"
    heads = f"{'PD [cm] ' + distance:>28s} {'CD [cm] ' + distance:>28s}  {f'% below {limits} cm':>20s}"
    lines = [f"{'environment':15s} {'model':12s} {'trials':>6s} {heads}  {'strokes to these':>16s} {'s/plan':>7s}"]
    for row in rows:
        rates = "/".join(f"{100 * s['rate']:.0f}" for s in row["success"])
        medians = "/".join(f">{strokes}" if s["strokes"] is None else f"{s['strokes']:g}" for s in row["success"])
        seconds = "-" if row["seconds_per_plan"] is None else f"{row['seconds_per_plan']:.2f}"
        lines.append(
            f"{row['environment']:15s} {row['model']:12s} {row['trials']:6d} {_spread(row['pd']):>28s} "
            f"{_spread(row['cd']):>28s}  {rates:>20s}  {medians:>16s} {seconds:>7s}"
        )
    lines.append(
        "PD particle distance, CD chamfer distance, at the trial's end; strokes: median, unsolved trials as more than any"
    )
    if any("pd" in row for row in comparisons):
        least = min(s["below"] for s in rows[0]["success"]) * 100
        lines += ["", f"{'Cliffs delta':49s} {'pairs':>5s} {'final PD':>22s} {f'strokes to {least:g} cm':>22s}"]
    for row in comparisons:
        if "pd" in row:
            fewest = min(row["strokes"], key=lambda s: s["below"])["delta"]
            who = f"{row['environment']:15s} {row['first']} over {row['second']}"
            lines.append(f"{who:49s} {row['pairs']:5d} {_delta(row['pd']):>22s} {_delta(fewest):>22s}")
    return lines


def _spread(of: dict[str, float]) -> str:
    mean, low, high, median = (of[name] * 100 for name in ("mean", "low", "high", "median"))
    return f"{mean:.2f} [{low:.2f},{high:.2f}] {median:6.2f}"


def _delta(of: tuple[float, float, float]) -> str:
    delta, low, high = of
    return f"{delta:+.2f} [{low:+.2f},{high:+.2f}]"
