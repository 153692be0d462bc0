"""SIGKILL while a stage writes, then the same command: everything ends as in a run that nobody stopped."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.artifact import read_artifact
from tests.cli import PROGRAM, piegraph

KILLER = Path(__file__).parent / "killer.py"


def killed(after: int, *arguments: object) -> None:
    done = subprocess.run([sys.executable, KILLER, str(after), *map(str, arguments)], capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()


def assert_equal_runs(found: Path, expected: Path) -> None:
    for path in sorted(expected.rglob("*.h5")):
        name = path.parent.name if path.parent != expected else path.stem
        first, second = read_artifact(path, name), read_artifact(found / path.relative_to(expected), name)
        assert first.key == second.key, path
        for dataset in set(first.arrays) - {"seconds"}:
            np.testing.assert_array_equal(first[dataset], second[dataset], err_msg=f"{path} {dataset}")
    assert not list(found.rglob("*.tmp"))


def forget(folder: Path, artifact: str) -> None:
    shutil.rmtree(folder / artifact, ignore_errors=True)
    (folder / f"{artifact}.h5").unlink(missing_ok=True)


@pytest.mark.parametrize(("stage", "file"), [("simulate", 3), ("dataset", 1), ("evaluate", 1), ("plan", 1)])
def test_simulated_stage(tiny_run, tmp_path, stage, file):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    forget(folder, STAGES[stage].writes)
    killed(file, "run", "--run", folder)
    assert list(folder.rglob("*.tmp"))
    piegraph("run", "--run", folder)
    assert_equal_runs(folder, tiny_run)


@pytest.mark.parametrize("stage", ["ingest", "hands", "segment", "fuse", "track"])
def test_recorded_stage(sample_run, tmp_path, stage):
    folder = tmp_path / "run"
    shutil.copytree(sample_run, folder)
    sequence = sorted((folder / STAGES[stage].writes).iterdir())[-1]
    sequence.unlink()
    killed(1, "run", "--run", folder, "--until", stage)
    assert not sequence.exists()
    piegraph("run", "--run", folder, "--until", stage)
    assert_equal_runs(folder, sample_run)


@pytest.mark.parametrize("after", [1, 3])
def test_training_goes_on_from_its_checkpoint(tiny_run, tmp_path, after):
    """Killed in the first checkpoint, and in a later one: then the earlier one is whole and is taken up."""
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    forget(folder, "model")
    killed(after, "train", "--run", folder)
    assert (folder / "checkpoints" / "train.piegraph.seed0.h5").exists() == (after == 3)
    piegraph("train", "--run", folder)
    assert_equal_runs(folder, tiny_run)
    assert not (folder / "checkpoints" / "train.piegraph.seed0.h5").exists()


def test_interrupt_ends_with_130_and_a_word(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    process = subprocess.Popen(
        [*PROGRAM, "train", "--run", folder, "--steps", "1000000"], stderr=subprocess.PIPE, text=True
    )
    log = folder / "run.log"
    size = log.stat().st_size
    while not (folder / "checkpoints" / "train.piegraph.seed0.h5").exists() and process.poll() is None:
        time.sleep(0.05)
    assert log.stat().st_size > size
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate()
    assert process.returncode == 130
    assert "goes on from here" in stderr


def test_an_interrupt_that_falls_into_a_destructor_is_not_lost():
    program = """
import signal, time
from piegraph_cli.__main__ import main
from piegraph_cli.commands import program

class Falls:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def work(*arguments, **options):
    Falls()
    time.sleep(50)

program.app = work
main()
"""
    process = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    assert process.returncode == 130
    assert "goes on from here" in process.stderr
