"""Commands that write, each with what it begins with: the smallest that come to all of its writes."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.attack.attacks import motion
from tests.attack.chains import OF_RECORDING, SIMULATED, TRIALS, Chain, trials_of


@dataclass(frozen=True)
class Writer:
    """A command line, worked on in a folder of its own that `prepare` fills."""

    name: str
    arguments: tuple[str, ...]
    prepare: Callable[[Path], object]


def writers(made: Callable[[Chain], Path]) -> Iterator[Writer]:
    """All of them; `made` gives the folder in which a chain was finished."""
    simulated, recorded = (partial(_copied, made, chain) for chain in (SIMULATED, OF_RECORDING))
    yield Writer("run", ("run", "recipe.toml", "--run", "run"), SIMULATED.prepare)
    again = ("simulate", "tblock", "--out", "run", "--force")
    yield Writer("simulate --force", again, simulated)
    yield Writer("simulate --jobs 2", (*again, "--jobs", "2"), simulated)
    for stage in ("dataset", "train", "evaluate", "plan"):
        yield Writer(f"{stage} --force", (stage, "--run", "run", "--force"), simulated)
    for stage in ("ingest", "hands", "segment", "fuse", "track", "score"):
        yield Writer(f"{stage} --force", (stage, "--run", "run", "--force"), recorded)
    yield Writer("plan --out", ("plan", "--run", "run", "--out", "out.h5"), simulated)
    yield Writer("report", ("report", "--run", "run"), simulated)
    yield Writer("report --out", ("report", "--run", "run", "--out", "page"), recorded)
    yield Writer("suggest", ("suggest", "--run", "run", "--strokes", "2"), simulated)
    yield Writer("clean", ("clean", "--run", "run", "--yes"), partial(_with_leftovers, simulated))
    yield Writer("status --rehash", ("status", "--run", "run", "--rehash"), recorded)
    yield Writer(
        "trials", (*TRIALS, "--strokes", "2"), lambda folder: trials_of(made(SIMULATED) / "run").prepare(folder)
    )
    yield Writer("import", ("import", "take.npz", "--run", "run"), _motion)
    yield Writer("unpack", ("unpack", "rec", "--out", "out"), _bag)
    look = (
        "look",
        "recording/sequence_0000:4",
        "--run",
        "run",
        "--out",
        "now.ply",
        "--picture",
        "now.png",
        "--accept",
        "cut,size",
    )
    yield Writer("look", look, recorded)
    render = ("simulate", "tblock", "--render", "--sequences", "1", "--strokes", "1", "--out", "rendered")
    yield Writer("simulate --render", render, lambda folder: None)
    yield Writer("pretrain", ("pretrain", "--out", "prior.h5", "--steps", "3"), lambda folder: None)
    given = ("training=6", "interactions.measured=[3]", 'models=["static","rigid"]', "seeds=[0]")
    settings = (word for text in given for word in ("--set", text))
    yield Writer("reproduce", ("reproduce", "pushes", "--data", "measured.npz", "--runs", "runs", *settings), _measured)


def _copied(made: Callable[[Chain], Path], chain: Chain, folder: Path) -> None:
    shutil.copytree(made(chain), folder, dirs_exist_ok=True)


def _measured(folder: Path) -> None:
    from tests.test_experiments import measured

    measured(folder / "measured.npz")


def _with_leftovers(prepare: Callable[[Path], object], folder: Path) -> None:
    prepare(folder)
    shutil.copy(folder / "run" / "dataset.h5", folder / "run" / "tracks" / "gone.h5")
    (folder / "run" / ".plan.h5.1.tmp").write_bytes(b"half")


def _motion(folder: Path) -> None:
    import numpy as np

    np.savez(folder / "take.npz", **motion())  # type: ignore[arg-type]


def _bag(folder: Path) -> None:
    from tests.recording import test_bags as bags

    bags.write_bag(folder / "rec" / "take.bag", bags.camera_messages(bags.ONE, bags.LEFT, bags.pictures(0, 3), "/left"))
