"""Runs that several tests share, made once, however many processes share the tests."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

from tests.cli import REPOSITORY, piegraph

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program does, before NumPy is imported


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """The arrays of tests are small, and waiting for a second core costs more than it brings."""
    import torch

    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def interrupts():
    """A shell's background jobs ignore Ctrl-C, and so would what tests start and interrupt."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


TINY = """
[simulate]
sequences = 4
strokes = 2

[dataset]
train = 2
validation = 1

[train]
checkpoint_every = 10

[train.piegraph]
steps = 40
hidden = 8
layers = 2

[evaluate]
horizons = [1, 2]

[plan]
env = "tblock"
samples = 12
cem_iterations = 2
strokes = 2
"""


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], object]], Path]:
    """`shared(name, make)`: a path that `make` fills, once for all processes of pytest-xdist: the others wait."""
    base = tmp_path_factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def once(name: str, make: Callable[[Path], object]) -> Path:
        path, done = folder / "shared" / name, folder / "shared" / f"{name}.done"
        path.parent.mkdir(exist_ok=True)
        with FileLock(f"{path}.lock"):
            if not done.exists():
                make(path)
                done.touch()
        return path

    return once


@pytest.fixture(scope="session")
def tiny_recipe(shared) -> Path:
    """A recipe that runs the simulated chain in seconds."""
    return shared("tiny.toml", lambda path: path.write_text(TINY))


@pytest.fixture(scope="session")
def tiny_run(tiny_recipe: Path, shared) -> Path:
    """The finished run of the tiny recipe: read it, never write to it."""
    return shared("tiny", lambda folder: piegraph("run", tiny_recipe, "--run", folder))


@pytest.fixture(scope="session")
def sample_run(shared) -> Path:
    """The demo recipe on the sample recording, with a short training: read it, never write to it."""
    recipe = REPOSITORY / "pipelines" / "demo.toml"
    settings = ("--jobs", 2, "--set", "train.piegraph.steps=300", "--set", "plan.strokes=3")
    return shared("sample run", lambda folder: piegraph("run", recipe, "--run", folder, *settings))


@pytest.fixture(scope="session")
def sam_checkpoint(shared) -> Path:
    """Weights of a small Segment Anything model, trained on the spot."""
    import torch

    from tests.perception.tiny_sam import train

    return shared("tiny.pt", lambda path: torch.save(train(steps=60).state_dict(), path))
