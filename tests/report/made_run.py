"""A run made up in a second: a recording of two cameras, and artifacts as the stages would write them, with their keys."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.recording.images import encode_masks, join_images
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.artifact import write_artifact
from piegraph_cli.workspace.run import Run
from tests.perception.scene import ring_camera

FRAMES, PARTICLES = 8, 12
CAMERAS = [ring_camera(0.4, "front", 64, 48), ring_camera(2.5, "le<ft>", 64, 48)]
CHECKS = ("name", "camera", "unit", "verdict", "text", "cause", "remedy")
GOOD = ("table", "front", "mm", "good", "table 0.1 mm above z = 0", "", "")
MODELS = ("piegraph.seed0", "piegraph-ng.seed0", "kabsch.seed0", "static")


def recording(folder: Path, names: list[str]) -> Path:
    """A recording whose sequences have one frame each: what was made of it is made up."""
    folder.mkdir()
    write_cameras(folder, CAMERAS)
    for name in names:
        for camera in CAMERAS:
            write_frame(
                folder / name, camera, 0, np.full((48, 64, 3), 90, np.uint8), np.full((48, 64), 700, np.uint16), 90
            )
            write_times(folder / name, camera, np.zeros(1))
    return folder


def empty_run(folder: Path, names: list[str], **sections: Mapping[str, Any]) -> Run:
    """A run of such a recording of which nothing is made yet."""
    place = recording(folder.parent / f"{folder.name} recording", names)
    run = open_run(folder)
    given = {"ingest": {"recording": str(place)}, "dataset": {"train": 1}, "evaluate": {"horizons": [1, 2]}} | sections
    for stage, values in given.items():
        run.recipe = run.recipe.with_values(STAGES[stage], values, "test", folder)
    folder.mkdir()
    run.save_recipe()
    return open_run(folder)


def put(run: Run, stage: str, unit: str | None, arrays: Mapping[str, Any], quality: str = "as made up") -> None:
    """An artifact that is fresh."""
    of = STAGES[stage]
    write_artifact(
        run.path(of.writes, unit),
        of.writes,
        {name: np.asarray(value) for name, value in arrays.items()},
        stage=stage,
        stage_version=of.version,
        key=run.key(of, unit),
        params=run.settings(of, unit).content(),
        inputs={f"{name}/{u}" if u else name: run.key(run.maker(name), u) for name, u in run.files(of, unit)},
        quality=quality,
    )


def made_run(folder: Path, names: list[str], until: str = "plan", **sections: Mapping[str, Any]) -> Run:
    """The same with all that the stages make, up to one of them."""
    run = empty_run(folder, names, **{"plan": {"env": "tblock"}} | sections)
    for stage in ("ingest", "hands", "segment", "fuse", "track", "score"):
        for k, name in enumerate(names):
            put(run, stage, name, SEQUENCE[stage](k))
        if stage == until:
            return run
    run = open_run(folder)
    for stage, make in WHOLE.items():
        for unit in run.units(STAGES[stage]):
            put(run, stage, unit, make(names, unit))
        if stage == until:
            break
    return open_run(folder)


def positions(k: int) -> np.ndarray:
    """Particles [F, N, 3] (m) that go along x."""
    first = np.random.default_rng(k).uniform(-0.05, 0.05, (PARTICLES, 3)) * [1, 1, 0] + [0, 0, 0.02]
    return first + np.arange(FRAMES)[:, None, None] * np.array([0.01, 0, 0])


TIME = np.arange(FRAMES) / 5
CONTACT = np.isin(np.arange(FRAMES), (2, 3, 4))
HAND = {"end_effector": positions(0)[:, 0], "contact": CONTACT, "time": TIME}


def frames(k: int, *checks: tuple[str, ...]) -> dict[str, Any]:
    """Grey images of two cameras, and checks: one that is good, by default."""
    import cv2

    image = cv2.imencode(".jpg", np.full((48, 64, 3), 60 + 40 * (k % 4), np.uint8))[1].tobytes()
    depth = cv2.imencode(".png", np.full((48, 64), 700, np.uint16))[1].tobytes()
    color, depths = join_images([image] * 2 * FRAMES), join_images([depth] * 2 * FRAMES)
    rows = list(zip(*(checks or (GOOD,)), strict=True))
    return {
        **dict(zip(("color", "color_offsets", "depth", "depth_offsets"), (*color, *depths), strict=True)),
        "time": TIME,
        "stamp": np.stack([TIME, TIME], 1),
        "source_frame": np.stack([np.arange(FRAMES)] * 2, 1),
        "camera_name": [camera.name for camera in CAMERAS],
        "image_size": [(64, 48)] * 2,
        **{name: [getattr(c, name) for c in CAMERAS] for name in ("K", "distortion", "depth_scale", "T_world_camera")},
        **{f"check_{column}": row for column, row in zip(CHECKS, rows, strict=True)},
        "check_figure": np.full(len(rows[0]), 0.5),
        "check_threshold": np.full(len(rows[0]), 4.0),
    }


def _masks(k: int) -> dict[str, Any]:
    mask = np.zeros((48, 64), bool)
    mask[20:30, 20:40] = True
    data, offsets = encode_masks([mask] * 2 * FRAMES)
    return {"mask": data, "mask_offsets": offsets, "area": np.full((FRAMES, 2), mask.sum()), "time": TIME}


def _tracks(k: int) -> dict[str, Any]:
    small = np.full(FRAMES, 0.001)
    return HAND | {
        "positions": positions(k),
        "residual": small,
        "visibility": np.ones((FRAMES, PARTICLES)),
        "trust/doubt": small * 2,
        "trust/misfit": small,
        "mode": np.zeros(FRAMES),
    }


SEQUENCE: dict[str, Any] = {
    "ingest": frames,
    "hands": lambda k: {
        "landmarks": np.random.default_rng(k).uniform(10, 40, (FRAMES, 2, 21, 2)),
        "seen": np.ones((FRAMES, 2), bool),
        "keypoints": np.zeros((FRAMES, 21, 3)),
        "end_effector": HAND["end_effector"],
        "observed": np.arange(FRAMES) > 0,
        "time": TIME,
    },
    "segment": _masks,
    "fuse": lambda k: HAND | {"points": positions(k).reshape(-1, 3), "offsets": np.arange(FRAMES + 1) * PARTICLES},
    "track": _tracks,
    "score": lambda k: {
        "score_name": ["tracked particles at stroke ends [mm]", "object mask IoU"],
        "score_value": [1.5, 0.97],
        "true_positions": positions(k) + 0.0015,
    },
}


def metrics(names: list[str], unit: str | None) -> dict[str, Any]:
    """Errors of a model on all sequences but the first: `static` is 3 cm off, others 1 cm."""
    held = names[1:] or names
    far = 3.0 if unit == "static" else 1.0
    rows = [
        (h, name, 0, far, far / 2, far * h + 0.1 * k, np.nan, h * moved, 0.0)
        for k, name in enumerate(held)
        for h in (1, 2)
        for moved in [0.0 if unit == "static" else 4 + 0.1 * k]
    ]
    columns = ("horizon", "sequence", "first_stroke", "cd", "s", "pd", "pd_truth", "motion", "correction")
    return dict(zip(columns, zip(*rows, strict=True), strict=True))


def _dataset(names: list[str], unit: str | None) -> dict[str, Any]:
    count = len(names)
    starts = np.arange(count) * FRAMES
    return {
        "positions": np.concatenate([positions(k) for k in range(count)]),
        "seen": np.ones((count * FRAMES, PARTICLES), bool),
        "end_effector": np.zeros((count * FRAMES, 2)),
        "strokes": np.stack([starts + 1, starts + 4], 1),
        "stroke_sequence": np.arange(count),
        "stroke_mode": np.zeros(count),
        "stroke_follows": np.zeros(count, bool),
        "pairs": np.stack([starts + 1, starts + 4], 1),
        "pair_stroke": np.arange(count),
        "sequence_name": names,
        "sequence_start": starts,
        "sequence_split": [0] + [2] * (count - 1),
    }


def _plan(names: list[str], unit: str | None) -> dict[str, Any]:
    state = positions(0)[:1].astype(np.float32)
    return {
        "goal": state + 0.05,
        "metric": ["distance"],
        "episode": [0],
        "stroke": [[[0.0, 0.0], [0.1, 0.0]]],
        "mode": [0],
        "before": state,
        "predicted": state + 0.04,
        "after": state + 0.045,
        "cost": [0.012],
        "expected_error": [0.004],
        "distance": [0.009],
        "blocked": [False],
        "seconds": [0.1],
        "candidate_stroke": np.zeros((1, 1, 1, 1, 2, 2)),
        "candidate_mode": np.zeros((1, 1, 1, 1)),
        "candidate_cost": np.zeros((1, 1, 1)),
        "candidate_weight": np.zeros((1, 1, 1)),
        "path": np.zeros((1, 2, 3)),
        "path_time": [[0.0, 1.0]],
        "path_closed": [[False, False]],
        "seed": [0],
        "start_distance": [0.08],
        "end_distance": [0.009],
        "ending": ["reached"],
    }


WHOLE: dict[str, Any] = {
    "dataset": _dataset,
    "train": lambda names, unit: {
        "weights/w": np.zeros(3),
        "particles": PARTICLES,
        "modes": [0],
        "pace": 0.01,
        "rest": positions(0)[0],
        "size": [[0.1] * 4, [0.2] * 4],
        "step": [1, 2, 3],
        "train_loss": [0.3, 0.2, 0.1],
        "validation_loss": [np.nan] * 3,
    },
    "evaluate": metrics,
    "plan": _plan,
}
