"""Benchmarks of the workspace: `status` and `run` where nothing has changed, on made-up runs; and reading artifacts."""

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from piegraph_cli.bench.measure import Row, median_seconds
from piegraph_cli.errors import DataError
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.artifact import read_artifact, write_artifact
from piegraph_cli.workspace.execute import Options, run_chain
from piegraph_cli.workspace.known import TICK
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.schema import SCHEMA_VERSION
from piegraph_cli.workspace.sealed import sealed
from piegraph_cli.workspace.stage import Stage
from piegraph_cli.workspace.survey import status

REPEATS = 3
READINGS = 9
CAMERAS = 4
ANY_KEY = "0" * 64

SIZES = {"1000 sequences": (1000, 2, 100), "10 GB recorded": (20, 125, 500_000)}
"""Sequences, frames of each, and bytes of an image."""


def workspace_rows(sizes: dict[str, tuple[int, int, int]] = SIZES) -> Iterator[Row]:
    """Seconds in this process, beside those with every file read again; and of the commands, from start to end.

    Before them those of artifacts that are read.
    """
    yield from reading_rows()
    for what, (sequences, frames, size) in sizes.items():
        with tempfile.TemporaryDirectory(prefix="piegraph") as folder:
            recording = make_recording(Path(folder) / "recording", sequences, frames, size)
            time.sleep(1.1 * TICK / 1e9)  # what changed just now is not kept
            run = make_run(Path(folder) / "run", recording)
            time.sleep(1.1 * TICK / 1e9)
            begin = time.perf_counter()
            _status(run, again=True)
            reference = time.perf_counter() - begin
            for name, work in (("status", _status), ("run", _run)):
                seconds = median_seconds(partial(work, run), REPEATS)
                yield Row("workspace", f"{name}, {what}", seconds, reference_seconds=reference)
            for command in ("status", "run"):
                seconds = median_seconds(partial(_process, command, run), 1)
                yield Row("workspace", f"piegraph {command}, {what}", seconds)


READ = {"50 tracks of 50 particles": ("tracks", 50, 36, 50), "clouds of 8,000 points": ("clouds", 1, 100, 8000)}
"""Artifact, how many, frames, and particles or points."""


def reading_rows(sizes: dict[str, tuple[str, int, int, int]] = READ) -> Iterator[Row]:
    """Seconds for artifacts that were not read before, all that is checked included, beside h5py alone."""
    for what, (name, count, frames, points) in sizes.items():
        with tempfile.TemporaryDirectory(prefix="piegraph") as folder:
            paths = [Path(folder) / f"{k}.h5" for k in range(count)]
            for k, path in enumerate(paths):
                arrays = _arrays(name, frames, points, np.random.default_rng(k))
                write_artifact(
                    path, name, arrays, stage="bench", stage_version=1, key="k", params={}, inputs={}, quality=""
                )
            times = [(_seconds(_plainly_read, paths), _seconds(read_artifact, paths)) for _ in range(READINGS)]
            plain, ours = (statistics.median(of) for of in zip(*times, strict=True))
            yield Row("workspace", f"read, {what}", ours, reference_seconds=plain)


def _arrays(name: str, frames: int, points: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """What an artifact of tracks or clouds holds."""
    places = rng.normal(0, 0.1, (frames, points, 3))
    found = {"end_effector": places[:, 0], "contact": np.ones(frames, bool), "time": np.arange(frames) / 10}
    if name == "clouds":
        return found | {"points": places.reshape(-1, 3), "offsets": np.arange(frames + 1) * points}
    alike = {"residual": np.zeros(frames), "visibility": np.ones((frames, points)), "mode": np.zeros(frames)}
    return found | {"positions": places} | alike


def _plainly_read(path: Path) -> list[Any]:
    with h5py.File(path, "r", locking=False) as file:
        return [dict(file.attrs), {name: dataset[()] for name, dataset in file.items()}]


def _seconds(read: Callable[[Path], Any], paths: list[Path]) -> float:
    begin = time.perf_counter()
    for path in paths:
        read(path)
    return time.perf_counter() - begin


def _status(run: Run, again: bool = False) -> None:
    run = Run(run.folder, run.recipe)
    if again:
        run.known.forget()
    _require_fresh(row["state"] == "fresh" for row in status(run))


def _run(run: Run) -> None:
    _require_fresh(outcome.state == "cached" for outcome in run_chain(run, None, Options()))


def _process(command: str, run: Run) -> None:
    subprocess.run(
        [sys.executable, "-m", "piegraph_cli", command, "--run", str(run.folder)], check=True, capture_output=True
    )


def _require_fresh(states: Iterator[bool]) -> None:
    found = list(states)
    if not found or not all(found):
        raise DataError(f"{found.count(False)} of {len(found)} artifacts are not fresh", "bench workspace")


def make_recording(folder: Path, sequences: int, frames: int, size: int) -> Path:
    """A recording folder of images that are `size` zeros each and take no room on the disk."""
    folder.mkdir(parents=True)
    (folder / "cameras.json").write_text("{}")
    for s in range(sequences):
        for c in range(CAMERAS):
            camera = folder / f"sequence_{s:04d}" / f"cam{c}"
            for kind, suffix in (("color", "jpg"), ("depth", "png")):
                (camera / kind).mkdir(parents=True)
                for f in range(frames):
                    with open(camera / kind / f"{f:06d}.{suffix}", "wb") as file:
                        file.truncate(size)
            (camera / "timestamps.txt").write_text("".join(f"{f / 5}\n" for f in range(frames)))
    return folder


def make_run(folder: Path, recording: Path) -> Run:
    """A run of that recording in which all is fresh: its artifacts have headers and no data, which nothing here reads."""
    run = Run(folder, Recipe(STAGES, {"ingest": {"recording": str(recording)}}))
    run.save_recipe()
    for stage in run.chain:
        for unit in run.units(stage):
            path = run.path(stage.writes, unit)
            path.parent.mkdir(exist_ok=True)
            image = _header(stage).replace(ANY_KEY.encode(), run.key(stage, unit).encode())
            path.write_bytes(b"".join(sealed(image)))
    return run


def _header(stage: Stage) -> bytes:
    """An artifact of a stage that has nothing but a header."""
    with h5py.File("header", "w", driver="core", backing_store=False) as file:
        texts = {"artifact": stage.writes, "key": ANY_KEY, "stage": stage.name, "params": "{}", "inputs": "{}"}
        file.attrs.update(texts | {"quality": "made up", "schema_version": SCHEMA_VERSION})
        file.attrs["stage_version"] = stage.version
        file.flush()
        return file.id.get_file_image()
