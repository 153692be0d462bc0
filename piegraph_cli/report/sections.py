"""The parts of a report, each with its pictures and rows: a sequence, the model, the plan, the trials."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation import figures, trial_figures
from piegraph_cli.evaluation.reliability import reliability
from piegraph_cli.evaluation.tables import Metrics, summarise
from piegraph_cli.evaluation.trials import Trial, compare_trials
from piegraph_cli.report import tables
from piegraph_cli.report.drawn import Drawn
from piegraph_cli.report.found import Found
from piegraph_cli.report.pictures import Picture, image_picture, share_of, shrink
from piegraph_cli.report.sequence import FRAMES, Seen, draw_sequence
from piegraph_cli.report.svg import svg_of
from piegraph_cli.report.words import Part, worst
from piegraph_cli.stages.plan import HELPLESS
from piegraph_cli.stages.train import split_model
from piegraph_cli.text import counted
from piegraph_cli.workspace.artifact import Artifact

PLANS = 12
"""Episodes of a plan that are drawn; the table has all."""
PICTURE_WIDTH = 1600
ERRORS = {
    "pd": "Particle distance (PD) over the strokes predicted in a row",
    "cd": "Chamfer distance (CD, both ways summed)",
    "s": "Shape error (S)",
}


def _keys(found: Found, *slots: tuple[str, str | None]) -> list[str]:
    """The keys of what is fresh of these artifacts."""
    headers = [(f"{artifact} {unit}", found.header(artifact, unit)) for artifact, unit in slots]
    return [f"{name} {header.key}" for name, header in headers if header is not None]


def sequence_section(found: Found, name: str, parts: dict[str, Part], drawn: Drawn) -> dict[str, Any]:
    """One sequence: its words, its figures, and its pictures in its share of the page."""
    artifacts = ("frames", "hands", "masks", "clouds", "tracks", "scores")
    share = share_of(len(found.sequences))
    told = found.run.folder / "report" / f"{name}_object.png" if found.warnings.get(("segment", name)) else None
    when = told.stat().st_mtime_ns if told and told.is_file() else 0

    def draw(mark: str) -> list[Picture]:
        of = {a: found.read(a, name, FRAMES if a == "frames" else None) for a in artifacts}
        pictures = draw_sequence(Seen(name, **of), share, mark)
        return pictures + ([_choice(told, name)] if told and when else [])

    keys = _keys(found, *((a, name) for a in artifacts))
    try:
        pictures = drawn.take(f"sequence {name}", (share, when, *keys), draw) if keys else []
    except DataError as error:  # images that cannot be decoded
        pictures, parts = [], parts | {"pictures": Part("bad", error.message, todo=[str(error)], made=False)}
    todo = list(dict.fromkeys(text for part in parts.values() for text in part.todo))
    return {
        "name": name,
        "parts": parts,
        "word": worst(p.word for p in parts.values()),
        "pictures": pictures,
        "todo": todo,
    }


def _choice(path: Path, name: str) -> Picture:
    """What `segment` took for the object, where it was in doubt."""
    from PIL import Image

    with Image.open(path) as image:
        pixels = shrink(np.asarray(image.convert("RGB")), PICTURE_WIDTH)
    return image_picture(
        pixels, f"{name}: what was taken for the object (1), and what else lies there", "What was taken (1)"
    )


def model_section(found: Found, metrics: dict[str, list[Artifact]], arrays: Metrics, drawn: Drawn) -> dict[str, Any]:
    """Errors of predictions and losses of trainings, as plots and rows."""
    rows, keys = summarise(arrays), [one.key for seeds in metrics.values() for one in seeds]

    def errors(mark: str) -> list[Picture]:
        return [_plot(partial(figures.error_figure, rows, name), mark + name, said) for name, said in ERRORS.items()]

    units = [unit for unit in found.units("train", "fresh") if unit]
    by_label: dict[str, list[str]] = {}
    for unit in units:
        by_label.setdefault(split_model(unit)[0], []).append(unit)
    sure = reliability(arrays)

    def agreement(mark: str) -> list[Picture]:
        first = min(row["horizon"] for row in sure)
        own = [row for row in sure if row["horizon"] == first]
        said = f"Real over expected errors, {counted(first, 'stroke')} ahead; calibrated on other sequences"
        return [_plot(partial(figures.reliability_figure, own), mark, said)]

    return {
        "rows": tables.metric_rows(arrays),
        "sure": [tables.look_of(row["model"]) | row for row in sure],
        "agreement": drawn.take("reliability", keys, agreement) if sure else [],
        "looks": [tables.look_of(label) for label in metrics],
        "errors": drawn.take("errors", keys, errors) if metrics else [],
        "losses": [one for label, own in by_label.items() for one in _losses(found, label, own, drawn)],
        "trained": [(unit, found.rows["train", unit]["quality"]) for unit in units],
        "dataset": found.rows["dataset", None]["quality"] if found.has("dataset") else "",
    }


def _losses(found: Found, label: str, units: list[str], drawn: Drawn) -> list[Picture]:
    """The losses of one model over its training, from each of its seeds; none where it is fitted at once."""

    def draw(mark: str) -> list[Picture]:
        read = [found.read("model", unit, ("step", "train_loss", "validation_loss")) for unit in units]
        curves = [(a["step"], a["train_loss"], a["validation_loss"]) for a in read if a and len(a["step"]) > 1]
        said = f"Loss of {label} over training steps, {counted(len(curves), 'seed')}"
        return [_plot(partial(figures.loss_figure, curves, label), mark, said)] if curves else []

    return drawn.take(f"losses {label}", _keys(found, *(("model", unit) for unit in units)), draw)


def _plot(draw: Callable[[], Figure], mark: str, caption: str, alt: str = "") -> Picture:
    return Picture("plot", svg_of(draw, mark, alt or caption), alt or caption, caption)


def plan_section(found: Found, drawn: Drawn) -> dict[str, Any] | None:
    """The plan's episodes as strips, and a row per stroke."""
    plan = found.plan[0]
    if plan is None:
        return None
    episodes = np.unique(plan["episode"]).tolist()

    def strips(mark: str) -> list[Picture]:
        return [_strip(plan, episode, f"{mark}e{episode}") for episode in episodes[:PLANS]]

    pictures = drawn.take("plan", [plan.key], strips)
    asked = {name: plan.params.get(name) for name in ("env", "state", "goal", "goal_pose", "model")}
    return {
        "pictures": pictures,
        "left": len(episodes) - len(pictures),
        "rows": tables.plan_rows(plan),
        "quality": plan.quality,
        "about": {name: value for name, value in asked.items() if value is not None},
        "command": tables.plan_command(found, plan),
    }


