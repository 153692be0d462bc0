"""The pictures of a run: overlays, cloud, tracks, losses, errors, plan and an animation, in RUN/report."""

import json
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError, command_line
from piegraph_cli.evaluation import figures, overlays, trial_figures
from piegraph_cli.evaluation.tables import score_values, summarise
from piegraph_cli.evaluation.trials import compare_trials
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.stages import STAGES, open_run, sequences
from piegraph_cli.stages.evaluate import read_metrics
from piegraph_cli.stages.images import cameras_of, color_of
from piegraph_cli.stages.trials import read_trials
from piegraph_cli.workspace.artifact import Artifact, read_artifact, read_key
from piegraph_cli.workspace.run import Run

SEQUENCES = 4
"""Pictures of single sequences are drawn of this many."""

VERSION = 3
"""Raised when pictures look different, so that they are drawn anew."""

log = logging.getLogger("piegraph")


def draw_report(folder: Path) -> list[Path]:
    """Draw what the run has artifacts for; returns the files. Pictures whose artifacts have not changed are kept.

    Raises `DataError` when there is nothing to draw.
    """
    run, out = open_run(folder), folder / "report"
    drawn, index = _read_index(out), {}
    for group, sequence, artifacts, draw in _groups(run):
        keys = {f"{name} {unit}": key for name, unit in artifacts if (key := read_key(run.path(name, unit), name))}
        stamp = f"{VERSION} {sorted(keys.items())}"
        kept = drawn.get(group, {})
        if kept.get("stamp") == stamp and all((out / name).is_file() for name in kept["files"]):
            index[group] = kept
        elif keys:
            index[group] = {
                "stamp": stamp,
                "files": [_save(out / name, picture) for name, picture in draw(run, sequence)],
            }
    files = [out / name for entry in index.values() for name in entry["files"]]
    if not files:
        raise DataError("nothing to draw yet", str(folder), command_line("run", "RECIPE", "--run", folder))
    with atomic_file(out / "index.json") as temporary:
        temporary.write_text(json.dumps(index, indent=1))
    return files


def _read_index(out: Path) -> dict[str, dict[str, Any]]:
    try:
        return json.loads((out / "index.json").read_text())
    except (OSError, ValueError):
        return {}


Group = tuple[str, str | None, list[tuple[str, str | None]], Callable[..., Iterator[tuple[str, Any]]]]


def _groups(run: Run) -> Iterator[Group]:
    """Groups of pictures: name, sequence, the (artifact, unit) files they show, and what draws them."""
    for sequence in sequences(run)[:SEQUENCES]:
        names = ("frames", "hands", "masks", "clouds", "tracks", "scores")
        yield sequence, sequence, [(name, sequence) for name in names], _sequence_pictures
    chain = run.chain
    if STAGES["train"] in chain:
        for unit in run.units(STAGES["train"]):
            yield f"model {unit}", unit, [("model", unit)], _model_pictures
        read = [("metrics", unit) for unit in run.units(STAGES["evaluate"])]
        read += [("scores", name) for name in run.made("scores")]
        yield "metrics", None, read, _metrics_pictures
    yield "plan", None, [("plan", None)], _plan_pictures
    trials = STAGES["trials"]
    if trials in chain:
        yield "trials", None, [("trials", unit) for unit in run.units(trials)], _trial_pictures


def _model_pictures(run: Run, unit: str) -> Iterator[tuple[str, Any]]:
    model = _read(run, "model", unit)
    if model is not None:
        picture = figures.loss_figure(model["step"], model["train_loss"], model["validation_loss"], f"Training {unit}")
        yield f"training_{unit}.png", picture


def _metrics_pictures(run: Run, _: None) -> Iterator[tuple[str, Any]]:
    metrics, scores = read_metrics(run)
    if metrics:
        arrays = {model: [one.arrays for one in seeds] for model, seeds in metrics.items()}
        yield "errors.png", figures.error_figure(summarise(arrays))
    values = score_values([one.arrays for one in scores])
    if values:
        yield "scores.png", figures.score_figure(values)


def _plan_pictures(run: Run, _: None) -> Iterator[tuple[str, Any]]:
    plan = _read(run, "plan", None)
    if plan is not None:
        for episode in np.unique(plan["episode"])[:3]:
            yield f"plan_{episode}.png", _plan_picture(plan, int(episode))


def _trial_pictures(run: Run, _: None) -> Iterator[tuple[str, Any]]:
    params = run.params("trials")
    trials, limits = read_trials(run), params.thresholds
    if trials:
        compared = compare_trials(trials, limits)
        yield "trials.png", trial_figures.box_figure(trials, compared, min(limits), params.strokes)
        yield "trials_success.png", trial_figures.success_figure(trials, limits, params.strokes)
        yield "trials_distance.png", trial_figures.distance_figure(trials, params.strokes)


