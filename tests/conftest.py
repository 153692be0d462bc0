"""Runs that several tests share, made once per session."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
SAMPLE = REPOSITORY / "sample_data" / "tblock"


def piegraph(*arguments: object, check: int | None = 0, **options) -> subprocess.CompletedProcess:
    """Run the command line in a process of its own; `check` is the exit code it must end with."""
    command = [sys.executable, "-c", "from piegraph_cli.app import main; main()", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, **options)
    if check is not None:
        assert done.returncode == check, f"{arguments}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def piegraph_json(*arguments: object) -> dict:
    """The JSON object a command prints with --json."""
    return json.loads(piegraph(*arguments, "--json").stdout)


TINY = """
[simulate]
sequences = 4
strokes = 2

[dataset]
train = 2
validation = 1

[train]
steps = 40
hidden = 8
layers = 2
checkpoint_every = 10

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
    piegraph("run", recipe, "--run", folder, "--jobs", 2, "--set", "train.steps=300", "--set", "plan.strokes=3")
    return folder