def _strip(plan: Artifact, episode: int, mark: str) -> Picture:
    names = ("before", "after", "predicted", "stroke")
    steps = [{name: plan[name][k] for name in names} for k in np.flatnonzero(plan["episode"] == episode)]
    start, end = plan["start_distance"][episode] * 100, plan["end_distance"][episode] * 100
    strokes = counted(len(steps), "stroke")
    ending = f"{end:.1f} cm after {strokes}" if np.isfinite(end) else f"{strokes} planned"
    why = plan.texts("ending")[episode]
    ending += f", {why}" if why == HELPLESS else ""
    caption = f"Episode {episode}: {start:.1f} cm from the goal, {ending}"
    alt = f"{caption}; object, stroke, prediction and goal from above at each stroke"
    return _plot(partial(figures.plan_figure, steps, plan["goal"][episode]), mark, caption, alt)


def trials_section(found: Found, trials: list[Trial], drawn: Drawn) -> dict[str, Any] | None:
    """Trials per environment as plots, and their tables."""
    if not trials:
        return None
    params = found.run.params("trials")
    limits, strokes = params.thresholds, params.strokes
    keys = [f"{unit} {found.run.key(found.run.maker('trials'), unit)}" for unit in found.units("trials", "fresh")]

    def plots(mark: str) -> list[Picture]:
        pictures = []
        for k, environment in enumerate(dict.fromkeys(t.environment for t in trials)):
            own = [t for t in trials if t.environment == environment]
            kinds = {
                "final distance, and strokes to the goal": partial(
                    trial_figures.box_figure, own, compare_trials(own, limits), min(limits), strokes
                ),
                "share of trials solved, over the threshold": partial(
                    trial_figures.success_figure, own, limits, strokes
                ),
                "distance from the goal over strokes": partial(trial_figures.distance_figure, own, strokes),
            }
            for n, (what, draw) in enumerate(kinds.items()):
                pictures.append(_plot(draw, f"{mark}{k}{'abc'[n]}", f"{environment}: {what}"))
        return pictures

    pictures = drawn.take("trials", keys, plots)
    looks = [tables.look_of(label) for label in dict.fromkeys(t.model for t in trials)]
    return {"pictures": pictures, "looks": looks, "strokes": strokes} | tables.trial_tables(trials, limits)