def _sequence_pictures(run: Run, sequence: str) -> Iterator[tuple[str, Any]]:
    got = {name: _read(run, name, sequence) for name in ("frames", "hands", "masks", "clouds", "tracks", "scores")}
    frames, tracks, clouds = got["frames"], got["tracks"], got["clouds"]
    if frames is not None:
        yield f"{sequence}_checks.png", figures.check_figure(_checks(frames), f"{sequence}: checks")
    contact = next((a["contact"] for a in (tracks, clouds) if a is not None), None)
    if contact is None:
        return
    shown = _moments(contact)
    if frames is not None and got["masks"] is not None and got["hands"] is not None:
        yield f"{sequence}_masks.png", _mask_sheet(frames, got["masks"], got["hands"], shown)
    if clouds is not None:
        sets = np.split(clouds["points"], clouds["offsets"][1:-1])
        seen = [f for f in shown if len(sets[f])]
        times = [clouds["time"][f] for f in seen]
        yield f"{sequence}_cloud.png", figures.cloud_figure([sets[f] for f in seen], times, f"{sequence}: fused cloud")
    if tracks is None:
        return
    true = None
    if frames is not None:
        if got["scores"] is not None and len(got["scores"]["true_positions"]):
            true = got["scores"]["true_positions"]
        yield f"{sequence}.webp", _animation(frames, tracks)
    hand = tracks["end_effector"]
    title = f"{sequence}: tracked particles" + (" over true ones" if true is not None else "")
    yield (
        f"{sequence}_tracks.png",
        figures.track_figure(tracks["positions"], true, shown, tracks["time"], hand, contact, title),
    )


def _checks(frames: Artifact) -> list[dict[str, Any]]:
    texts = {name: frames.texts(f"check_{name}") for name in ("name", "camera", "verdict", "text", "cause")}
    texts["figure"] = frames["check_figure"].tolist()
    return [dict(zip(texts, row, strict=True)) for row in zip(*texts.values(), strict=True)]


def _moments(contact: np.ndarray, count: int = 4) -> list[int]:
    """Frames to show: the first, and the ends of the first contacts."""
    ends = np.flatnonzero(contact & ~np.append(contact[1:], False))
    return sorted({0, *ends[: count - 1].tolist()})


def _read(run: Run, artifact: str, sequence: str | None) -> Artifact | None:
    path = run.path(artifact, sequence)
    if not path.exists():
        return None
    try:
        return read_artifact(path, artifact)
    except DataError as error:
        log.warning("left out of the report: %s", error)
        return None


def _mask_sheet(frames: Artifact, masks: Artifact, hands: Artifact, shown: list[int]) -> np.ndarray:
    cameras, color = cameras_of(frames), color_of(frames)
    mask = ImageStack(masks["mask"], masks["mask_offsets"], len(cameras), "mask")
    rows = []
    for f in shown:
        row = []
        for c, camera in enumerate(cameras):
            image = overlays.draw_mask(color.color(f, c), mask.mask(f, c))
            image = overlays.draw_hand(image, hands["landmarks"][f, c], bool(hands["seen"][f, c]))
            row.append(overlays.label(image, f"{camera.name}  t = {frames['time'][f]:.1f} s"))
        rows.append(row)
    return overlays.tile(rows)


def _animation(frames: Artifact, tracks: Artifact) -> list[np.ndarray]:
    """The tracked particles over the pictures of all cameras (two rows), frame by frame."""
    cameras, color = cameras_of(frames), color_of(frames)
    colors = (figures.particle_colors(tracks["positions"][0]) * 255).astype(np.uint8)
    shown = []
    for f in range(len(frames["time"])):
        images = [
            overlays.draw_particles(color.color(f, c), tracks["positions"][f], camera, colors)
            for c, camera in enumerate(cameras[:2])
        ]
        shown.append(overlays.label(overlays.tile([images]), f"t = {frames['time'][f]:.1f} s"))
    return shown


def _plan_picture(plan: Artifact, episode: int) -> Any:
    names = ("before", "after", "predicted", "stroke")
    steps = [{name: plan[name][k] for name in names} for k in np.flatnonzero(plan["episode"] == episode)]
    start, end = plan["start_distance"][episode] * 100, plan["end_distance"][episode] * 100
    ending = f"{end:.1f} cm after {len(steps)} strokes" if np.isfinite(end) else f"{len(steps)} strokes planned"
    return figures.plan_figure(steps, plan["goal"][episode], f"Plan {episode}: {start:.1f} cm from the goal, {ending}")


def _save(path: Path, picture: Any) -> str:
    """Save a figure or an RGB image as PNG, a list of images as an animated WebP, small and in all colours; its name."""
    from PIL import Image

    with atomic_file(path) as temporary:
        if isinstance(picture, list):
            images = [Image.fromarray(image) for image in picture]
            images[0].save(
                temporary, "WEBP", save_all=True, append_images=images[1:], duration=200, quality=70, method=2
            )
        elif isinstance(picture, np.ndarray):
            Image.fromarray(picture).save(temporary, "PNG")
        else:
            picture.savefig(temporary, format="png", dpi=110)
    return path.name
