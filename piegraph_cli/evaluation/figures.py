"""Plots, as matplotlib figures that no window ever shows: clouds, tracks, losses, errors, plans."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure

from piegraph_cli.evaluation.colors import GOAL, OBJECT, PREDICTED, model_color, model_marker


def particle_colors(positions: np.ndarray) -> np.ndarray:
    """A colour [N, 3] in 0-1 per particle [N, 3], by its direction from the middle, so that rotation shows."""
    offset = positions[:, :2] - positions[:, :2].mean(0)
    hue = (np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi)) % 1
    return hsv_to_rgb(np.stack([hue, np.full_like(hue, 0.85), np.full_like(hue, 0.95)], -1))


def _top_view(axes: Axes, clouds: Sequence[np.ndarray], margin: float = 0.04) -> None:
    points = np.concatenate([cloud[:, :2] for cloud in clouds])
    middle, half = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0).max() / 2 + margin
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("x [m]", fontsize=7)
    axes.set_ylabel("y [m]", fontsize=7)


def cloud_figure(clouds: Sequence[np.ndarray], times: Sequence[float], title: str) -> Figure:
    """Fused clouds [P, 3] (m) of a few frames, from above and from the side, coloured by height."""
    figure = Figure(figsize=(3.6 * len(clouds), 5.2), layout="constrained")
    grid = figure.subplots(2, len(clouds), squeeze=False, height_ratios=[3, 1])
    for column, (cloud, time) in enumerate(zip(clouds, times, strict=True)):
        top, side = grid[:, column]
        marks = top.scatter(cloud[:, 0], cloud[:, 1], c=cloud[:, 2] * 1000, s=2, cmap="viridis", vmin=0, vmax=50)
        _top_view(top, [cloud])
        top.set_title(f"t = {time:.1f} s, {len(cloud)} points", fontsize=9)
        side.scatter(cloud[:, 0], cloud[:, 2], c=cloud[:, 2] * 1000, s=2, cmap="viridis", vmin=0, vmax=50)
        side.axhline(0, color="0.5", lw=0.8)
        side.set(xlim=top.get_xlim(), ylim=(-0.01, 0.08), xlabel="x [m]")
        side.tick_params(labelsize=7)
    grid[0, 0].set_ylabel("y [m]")
    grid[1, 0].set_ylabel("z [m]")
    figure.colorbar(marks, ax=grid, label="height [mm]", shrink=0.7)
    figure.suptitle(title, fontsize=10)
    return figure


def track_figure(
    positions: np.ndarray,
    true: np.ndarray | None,
    frames: Sequence[int],
    time: np.ndarray,
    hand: np.ndarray,
    contact: np.ndarray,
    title: str,
) -> Figure:
    """Tracked particles [F, N, 3] at some frames over the true ones (where known), and their mean error over time."""
    figure = Figure(figsize=(3.4 * len(frames), 5.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=[2, 1], squeeze=False)[:, 0]
    colors = particle_colors(positions[0])
    shown = [positions[list(frames)].reshape(-1, 3)]
    for axes, frame in zip(upper.subplots(1, len(frames), squeeze=False)[0], frames, strict=True):
        if true is not None:
            axes.scatter(*true[frame, :, :2].T, s=42, facecolors="none", edgecolors="k", linewidths=0.8, label="true")
        axes.scatter(*positions[frame, :, :2].T, c=colors, s=14, label="tracked")
        axes.plot(*hand[: frame + 1][contact[: frame + 1]][:, :2].T, ".", color="0.6", ms=2, label="hand")
        _top_view(axes, shown)
        axes.set_title(f"t = {time[frame]:.1f} s", fontsize=9)
        axes.legend(fontsize=6, loc="upper right")
    axes = lower.subplots()
    if true is not None:
        axes.plot(time, np.linalg.norm(positions - true, axis=-1).mean(-1) * 1000, color=OBJECT)
        axes.set_ylabel("mean particle error [mm]")
    else:
        moved = np.linalg.norm(positions - positions[0], axis=-1).mean(-1)
        axes.plot(time, moved * 1000, color=OBJECT)
        axes.set_ylabel("mean motion [mm]")
    axes.fill_between(
        time, 0, 1, where=contact, transform=axes.get_xaxis_transform(), color=GOAL, alpha=0.12, label="contact"
    )
    axes.set_xlabel("time [s]")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=7)
    figure.suptitle(title, fontsize=10)
    return figure


def loss_figure(step: np.ndarray, train: np.ndarray, validation: np.ndarray, title: str) -> Figure:
    """Training and validation loss over steps."""
    figure = Figure(figsize=(5.5, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.semilogy(step, train, color=OBJECT, label="training")
    if np.isfinite(validation).any():
        axes.semilogy(step, validation, color=GOAL, label="validation")
    axes.set(xlabel="step", ylabel="loss", title=title)
    axes.legend(fontsize=8)
    return figure


def error_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """PD, CD and S over the horizon for each model of `summarise`'s rows; bands are 95 % intervals."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    for axes, (metric, unit) in zip(figure.subplots(1, 3), (("pd", "cm"), ("cd", "cm"), ("s", "cm$^2$")), strict=True):
        for model in dict.fromkeys(row["model"] for row in rows):
            own = [row for row in rows if row["model"] == model]
            horizons = [row["horizon"] for row in own]
            mean, low, high = np.array([row[metric] for row in own]).T
            axes.plot(horizons, mean, marker=model_marker(model), color=model_color(model), label=model, ms=4)
            axes.fill_between(horizons, low, high, color=model_color(model), alpha=0.15, lw=0)
        axes.set(
            xlabel="strokes predicted", ylabel=f"{metric.upper()} [{unit}]", xticks=sorted({r["horizon"] for r in rows})
        )
        axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    windows = ", ".join(f"{row['windows']} at {row['horizon']}" for row in rows if row["model"] == rows[0]["model"])
    meaning = "PD particle distance, CD chamfer distance (two ways, summed), S shape error"
    figure.suptitle(f"Held-out sequences; windows: {windows}. {meaning}", fontsize=8)
    return figure


