"""The pictures of a run: overlays, cloud, tracks, losses, errors, plan and an animation, in RUN/report."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation import figures, overlays
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.stages.evaluate import summarise
from piegraph_cli.stages.ingest import cameras_of, color_of
from piegraph_cli.stages.scores import true_positions
from piegraph_cli.workspace.artifact import Artifact, atomic_file, read_artifact
from piegraph_cli.workspace.run import Run

SEQUENCES = 4
"""Pictures of single sequences are drawn of this many."""

log = logging.getLogger("piegraph")


def draw_report(folder: Path) -> list[Path]:
    """Draw what the run has fresh or stale artifacts for; returns the files. Raises `DataError` when there is nothing."""
    run = Run.open(folder)
    out = folder / "report"
    files = []
    for name, picture in _pictures(run):
        path = out / name
        _save(path, picture)
        files.append(path)
    if not files:
        raise DataError("nothing to draw yet", str(folder), f"piegraph run RECIPE --run {folder}")
    return files


def _pictures(run: Run) -> Iterator[tuple[str, Any]]:
    for sequence in run.sequences[:SEQUENCES]:
        yield from _sequence_pictures(run, sequence)
    model = _read(run, "model", None)
    if model is not None:
        yield "training.png", figures.loss_figure(model["step"], model["train_loss"], model["validation_loss"])
    metrics = _read(run, "metrics", None)
    if metrics is not None:
        yield "errors.png", figures.error_figure(summarise(metrics.arrays))
        if len(metrics["score_name"]):
            yield "scores.png", figures.score_figure(metrics.arrays)
    plan = _read(run, "plan", None)
    if plan is not None:
        for episode in np.unique(plan["episode"])[:3]:
            yield f"plan_{episode}.png", _plan_picture(plan, int(episode))


def _sequence_pictures(run: Run, sequence: str) -> Iterator[tuple[str, Any]]:
    got = {name: _read(run, name, sequence) for name in ("frames", "hands", "masks", "clouds", "tracks")}
    frames, tracks, clouds = got["frames"], got["tracks"], got["clouds"]
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
        true = true_positions({"frames": {sequence: frames}, "tracks": {sequence: tracks}}, sequence, run)
        yield f"{sequence}.webp", _animation(frames, tracks)
    hand = tracks["end_effector"]
    title = f"{sequence}: tracked particles" + (" over true ones" if true is not None else "")
    yield (
        f"{sequence}_tracks.png",
        figures.track_figure(tracks["positions"], true, shown, tracks["time"], hand, contact, title),
    )


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


def _save(path: Path, picture: Any) -> None:
    """A figure or an RGB image as PNG, a list of images as an animated WebP (small, all colours; browsers show it)."""
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
