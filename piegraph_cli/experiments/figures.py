"""The figures of experiments: errors over horizons and over training data, planning, and what it led to."""

from collections.abc import Iterator
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from piegraph_cli.evaluation import trial_figures
from piegraph_cli.evaluation.colors import GOAL, OBJECT, model_color, model_marker
from piegraph_cli.evaluation.tables import Metrics, summarise
from piegraph_cli.evaluation.trials import compare_trials
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.results import Results
from piegraph_cli.experiments.tables import plain_metrics, plain_trials
from piegraph_cli.workspace.artifact import Artifact


def draw(params: ExperimentParams, results: Results) -> Iterator[tuple[str, Figure]]:
    """Name and figure of each that the results allow."""
    metrics = plain_metrics(params, results) if params.table != "search" else {}
    if metrics:
        yield "errors", error_grid(metrics)
    if params.table == "interactions" and any(len(params.interactions[env]) > 1 for env in metrics):  # type: ignore[index]
        yield "interactions", interaction_figure(metrics)
    if results.trials and params.trials:
        trials, limits = plain_trials(params, results.trials), params.trials.thresholds
        compared = compare_trials(trials, limits)
        yield "boxes", trial_figures.box_figure(trials, compared, min(limits), params.trials.strokes)
        yield "success", trial_figures.success_figure(trials, limits, params.trials.strokes)
        yield "distance", trial_figures.distance_figure(trials, params.trials.strokes)
        if results.shown:
            yield "overlays", overlay_figure(results.shown)


def error_grid(metrics: dict[str, Metrics]) -> Figure:
    """PD (top) and CD+S (bottom) over strokes predicted in a row, a column per environment; bands: 95 % intervals."""
    figure = Figure(figsize=(max(3.0 * len(metrics), 5.0), 6.0), layout="constrained")
    grid = figure.subplots(2, len(metrics), squeeze=False)
    for column, (env, of) in zip(grid.T, metrics.items(), strict=True):
        rows = summarise(of)
        for axes, metric, unit in zip(column, ("pd", "cd+s"), ("cm", "cm and cm²"), strict=True):
            for model in of:
                own = [row for row in rows if row["model"] == model]
                mean, low, high = np.array([row[metric] for row in own]).T
                horizons = [row["horizon"] for row in own]
                color = model_color(model)
                axes.plot(horizons, mean, marker=model_marker(model), ms=3, color=color, label=model)
                axes.fill_between(horizons, low, high, color=color, alpha=0.15, lw=0)
            axes.set(xticks=horizons, ylabel=f"{metric.upper()} [{unit}]")
        column[0].set_title(env, fontsize=10)
        column[0].set_ylim(bottom=0)
        column[1].set_yscale("log")
        column[1].set_xlabel("strokes predicted in a row")
    handles = {label: h for axes in grid[0] for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, fontsize=7)
    return figure


def interaction_figure(metrics: dict[str, Metrics]) -> Figure:
    """PD over the number of training sequences, a line per horizon of `piegraph`, or per model where there is one horizon.

    Bands: 95 % intervals.
    """
    figure = Figure(figsize=(max(3.0 * len(metrics), 5.0), 3.4), layout="constrained")
    for axes, (env, of) in zip(figure.subplots(1, len(metrics), squeeze=False)[0], metrics.items(), strict=True):
        rows = [(name, int(n), row) for row in summarise(of) for name, _, n in [row["model"].partition("@")] if n]
        one = len({row["horizon"] for _, _, row in rows}) == 1
        lines: dict[str, list] = {}
        for name, count, row in rows:
            if one or name == "piegraph":
                label = name if one else f"{row['horizon']} strokes ahead"
                lines.setdefault(label, []).append((count, *row["pd"]))
        for (label, points), style in zip(lines.items(), cycle(("-", "--", "-.", ":")), strict=False):
            counts, mean, low, high = np.array(sorted(points)).T
            color = model_color(label if one else "piegraph")
            axes.plot(counts, mean, style, marker=model_marker(label), ms=4, color=color, label=label)
            axes.fill_between(counts, low, high, color=color, alpha=0.15, lw=0)
        of_whom = "" if one else " of piegraph"
        axes.set(title=env, xlabel="training sequences", ylabel=f"PD{of_whom} [cm]")
        axes.set_xticks(sorted({count for _, count, _ in rows}))
        axes.set_ylim(bottom=0)
        axes.legend(fontsize=7)
    return figure


def overlay_figure(shown: dict[str, dict[str, Artifact]]) -> Figure:
    """One goal and start per row: the start, then what each model led to under the goal in red, with PD and strokes.

    Source: paper, figure "Simulated Planning Results (Qualitative)".
    """
    columns = 1 + max(len(of) for of in shown.values())
    figure = Figure(figsize=(2.5 * columns, 2.6 * len(shown)), layout="constrained")
    grid = figure.subplots(len(shown), columns, squeeze=False)
    for row, (env, of) in zip(grid, shown.items(), strict=True):
        any_trial = next(iter(of.values()))
        panels: list[tuple[str, Any, Artifact]] = [(f"{env}: start", any_trial["before"][:1], any_trial)]
        for model, trial in of.items():
            pd, strokes = trial["pd"][-1] * 100, len(trial["stroke"])
            panels.append((f"{model}: {pd:.1f} cm, {strokes} strokes", trial["after"][-1:], trial))
        for axes, (title, state, trial) in zip(row, panels, strict=False):
            for points in state:
                axes.scatter(*points[:, :2].T, s=9, color=OBJECT)
            axes.scatter(*trial["goal"][:, :2].T, s=14, color=GOAL, alpha=0.4, lw=0)
            axes.set_title(title, fontsize=8)
        seen = [any_trial["goal"], *any_trial["before"][:1], *(x for trial in of.values() for x in trial["after"][-1:])]
        everything = np.concatenate(seen)
        low, high = everything[:, :2].min(0) - 0.02, everything[:, :2].max(0) + 0.02
        for axes in row:
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
            axes.axis("off")
    return figure
