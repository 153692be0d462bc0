"""Runs that several tests share, made once per session."""

import signal
from pathlib import Path

import pytest

from tests.cli import REPOSITORY, piegraph


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
def tiny_recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recipe that runs the simulated chain in seconds."""
    path = tmp_path_factory.mktemp("recipe") / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.fixture(scope="session")
def tiny_run(tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished run of the tiny recipe: read it, never write to it."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    piegraph("run", tiny_recipe, "--run", folder)
    return folder


@pytest.fixture(scope="session")
def sample_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo recipe on the sample recording, with a short training: read it, never write to it."""
    folder = tmp_path_factory.mktemp("runs") / "sample run"
    recipe = REPOSITORY / "pipelines" / "demo.toml"
    piegraph(
        "run", recipe, "--run", folder, "--jobs", 2, "--set", "train.piegraph.steps=300", "--set", "plan.strokes=3"
    )
    return folder


@pytest.fixture(scope="session")
def sam_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a small Segment Anything model, trained on the spot."""
    import torch

    from tests.perception.tiny_sam import train

    path = tmp_path_factory.mktemp("sam") / "tiny.pt"
    torch.save(train(steps=60).state_dict(), path)
    return path
