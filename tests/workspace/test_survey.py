"""What a run has, what a run of the recipe would make and why; and a failure that leaves what is fresh fresh."""

import dataclasses
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from piegraph_cli.bench import workspace as bench
from piegraph_cli.errors import DataError
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace import execute
from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.known import TICK
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.survey import count_states, foresee, status
from tests.cli import PROGRAM, REPOSITORY, piegraph, piegraph_json
from tests.stages.make_recording import make_recording


@pytest.fixture
def copied(tiny_run, tmp_path):
    """A copy of the tiny run, to be changed."""
    shutil.copytree(tiny_run, tmp_path / "run")
    return tmp_path / "run"


def changed(folder: Path, stage: str, **settings) -> Run:
    run = open_run(folder)
    run.recipe = run.recipe.with_values(STAGES[stage], settings, "test", folder)
    return run


def files(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(p): (p.stat().st_mtime_ns, p.stat().st_size) for p in sorted(folder.rglob("*"))}


def test_status_counts_and_lists_what_is_not_fresh(copied):
    folder = copied
    found = piegraph("status", "--run", folder).stdout.splitlines()
    assert found[0].split() == ["stage", "fresh", "stale", "missing", "failed", "on", "disk"]
    assert found[1].split()[:5] == ["simulate", "4", "-", "-", "-"]
    assert found[7] == "", "five stages and their sum"
    assert found[8:] == [f"next: piegraph report --run {folder}", f"or: piegraph view --run {folder}"]
    (folder / "tracks" / "sequence_0001.h5").unlink()
    changed(folder, "plan", samples=13).save_recipe()
    value = piegraph_json("status", "--run", folder)
    by_stage = {row["stage"]: row for row in value["stages"]}
    assert (by_stage["simulate"]["fresh"], by_stage["simulate"]["missing"], by_stage["plan"]["stale"]) == (3, 1, 1)
    assert by_stage["dataset"]["bytes"] == (folder / "dataset.h5").stat().st_size
    assert value["bytes"] == sum(path.stat().st_size for path in folder.rglob("*.h5"))
    assert len(value["artifacts"]) == sum(row[s] for row in value["stages"] for s in ("fresh", "stale", "missing"))
    text = piegraph("status", "--run", folder).stdout
    assert "sequence_0001" in text
    assert "settings changed: samples" in text
    assert "sequence_0000" not in text
    assert "sequence_0000" in piegraph("status", "--run", folder, "--units").stdout


def test_many_units_of_one_reason_are_one_line(tmp_path):
    (tmp_path / "recipe.toml").write_text("[simulate]\nsequences = 30\n")
    text = piegraph("status", "--run", tmp_path).stdout
    assert "30 sequences" in text
    assert "sequence_0007" not in text


def test_nothing_would_be_made_where_all_is_fresh(copied):
    before = files(copied)
    assert "all is fresh" in piegraph("run", "--run", copied, "--dry").stdout
    assert files(copied) == before


def test_a_dry_run_says_why_and_writes_nothing(copied):
    changed(copied, "train", **{"piegraph.steps": 5}).save_recipe()
    before = files(copied)
    rows = piegraph_json("run", "--run", copied, "--dry", "--until", "evaluate")["would_make"]
    reasons = {(row["stage"], row["unit"]): row["reason"] for row in rows}
    assert reasons[("train", "piegraph.seed0")] == "settings changed: steps"
    assert reasons[("evaluate", "piegraph.seed0")] == "model would be made again"
    assert ("evaluate", "static") not in reasons
    assert files(copied) == before


def test_a_dry_run_of_a_folder_that_is_not_there(tmp_path, tiny_recipe):
    rows = piegraph_json("run", tiny_recipe, "--run", tmp_path / "none", "--dry")["would_make"]
    assert {row["reason"] for row in rows} == {"missing"}
    assert not (tmp_path / "none").exists()


def test_reasons_after_an_upgrade_and_with_force(copied, monkeypatch):
    stored = STAGES["dataset"].version
    monkeypatch.setitem(STAGES, "dataset", dataclasses.replace(STAGES["dataset"], version=99))
    found = {row["stage"]: row["reason"] for row in foresee(open_run(copied), None, force=False)}
    assert found["dataset"] == f"made by version {stored} of the stage, this is version 99"
    assert found["train"] == "dataset would be made again"
    forced = foresee(open_run(copied), "simulate", force=True)
    assert [row["reason"] for row in forced] == ["--force"] * 4


