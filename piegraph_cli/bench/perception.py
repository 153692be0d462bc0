"""Benchmark of perception: what a frame of all cameras costs from images to tracks, beside another commit's."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from piegraph_cli.bench.measure import Row
from piegraph_cli.errors import DataError, UsageError, command_line
from piegraph_cli.stages import STAGES, open_run, sequences
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.run import Run

TIMED = ("hands", "segment", "fuse", "track")
OWN = (sys.executable, "-m", "piegraph_cli")
PROGRAM = Path(".venv/bin/piegraph")
"""The program within a checkout."""


def perception_rows(folder: Path | None, against: Path | None) -> Iterator[Row]:
    """Processor seconds a frame of the stages' commands, on one core, imports included, on the recording of a run.

    `against` is a checkout whose commands do the same in turn, with their own default settings. The last row is the sum,
    beside the time between two frames of the recording. What comes out is held against what the run has.
    """
    assert folder is not None
    run = open_run(folder)
    names = sequences(run)
    for stage in (STAGES[name] for name in TIMED):
        if not names or not all(run.path(stage.writes, name).is_file() for name in names):
            hint = command_line("run", "--run", folder)
            raise UsageError(f"{folder} has no {stage.writes} to compare with", "bench perception", hint)
    times = [read_artifact(run.path("frames", name), "frames", only=("time",))["time"] for name in names]
    frames, step = sum(map(len, times)), float(np.median(np.concatenate([np.diff(time) for time in times])))
    with tempfile.TemporaryDirectory(prefix="piegraph") as made:
        own, other = Run(Path(made) / "own", run.recipe), Path(made) / "other"
        own.save_recipe()
        _seconds(*OWN, "ingest", "--run", own.folder)
        if against is not None:
            _seconds(against / PROGRAM, "ingest", "--run", other, "--recording", _recording(run))
        rows = []
        for name in TIMED:
            seconds = _seconds(*OWN, name, "--run", own.folder) / frames
            reference = _seconds(against / PROGRAM, name, "--run", other) / frames if against is not None else None
            case = f"{name}, a frame" + ("" if _same(own, run, name, names) else ", not as stored")
            rows.append(Row("perception", case, seconds, reference_seconds=reference))
            yield rows[-1]
    reference = sum(row.reference_seconds or 0 for row in rows) or None
    case = f"all four, a frame every {step * 1000:.0f} ms"
    yield Row("perception", case, sum(row.seconds for row in rows), reference_seconds=reference)


def check_checkout(folder: Path) -> None:
    """Refuse a folder that is no checkout with an environment of its own. Raises UsageError."""
    if not (folder / PROGRAM).is_file():
        raise UsageError(f"no {PROGRAM}", str(folder), "a checkout in which `make setup` has been run")


def _recording(run: Run) -> str:
    recording = run.recipe.sections["ingest"]["recording"]
    if not isinstance(recording, str | Path):
        raise UsageError("another commit is compared on one recording", str(run.folder), "a run of one recording")
    return str(recording)


def _same(own: Run, run: Run, name: str, names: list[str]) -> bool:
    """Whether a stage made what is stored."""
    artifact = STAGES[name].writes
    for unit in names:
        made, stored = (read_artifact(one.path(artifact, unit), artifact).arrays for one in (own, run))
        for key, value in stored.items():
            if key not in made or made[key].shape != value.shape:
                return False
            if value.dtype.kind != "S" and not np.allclose(made[key], value, 1e-3, 1e-4, equal_nan=True):
                return False
    return True


def _seconds(*command: object) -> float:
    """Processor seconds that a command takes. Raises DataError where it fails."""
    before = os.times()
    words = [str(word) for word in command]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    if words[0] != sys.executable:
        environment.pop("PYTHONPATH", None)  # this commit's modules
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    after = os.times()
    if done.returncode:
        raise DataError(f"{' '.join(words)} failed: {done.stderr.strip()}", "bench perception")
    return after.children_user + after.children_system - before.children_user - before.children_system
