"""What is looked at before strokes are simulated for hours: what DaXBench needs, and memory for its processes."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from piegraph_cli import process
from piegraph_cli.environments.params import EnvironmentParams, SequenceParams
from piegraph_cli.environments.recording import simulate_tracks
from piegraph_cli.errors import MissingError
from piegraph_cli.stages import steps
from piegraph_cli.stages.simulate import sequence_seed
from piegraph_cli.workspace.artifact import read_artifact
from tests.commands.inside import envelope, piegraph

REPO = Path(__file__).parents[1] / "environments" / "fake_daxbench"
GIVEN = EnvironmentParams(daxbench_python=Path(sys.executable), daxbench_repo=REPO)
NAMED = ("PIEGRAPH_DAXBENCH_PYTHON", "PIEGRAPH_DAXBENCH_REPO")
SMALL = ("--set", "simulate.sequences=1", "--set", "simulate.strokes=1", "--until", "simulate")


@pytest.fixture(autouse=True)
def nothing_named(monkeypatch):
    for name in NAMED:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("free", "processes", "warning"),
    [
        (64e9, 8, None),
        (7e9, 2, None),
        (None, 8, None),
        (7e9, 4, "takes 3.1 GB in each of 4 processes, and 7.0 GB are free: give --jobs 2,"),
        (2e9, 4, "give --jobs 1,"),
        (2e9, 1, "takes 3.1 GB, and 2.0 GB are free: end other programs"),
    ],
)
def test_short_memory_is_said_before_anything_is_simulated(monkeypatch, free, processes, warning):
    monkeypatch.setattr(steps, "free_memory", lambda: free)
    found = steps.check_environments([("daxbench-rope", GIVEN), ("tblock", GIVEN), (None, GIVEN)], processes)
    assert len(found) == (warning is not None)
    assert all("daxbench-rope" in said and warning in said for said in found)


def test_free_memory_is_less_than_there_is():
    total = int(next(line for line in Path("/proc/meminfo").read_text().splitlines() if "MemTotal" in line).split()[1])
    assert 0 < process.free_memory() < 1024 * total


def test_what_daxbench_needs_is_said_once_and_before_hours_are_spent(tmp_path):
    alone = envelope("simulate", "daxbench-tshirt", "--sequences", 30, "--out", tmp_path / "alone", check=4)
    assert alone["error"]["message"] == "DaXBench's interpreter is not given"
    given = [word for name, value in zip(("python", "repo"), (sys.executable, REPO), strict=True)
             for word in ("--set", f"simulate.daxbench_{name}={value}")]  # fmt: skip
    chain = piegraph("run", "daxbench-tshirt", "--run", tmp_path / "chain", *given, check=4)
    assert "not given" in chain.stderr  # for `plan`, which comes last
    assert not (tmp_path / "chain" / "tracks").exists()
    piegraph("run", "daxbench-tshirt", "--run", tmp_path / "chain", *given, *SMALL)
    assert (tmp_path / "chain" / "tracks" / "sequence_0000.h5").exists()


def test_variables_of_the_shell_do_for_every_stage(tmp_path, monkeypatch):
    for name, value in zip(NAMED, (sys.executable, REPO), strict=True):
        monkeypatch.setenv(name, str(value))
    piegraph("run", "daxbench-tshirt", "--run", tmp_path / "run", *SMALL)
    assert "daxbench_python" not in (tmp_path / "run" / "recipe.toml").read_text()
    monkeypatch.delenv(NAMED[0])
    piegraph("run", "--run", tmp_path / "run", "--until", "simulate")  # what is fresh needs no DaXBench


def test_a_grid_of_trials_is_looked_at_as_well(tmp_path):
    with pytest.raises(MissingError, match="daxbench-rope: DaXBench's interpreter"):
        steps.check_environments([("tblock", GIVEN), ("daxbench-rope", EnvironmentParams())], 1)
    words = ("--envs", "tblock,daxbench-tshirt", "--models", "static", "--goals", 1, "--seeds", 1)
    assert "not given" in piegraph("trials", "--run", tmp_path / "grid", *words, check=4).stderr
    assert not (tmp_path / "grid" / "trials").exists()


def test_what_runs_in_a_process_of_its_own_is_kept_for_the_next_unit(monkeypatch, tmp_path):
    env = steps.make_environment("daxbench-rope", 50, GIVEN)
    assert steps.make_environment("daxbench-rope", 50, GIVEN) is env
    assert steps.make_environment("daxbench-rope", 40, GIVEN) is not env
    assert steps.make_environment("tblock", 50, GIVEN) is not steps.make_environment("tblock", 50, GIVEN)
    for name, value in zip(NAMED, (sys.executable, REPO), strict=True):
        monkeypatch.setenv(name, str(value))
    named = steps.make_environment("daxbench-rope", 50, EnvironmentParams())
    monkeypatch.setenv(NAMED[1], str(tmp_path))
    with pytest.raises(MissingError, match="no DaXBench repository"):
        steps.make_environment("daxbench-rope", 50, EnvironmentParams())
    named.check()


def test_a_sequence_is_the_same_whatever_was_simulated_before_it_in_the_process(tmp_path):
    given = ("--daxbench-python", sys.executable, "--daxbench-repo", REPO, "--strokes", 2)
    piegraph("simulate", "daxbench-rope", "--sequences", 2, "--out", tmp_path, *given)
    found = read_artifact(tmp_path / "tracks" / "sequence_0001.h5", "tracks")
    steps._made_once.cache_clear()
    alone = steps.make_environment("daxbench-rope", 50, GIVEN)
    tracks = simulate_tracks(alone, sequence_seed(SequenceParams(environment="daxbench-rope"), 1), strokes=2)
    np.testing.assert_array_equal(tracks["positions"], found["positions"])