def test_what_is_foreseen_is_what_is_made(copied):
    (copied / "tracks" / "sequence_0001.h5").unlink()
    run = changed(copied, "evaluate", horizons=[1])
    foreseen = [(row["stage"], row["unit"]) for row in foresee(run, None, force=False)]
    assert foreseen[0] == ("simulate", "sequence_0001")
    assert {stage for stage, _ in foreseen} == {"simulate", "evaluate", "plan"}, (
        "with the same tracks, the dataset stays"
    )
    made = [(o.stage, o.unit) for o in run_chain(run, None, Options()) if o.state == "done"]
    assert sorted(made) == sorted(foreseen)


def test_scores_that_would_be_made_count_as_made(tmp_path):
    recording = bench.make_recording(tmp_path / "recording", 2, 1, 10)
    for sequence in recording.glob("sequence_*"):
        (sequence / "truth.h5").write_bytes(b"")
    folder = bench.make_run(tmp_path / "run", recording).folder
    assert {row["state"] for row in status(open_run(folder))} == {"fresh"}
    (folder / "scores" / "sequence_0001.h5").unlink()
    assert "stale" in {row["state"] for row in status(open_run(folder)) if row["stage"] == "evaluate"}
    found = [(row["stage"], row["unit"], row["reason"]) for row in foresee(open_run(folder), None, force=False)]
    assert found == [("score", "sequence_0001", "missing")]


@pytest.fixture
def ingested(tmp_path):
    run = Run(tmp_path / "run", Recipe(STAGES, {"ingest": {"recording": str(make_recording(tmp_path / "rec"))}}))
    run.save_recipe()
    run_stage(run, STAGES["ingest"], Options())
    return run


def ingest_states(folder: Path) -> list[str]:
    return [row["state"] for row in status(open_run(folder)) if row["stage"] == "ingest"]


def test_a_forced_write_that_fails_leaves_what_was_fresh(ingested, monkeypatch):
    def full(path, *_, **__):
        raise DataError("cannot be written: No space left on device", str(path))

    with monkeypatch.context() as patched:
        patched.setattr(execute, "write_artifact", full)
        outcomes = run_stage(ingested, STAGES["ingest"], Options(force=True))
    assert {o.state for o in outcomes} == {"failed"}
    assert json.loads((ingested.folder / "failures.json").read_text()), "the failure is on record"
    assert ingest_states(ingested.folder) == ["fresh"] * 2
    assert {o.state for o in run_stage(ingested, STAGES["ingest"], Options())} == {"cached"}
    hands = run_stage(ingested, STAGES["hands"], Options(only=("seq 0",)))
    assert not isinstance(hands[0].error, execute.LeftOut), "the next stage is tried"


def test_a_forced_write_to_a_full_disk_leaves_what_was_fresh(ingested):
    command = ["bash", "-c", 'ulimit -f 4; exec "$@"', "bash", *PROGRAM, "ingest", "--run", ingested.folder, "--force"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY)
    assert done.returncode == 3, done.stderr
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert ingest_states(ingested.folder) == ["fresh"] * 2
    assert not list(ingested.folder.rglob("*.tmp"))
    again = piegraph_json("ingest", "--run", ingested.folder)
    assert [o["state"] for o in again["outcomes"]] == ["cached"] * 2


def test_counts_of_nothing():
    assert count_states([]) == []


@pytest.mark.parametrize("command", [["status"], ["run"], ["run", "--dry"]])
def test_nothing_heavy_is_imported_where_all_is_fresh(tiny_run, tmp_path, command):
    shutil.copytree(tiny_run, tmp_path / "run")
    time.sleep(1.1 * TICK / 1e9)
    status(open_run(tmp_path / "run"))
    arguments = [*command, "--run", str(tmp_path / "run")]
    program = f"""
import sys
from piegraph_cli.commands.program import call
code = call({arguments})
print([name for name in sys.modules if "." not in name])
sys.exit(code)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=REPOSITORY, check=True)
    assert "'pydantic'" in done.stdout.splitlines()[-1]
    for heavy in ("numpy", "h5py", "torch", "cv2", "scipy", "pymunk", "matplotlib", "joblib", "open3d"):
        assert f"'{heavy}'" not in done.stdout.splitlines()[-1], heavy