def plan_figure(steps: Sequence[dict[str, Any]], goal: np.ndarray, title: str) -> Figure:
    """A strip of one episode: state, stroke, prediction and goal [G, 3] at each step, then the state reached."""
    panels = len(steps) + 1
    columns = min(panels, 6)
    rows = -(-panels // columns)
    figure = Figure(figsize=(2.6 * columns, 2.9 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).reshape(-1)
    last = steps[-1]["after"] if np.isfinite(steps[-1]["after"]).all() else steps[-1]["predicted"]
    everything = [goal, last, *(s["before"] for s in steps)]
    for k, axes in enumerate(grid):
        if k >= panels:
            axes.axis("off")
            continue
        state = steps[k]["before"] if k < len(steps) else last
        axes.scatter(*goal[:, :2].T, s=16, color=GOAL, alpha=0.35, label="goal")
        axes.scatter(*state[:, :2].T, s=9, color=OBJECT, label="object")
        if k < len(steps):
            (x0, y0), (x1, y1) = steps[k]["stroke"]
            axes.scatter(*steps[k]["predicted"][:, :2].T, s=5, color=PREDICTED, label="predicted")
            axes.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "-|>", "color": "k", "lw": 1.5})
        axes.set_title(
            f"stroke {k + 1}" if k < len(steps) else "reached" if last is steps[-1]["after"] else "predicted",
            fontsize=9,
        )
        _top_view(axes, everything)
    grid[0].legend(fontsize=6)
    figure.suptitle(title, fontsize=10)
    return figure


def score_figure(scores: dict[str, np.ndarray]) -> Figure:
    """Distributions of named scores against the truth."""
    figure = Figure(figsize=(2.6 * len(scores), 3.2), layout="constrained")
    for axes, (name, values) in zip(figure.subplots(1, len(scores), squeeze=False)[0], scores.items(), strict=True):
        axes.boxplot(values, widths=0.6, showfliers=False)
        axes.set_title(name, fontsize=7, wrap=True)
        axes.set_xticks([])
        axes.set_ylim(bottom=0)
        axes.tick_params(labelsize=7)
    return figure


VERDICT_COLORS = {"good": "#d9f0d3", "doubtful": "#fee8a8", "bad": "#f4b6a6"}


def check_figure(checks: Sequence[dict[str, Any]], title: str) -> Figure:
    """Of each check of geometry and clocks the worst: cameras, what was found, verdict and cause.

    `checks` are rows with name, camera, verdict, text and cause, all text, and figure.
    """
    order = list(VERDICT_COLORS)
    worst: dict[str, dict[str, Any]] = {}
    for check in checks:
        rank = (order.index(check["verdict"]), abs(np.nan_to_num(check["figure"])))
        held = worst.get(check["name"])
        if held is None or rank > (order.index(held["verdict"]), abs(np.nan_to_num(held["figure"]))):
            worst[check["name"]] = check
    figure = Figure(figsize=(13.0, 0.6 + 0.34 * len(worst)), layout="constrained")
    axes = figure.add_subplot()
    axes.axis("off")
    axes.set_title(title, fontsize=10)
    rows = [
        [c["name"], c["camera"], c["verdict"], "; ".join(filter(None, (c["text"], c["cause"])))] for c in worst.values()
    ]
    table = axes.table(rows, colLabels=["check", "cameras", "verdict", "the worst of it"], cellLoc="left", loc="center")
    table.auto_set_font_size(False)
    table.set_fontsize(7)
    table.auto_set_column_width(range(4))
    for k, row in enumerate(rows, 1):
        table[k, 2].set_facecolor(VERDICT_COLORS[row[2]])
    return figure
