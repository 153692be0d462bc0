"""Plots, as matplotlib figures that no window ever shows: errors of tracks and models, losses, plans.

Lines and text that have no meaning of their own are black: the report makes them fit a light and a dark ground.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from piegraph_cli.evaluation.colors import GOAL, OBJECT, PREDICTED, model_color, model_marker

UNITS = {"pd": "cm", "cd": "cm", "s": "cm²"}
"""Of the metrics that are drawn."""
APART = 0.5
"""Of the step between two horizons, what the models at one of them take: none lies on another."""
GOAL_DOTS = 300
"""A goal that is a cloud is drawn with this many points."""


def particle_colors(positions: np.ndarray) -> np.ndarray:
    """A colour [N, 3] in 0-1 per particle [N, 3], by its direction from the middle, so that rotation shows."""
    offset = positions[:, :2] - positions[:, :2].mean(0)
    hue = (np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi)) % 1
    return hsv_to_rgb(np.stack([hue, np.full_like(hue, 0.85), np.full_like(hue, 0.95)], -1))


def time_figure(time: np.ndarray, series: Mapping[str, np.ndarray], contact: np.ndarray) -> Figure:
    """Named lengths [F] (mm) over time [F] (s); the frames in which the hand touches the object are shaded."""
    figure = Figure(figsize=(5.2, 2.1), layout="constrained")
    axes = figure.subplots()
    for (name, values), color, style in zip(series.items(), (OBJECT, GOAL, PREDICTED), ("-", "--", ":"), strict=False):
        axes.plot(time, values, style, color=color, label=name, lw=1.6)
    shade = axes.get_xaxis_transform()
    axes.fill_between(time, 0, 1, where=contact, transform=shade, color="0.5", alpha=0.18, lw=0, label="contact")
    axes.set(xlabel="time [s]", ylabel="mm")
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left", ncols=4, fontsize=8)
    axes.set_ylim(top=axes.get_ylim()[1] * 1.3)  # room for the legend
    return figure


def loss_figure(curves: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], label: str) -> Figure:
    """Training and validation losses over steps (each [K]) of one model, from each of its seeds."""
    figure = Figure(figsize=(4.2, 2.9), layout="constrained")
    axes, color = figure.subplots(), model_color(label)
    for seed, (step, train, validation) in enumerate(curves):
        axes.semilogy(step, train, color=color, lw=1.6, label=None if seed else "training")
        if np.isfinite(validation).any():
            axes.semilogy(step, validation, "--", color=color, lw=1.2, label=None if seed else "validation")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="step", ylabel="loss", title=label)
    axes.legend(fontsize=8)
    return figure


def reliability_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Real over expected errors (cm) of the bins of `reliability`'s rows at one horizon; calibrated ones lie on the line."""
    figure = Figure(figsize=(4.2, 2.9), layout="constrained")
    axes = figure.subplots()
    for row in rows:
        expected, errors = 100 * np.array([[of["expected"], of["error"]] for of in row["bins"]]).T
        model = row["model"]
        axes.plot(expected, errors, color=model_color(model), marker=model_marker(model), ms=5, lw=1.2, label=model)
    top = max(*axes.get_xlim(), *axes.get_ylim())
    axes.plot([0, top], [0, top], ":", color="black", lw=1)
    axes.set(xlabel="expected error [cm]", ylabel="real error [cm]", xlim=(0, top), ylim=(0, top))
    return figure


def error_figure(rows: Sequence[dict[str, Any]], metric: str) -> Figure:
    """A metric over the horizon for each model of `summarise`'s rows, side by side; bars are 95 % intervals."""
    figure = Figure(figsize=(4.2, 2.9), layout="constrained")
    axes = figure.subplots()
    models = list(dict.fromkeys(row["model"] for row in rows))
    horizons = sorted({row["horizon"] for row in rows})
    for k, model in enumerate(models):
        own = [row for row in rows if row["model"] == model]
        mean, low, high = np.array([row[metric] for row in own]).T
        place = np.array([horizons.index(row["horizon"]) for row in own]) + APART * ((k + 0.5) / len(models) - 0.5)
        look: dict[str, Any] = {"color": model_color(model), "marker": model_marker(model)}
        axes.plot(place, mean, lw=0.8, alpha=0.5, color=look["color"])
        bars = np.nan_to_num([mean - low, high - mean])
        axes.errorbar(place, mean, bars, ls="none", ms=5, elinewidth=1.4, label=model, **look)
    axes.set(xlabel="strokes predicted in a row", ylabel=f"{metric.upper()} [{UNITS[metric]}]")
    axes.set_xticks(range(len(horizons)), [str(h) for h in horizons])
    axes.set_xlim(-0.5, len(horizons) - 0.5)
    axes.set_ylim(bottom=0)
    return figure


def plan_figure(steps: Sequence[dict[str, Any]], goal: np.ndarray) -> Figure:
    """A strip of one episode: state, stroke, prediction and goal [G, 3] at each step, then the state reached."""
    panels = len(steps) + 1
    columns = min(panels, 5)
    rows = -(-panels // columns)
    figure = Figure(figsize=(2.1 * columns, 2.3 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).reshape(-1)
    last = steps[-1]["after"] if np.isfinite(steps[-1]["after"]).all() else steps[-1]["predicted"]
    goal = goal[np.linspace(0, len(goal) - 1, min(len(goal), GOAL_DOTS)).astype(int)]
    everything = [goal, last, *(s["before"] for s in steps), *(np.asarray(s["stroke"]) for s in steps)]
    for k, axes in enumerate(grid):
        if k >= panels:
            axes.axis("off")
            continue
        state = steps[k]["before"] if k < len(steps) else last
        axes.scatter(*goal[:, :2].T, s=16, color=GOAL, alpha=0.35, lw=0, label="goal")
        axes.scatter(*state[:, :2].T, s=9, color=OBJECT, lw=0, label="object")
        if k < len(steps):
            (x0, y0), (x1, y1) = steps[k]["stroke"]
            axes.scatter(*steps[k]["predicted"][:, :2].T, s=5, color=PREDICTED, lw=0, label="predicted")
            axes.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "-|>", "color": "k", "lw": 1.5})
        reached = "reached" if last is steps[-1]["after"] else "predicted"
        axes.set_title(f"stroke {k + 1}" if k < len(steps) else reached, fontsize=9)
        _top_view(axes, everything)
    return figure


def suggestion_figure(state: np.ndarray, past: np.ndarray, suggested: np.ndarray) -> Figure:
    """An object [N, 3] with strokes that were recorded [K, 2, 2], moved to where it is, and those to record [n, 2, 2] (m)."""
    figure = Figure(figsize=(5.5, 5.5), layout="constrained")
    axes = figure.subplots()
    for start, end in past:
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": "0.75", "lw": 1})
    axes.scatter(state[:, 0], state[:, 1], s=25, color=OBJECT, lw=0)
    for number, (start, end) in enumerate(suggested, 1):
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": PREDICTED, "lw": 2})
        box = {"fc": "white", "ec": PREDICTED, "pad": 1.5}
        axes.text(start[0], start[1], str(number), fontsize=11, ha="center", va="center", bbox=box)
    axes.set_title(f"to record, in this order ({len(past)} recorded in grey)", fontsize=10)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    _top_view(axes, [state, *past, *suggested])
    return figure


def _top_view(axes: Axes, clouds: Sequence[np.ndarray], margin: float = 0.02) -> None:
    points = np.concatenate([cloud[:, :2] for cloud in clouds])
    middle, half = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0).max() / 2 + margin
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.locator_params(nbins=4)
