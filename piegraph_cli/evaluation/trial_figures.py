"""Plots of trials per environment and model: final error, strokes to solve, success over thresholds, distance over strokes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from piegraph_cli.evaluation.colors import model_color
from piegraph_cli.evaluation.trials import Trial, select

WIDEST = 0.15
"""Thresholds of success are drawn up to this, metres."""


def _models(trials: Sequence[Trial]) -> dict[str, str]:
    """The models with a colour each, in the order of the trials."""
    return {name: model_color(name) for name in dict.fromkeys(t.model for t in trials)}


def _grid(trials: Sequence[Trial], rows: int, height: float) -> tuple[Figure, dict[str, list[Axes]]]:
    """A figure with a column of axes per environment."""
    environments = list(dict.fromkeys(t.environment for t in trials))
    figure = Figure(figsize=(max(3.0 * len(environments), 5.0), height * rows), layout="constrained")
    grid = figure.subplots(rows, len(environments), squeeze=False)
    return figure, {name: list(grid[:, column]) for column, name in enumerate(environments)}


def box_figure(
    trials: Sequence[Trial], comparisons: Sequence[dict[str, Any]], threshold: float, strokes: int
) -> Figure:
    """Box plots of the final particle distance and of the strokes until it is below the threshold (m).

    Boxes are quartiles, whiskers the remaining range without outliers. Titles have Cliff's delta of the first model over
    each other one, from the rows of `compare_trials`. Unsolved trials are drawn at the most strokes of a trial.
    Source: paper, figure "Simulated Planning Results (Quantitative)".
    """
    figure, columns = _grid(trials, 2, 3.2)
    models = _models(trials)
    for environment, (error, steps) in columns.items():
        own = [select(trials, environment, model) for model in models]
        shown = [k for k, found in enumerate(own) if found]
        _boxes(
            error, [np.array([t.pd[-1] for t in own[k]]) * 100 for k in shown], [list(models)[k] for k in shown], models
        )
        taken = [np.minimum([t.strokes_to(threshold) for t in own[k]], strokes) for k in shown]
        _boxes(steps, taken, [list(models)[k] for k in shown], models)
        of = [c for c in comparisons if c["environment"] == environment and c["first"] == list(models)[shown[0]]]
        error.set_yscale("log")
        error.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
        error.minorticks_off()
        error.axhline(threshold * 100, color="0.6", lw=0.8, ls=":")
        error.set_title(_deltas(environment, of, lambda c: c["pd"]), fontsize=8)
        steps.set_title(_deltas("", of, lambda c: _at(c, threshold)), fontsize=8)
        steps.set_ylim(0, strokes * 1.05)
    first = next(iter(columns.values()))
    first[0].set_ylabel("final particle distance [cm]")
    first[1].set_ylabel(f"strokes to {threshold * 100:g} cm (unsolved: {strokes})")
    return figure


def _boxes(axes: Axes, values: list[np.ndarray], names: list[str], colors: dict[str, str]) -> None:
    drawn = axes.boxplot(values, tick_labels=names, showfliers=False, patch_artist=True, widths=0.6)
    for box, name in zip(drawn["boxes"], names, strict=True):
        box.set(facecolor=colors[name], alpha=0.45)
    for line in drawn["medians"]:
        line.set(color="k", lw=1.5)
    axes.tick_params(axis="x", rotation=30, labelsize=8)


def _at(comparison: dict[str, Any], threshold: float) -> tuple[float, float, float]:
    return next(s["delta"] for s in comparison["strokes"] if s["below"] == threshold)


def _deltas(head: str, comparisons: Sequence[dict[str, Any]], of: Callable[[dict[str, Any]], tuple]) -> str:
    lines = [head] if head else []
    for comparison in comparisons:
        if comparison["pairs"]:
            delta, low, high = of(comparison)
            lines.append(f"δ = {delta:+.2f} [{low:+.2f}, {high:+.2f}] over {comparison['second']}")
    return "\n".join(lines)


def success_figure(trials: Sequence[Trial], thresholds: Sequence[float], strokes: int) -> Figure:
    """The share of trials that come below a particle distance, over that distance."""
    figure, columns = _grid(trials, 1, 3.2)
    models = _models(trials)
    for environment, (axes,) in columns.items():
        for model, color in models.items():
            nearest = np.sort([t.pd.min() for t in select(trials, environment, model)]) * 100
            if len(nearest):
                edges = np.concatenate([[0], nearest, [max(nearest[-1], WIDEST * 100)]])
                share = np.append(np.arange(len(nearest) + 1) / len(nearest), 1) * 100
                axes.step(edges, share, where="post", color=color, label=model)
        for threshold in thresholds:
            axes.axvline(threshold * 100, color="0.6", lw=0.8, ls=":")
        axes.set(xlim=(min(thresholds) * 100 * 0.5, WIDEST * 100), ylim=(-3, 103), xlabel="threshold [cm]")
        axes.set_title(environment, fontsize=9)
    first = next(iter(columns.values()))[0]
    first.set_ylabel(f"solved within {strokes} strokes [%]")
    first.legend(fontsize=7)
    return figure


def distance_figure(trials: Sequence[Trial], strokes: int) -> Figure:
    """Particle and chamfer distance over strokes: median, and the 40th to 60th percentile as a band.

    A trial that has ended keeps its last distance. Source: paper, figure "Robot Planning Results".
    """
    figure, columns = _grid(trials, 2, 2.8)
    models = _models(trials)
    for environment, column in columns.items():
        for axes, name in zip(column, ("pd", "cd"), strict=True):
            for model, color in models.items():
                own = [getattr(t, name) for t in select(trials, environment, model)]
                if own:
                    curves = np.array([np.pad(c, (0, strokes + 1 - len(c)), mode="edge") for c in own]) * 100
                    low, middle, high = np.quantile(curves, [0.4, 0.5, 0.6], axis=0)
                    axes.plot(middle, color=color, label=model, lw=1.5)
                    axes.fill_between(np.arange(strokes + 1), low, high, color=color, alpha=0.2, lw=0)
            axes.set_ylim(bottom=0)
        column[0].set_title(environment, fontsize=9)
        column[1].set_xlabel("strokes")
    first = next(iter(columns.values()))
    first[0].set_ylabel("particle distance [cm]")
    first[1].set_ylabel("chamfer distance [cm]")
    first[0].legend(fontsize=7)
    return figure
