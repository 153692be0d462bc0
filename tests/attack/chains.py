"""The smallest runs that go through all stages, what to expect of them, and what must hold of one that was stopped."""

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.workspace.artifact import read_artifact, read_header
from tests.cli import SAMPLE
from tests.conftest import TINY

RECORDED = '[ingest]\nrecording = "recording"\n\n[hands]\n\n[segment]\n\n[fuse]\n\n[track]\n'
FIRST, FRAMES, CAMERAS = 8, 6, 2
"""Of the sample's frames and cameras: those in which hand and object are found."""
DIFFERS = {"seconds"}
"""Datasets that say how long something took."""


@dataclass(frozen=True)
class Chain:
    """One command line, worked on in a folder of its own; `run` is where its run is there."""

    name: str
    arguments: tuple[str, ...]
    prepare: Callable[[Path], object]
    run: str = "run"


def simulated(folder: Path) -> None:
    """A recipe of simulate, dataset, train, evaluate and plan."""
    (folder / "recipe.toml").write_text(TINY)


def recorded(folder: Path) -> None:
    """A recording of two sequences of six frames of two cameras: ingest, hands, segment, fuse, track and score."""
    (folder / "recipe.toml").write_text(RECORDED)
    for sequence in sorted(SAMPLE.glob("sequence_*"))[:2]:
        to = folder / "recording" / sequence.name
        for camera in sorted(path for path in sequence.iterdir() if path.is_dir())[:CAMERAS]:
            for kind in ("color", "depth"):
                (to / camera.name / kind).mkdir(parents=True)
                for k, file in enumerate(sorted((camera / kind).iterdir())[FIRST : FIRST + FRAMES]):
                    shutil.copy(file, to / camera.name / kind / f"{k:06d}{file.suffix}")
            times = (camera / "timestamps.txt").read_text().splitlines()[FIRST : FIRST + FRAMES]
            (to / camera.name / "timestamps.txt").write_text("\n".join(times) + "\n")
        shutil.copy(sequence / "truth.h5", to)
    file = json.loads((SAMPLE / "cameras.json").read_text())
    file["cameras"] = dict(sorted(file["cameras"].items())[:CAMERAS])
    (folder / "recording" / "cameras.json").write_text(json.dumps(file))


SIMULATED = Chain("simulated", ("run", "recipe.toml", "--run", "run"), simulated)
OF_RECORDING = Chain("recorded", ("run", "recipe.toml", "--run", "run", "--until", "score"), recorded)
TRIALS = (
    "trials",
    "--run",
    "all/paper",
    "--envs",
    "tblock",
    "--models",
    "piegraph,static",
    "--goals",
    "1",
    "--seeds",
    "3",
)


def trials_of(run: Path) -> Chain:
    """Trials with the network of a finished simulated run."""

    def prepare(folder: Path) -> None:
        (folder / "all" / "tblock").mkdir(parents=True)
        shutil.copytree(run / "model", folder / "all" / "tblock" / "model")
        shutil.copy(run / "recipe.toml", folder / "all" / "tblock")

    return Chain("trials", (*TRIALS, "--strokes", "2"), prepare, "all/paper")


def artifacts(run: Path) -> Iterator[tuple[str, Path]]:
    """The artifacts of a run folder by name."""
    for path in sorted(run.rglob("*.h5")):
        if not path.name.startswith("."):
            name = path.stem if path.parent == run else path.parent.name
            yield "checkpoint" if name == "checkpoints" else name, path


def broken(run: Path) -> list[str]:
    """What a run that was stopped must not have: artifacts that are not whole, and failures."""
    found = [f"{path} is not whole" for name, path in artifacts(run) if read_header(path, name) is None]
    failures = run / "failures.json"
    if failures.exists() and (kept := json.loads(failures.read_text())):
        found.append(f"failures.json: {kept}")
    return found


def different(run: Path, expected: Path) -> list[str]:
    """How a finished run differs from one that nobody stopped: in an artifact's key or values, or in what lies about."""
    found = [str(path) for path in run.rglob("*.h5.*.tmp")]
    ours, theirs = ({path.relative_to(of): name for name, path in artifacts(of)} for of in (run, expected))
    found += [f"{path} is there or not" for path in sorted(ours.keys() ^ theirs.keys())]
    for path, name in theirs.items():
        if path in ours:
            one, other = read_artifact(run / path, name), read_artifact(expected / path, name)
            same = one.key == other.key and one.arrays.keys() == other.arrays.keys()
            values = [n for n in one.arrays.keys() & other.arrays.keys() - DIFFERS if not _equal(one[n], other[n])]
            found += [] if same and not values else [f"{path}: {values or 'key'}"]
    return found


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
