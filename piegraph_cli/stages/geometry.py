"""The checks of geometry in `ingest`: which frames they look at, what is refused, and how they are kept and told."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.checks import Check, Finding, grouped
from piegraph_cli.recording.clocks import changes, check_clocks, moving
from piegraph_cli.recording.geometry import View, check_geometry
from piegraph_cli.recording.ground import upright
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.recording.lag import busiest, check_lags, moving_in_depth
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.tip import check_tip
from piegraph_cli.stages.images import cameras_of, color_of, depth_of
from piegraph_cli.workspace.artifact import Artifact

EMPTY_FRAMES = 5
"""So many frames without depth are passed over at either end."""


def check_frames(
    arrays: dict[str, np.ndarray], params: ReadParams, folder: Path
) -> tuple[dict[str, np.ndarray], str, list[str]]:
    """The checks of a sequence's frames: as datasets, in a word or two, and as warnings.

    Raises `DataError` with the cameras, figures and causes where one is bad and not among those to accept.
    """
    seen = views_of(arrays, folder)
    views = [replace(view, camera=upright(view.camera, params.table)) for view in seen]
    checks = check_geometry(views, np.array(params.workspace).reshape(3, 2), params.table[0])
    checks += _check_clocks(arrays)
    bad = [f for f in grouped([c for c in checks if c.verdict == "bad"]) if f.name not in params.accept]
    if bad:
        raise _refused(bad, folder)
    found = grouped(checks)
    warnings = [f"geometry: {f.text}" + (f"\n  try: {f.remedy}" if f.remedy else "") for f in found]
    warnings += _check_tip(arrays, folder)
    word = "; ".join(f"{f.checks[0].verdict}: {f.name} of {', '.join(f.cameras)}" for f in found) or "good"
    return _datasets(checks), word, warnings


def _check_tip(arrays: dict[str, np.ndarray], folder: Path) -> list[str]:
    if "end_effector" not in arrays:
        return []
    frames = _frames(arrays, folder)
    cameras, depth = cameras_of(frames), depth_of(frames)
    images = [depth.of_camera(c, "depth") for c in range(len(cameras))]
    return check_tip(arrays["end_effector"], arrays["time"], cameras, images)


def _frames(arrays: dict[str, np.ndarray], folder: Path) -> Artifact:
    return Artifact(folder, "frames", "", {}, {}, "", arrays | {"camera_name": np.char.encode(arrays["camera_name"])})


def views_of(arrays: dict[str, np.ndarray], folder: Path) -> list[View]:
    """What the checks look at: a few frames of each camera."""
    frames = _frames(arrays, folder)
    color, depth = color_of(frames), depth_of(frames)
    chosen = _chosen(depth)
    return [
        View(camera, [depth.depth(f, c) for f in chosen], [color.color(f, c) for f in chosen])
        for c, camera in enumerate(cameras_of(frames))
    ]


def _check_clocks(arrays: dict[str, np.ndarray]) -> list[Check]:
    """Cameras against each other, and each one's depth against its colour."""
    names = [str(name) for name in arrays["camera_name"]]
    color = ImageStack(arrays["color"], arrays["color_offsets"], len(names), "colour")
    depth = ImageStack(arrays["depth"], arrays["depth_offsets"], len(names), "depth")
    seen, times, looked = [], [], []
    for c, of_camera in enumerate(arrays["source_frame"].T):
        kept = np.flatnonzero(of_camera >= 0)
        moved = moving(color.grey(int(frame), c) for frame in kept)
        seen.append(changes(moved))
        times.append(arrays["stamp"][kept, c])
        at = busiest(seen[-1])
        measured = moving_in_depth((depth.depth(int(f), c) for f in kept[at]), float(arrays["depth_scale"][c]))
        looked.append((moved[at], measured, times[-1][at]))
    return check_clocks(names, seen, times) + check_lags(names, *zip(*looked, strict=True))


def _chosen(depth: ImageStack) -> list[int]:
    """The first and the last frame in which all cameras have depth, and two such between."""
    every = list(range(len(depth)))

    def seen(frame: int) -> bool:
        return all(depth.depth(frame, c).any() for c in range(depth.cameras))

    first = next((f for f in every[:EMPTY_FRAMES] if seen(f)), 0)
    last = next((f for f in every[: -EMPTY_FRAMES - 1 : -1] if seen(f)), every[-1])
    between = [first + (last - first) // 3, first + 2 * (last - first) // 3]
    found = [next((f for f in every[wanted : last + 1] if seen(f)), wanted) for wanted in between]
    return sorted({first, *found, last})


def _refused(bad: Sequence[Finding], folder: Path) -> DataError:
    """The error that names file, cameras, figures and causes, and what to do."""
    files = (folder / "cameras.json", folder.parent / "cameras.json")
    where = next((str(path) for path in files if path.is_file()), str(folder))
    remedies = list(dict.fromkeys(f.remedy for f in bad if f.remedy))
    names = ",".join(dict.fromkeys(f.name for f in bad))
    hint = "; ".join([*remedies, f"or take it as it is: ingest.accept = {names}"])
    return DataError("the geometry is wrong: " + "; ".join(f.text for f in bad), where, hint)


def _datasets(checks: Sequence[Check]) -> dict[str, np.ndarray]:
    columns = {
        "name": [c.name for c in checks],
        "camera": [", ".join(c.cameras) for c in checks],
        "unit": [c.unit for c in checks],
        "verdict": [c.verdict for c in checks],
        "text": [c.text for c in checks],
        "cause": [c.cause for c in checks],
        "remedy": [c.remedy for c in checks],
    }
    numbers = {"figure": [c.figure for c in checks], "threshold": [c.threshold for c in checks]}
    texts = {f"check_{name}": np.array(column, dtype=str) for name, column in columns.items()}
    return texts | {f"check_{name}": np.array(column, float) for name, column in numbers.items()}
