"""The package as a wheel installs it, away from the repository: recipes inside, the sample recording not; and `python -m`."""

import os
import runpy
import shutil
import subprocess
import sys

import pytest

from piegraph_cli import __version__
from tests.cli import PROGRAM, REPOSITORY, SAMPLE


@pytest.fixture
def site(tmp_path):
    """A folder laid out as pyproject.toml lays out the wheel."""
    site = tmp_path / "site"
    package = shutil.copytree(REPOSITORY / "piegraph_cli", site / "piegraph_cli", ignore=lambda *_: ["__pycache__"])
    shutil.copytree(REPOSITORY / "pipelines", package / "pipelines")
    return site


def test_the_demo_without_its_sample_says_so_and_goes_on_with_it(site, tmp_path):
    """In processes that import that package, and not this one."""
    before = sorted(site.rglob("*"))
    environment = os.environ | {"PYTHONPATH": str(site), "PYTHONDONTWRITEBYTECODE": "1"}

    def program(*arguments: str, code: int) -> str:
        command = [*PROGRAM, *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    said = program("run", "demo", code=3)
    assert f"{site}/piegraph_cli/sample_data/tblock: the sample recording is not part of the" in said
    assert "--set ingest.recording=sample_data/tblock" in said
    assert "Traceback" not in said
    assert sorted(site.rglob("*")) == before
    assert not (tmp_path / "runs").exists()
    sample = tmp_path / "sample_data" / "tblock"
    shutil.copytree(SAMPLE / "sequence_0001", sample / "sequence_0001")
    shutil.copy(SAMPLE / "cameras.json", sample)
    given = ("--set", "ingest.recording=sample_data/tblock")
    assert "done" in program("run", "demo", "--until", "ingest", *given, code=0)
    program("status", "--run", "runs/demo", code=0)


def test_the_program_runs_as_a_module(tmp_path):
    command = [sys.executable, "-m", "piegraph_cli"]
    options = {
        "capture_output": True,
        "text": True,
        "cwd": tmp_path,
        "env": os.environ | {"PYTHONPATH": str(REPOSITORY)},
    }
    done = subprocess.run([*command, "--version"], **options)
    assert (done.returncode, done.stdout) == (0, f"piegraph {__version__}\n")
    done = subprocess.run([*command, "status", "--run", "none"], **options)
    assert done.returncode == 2
    assert "not a run folder" in done.stderr


def test_a_worker_that_imports_the_module_runs_nothing():
    runpy.run_module("piegraph_cli.__main__", run_name="__mp_main__")
