"""The commands on whole runs: run, status."""

import shutil

import pytest

from piegraph_cli.stages import open_run
from tests.commands.inside import piegraph, piegraph_json


@pytest.fixture
def folder(tiny_run, tmp_path):
    """A copy of the finished run."""
    return shutil.copytree(tiny_run, tmp_path / "a run")


def test_status_and_evaluate_as_json(tiny_run):
    rows = piegraph_json("status", "--run", tiny_run)["artifacts"]
    assert {row["state"] for row in rows} == {"fresh"}
    assert [row["stage"] for row in rows if row["unit"] is None] == ["dataset", "plan"]
    found = piegraph_json("evaluate", "--run", tiny_run)["rows"]
    assert {(row["model"], row["horizon"]) for row in found} >= {("static", 1), ("piegraph", 2)}
    mean, low, high = found[0]["pd"]
    assert mean > 0
    assert low is None, "one held-out sequence has no interval"
    assert high is None


def test_a_second_run_is_all_fresh(tiny_run):
    outcomes = piegraph_json("run", "--run", tiny_run)["outcomes"]
    assert {o["state"] for o in outcomes} == {"cached"}


def test_status_says_why_something_is_stale(folder):
    piegraph("train", "--run", folder, "--steps", "39")
    (folder / "tracks" / "sequence_0001.h5").write_bytes(b"cut")
    rows = {(r["stage"], r["unit"]): r for r in piegraph_json("status", "--run", folder)["artifacts"]}
    assert "not a readable HDF5 file" in rows["simulate", "sequence_0001"]["reason"]
    assert "what it was made from has changed" in rows["evaluate", "piegraph.seed0"]["reason"]
    piegraph("train", "--run", folder, "--batch", "4", "--steps", "0", check=2)
    assert piegraph_json("status", "--run", folder)["artifacts"][5]["state"] == "fresh"


def test_a_recipe_that_is_refused_is_taken_back(folder):
    before = (folder / "recipe.toml").read_bytes()
    refused = piegraph("run", "--run", folder, "--set", "train.models=gnn@50", "--until", "train", check=2)
    assert "2 sequences to train on, 50 are asked for" in refused.stderr
    assert (folder / "recipe.toml").read_bytes() == before
    refused = piegraph("run", "--run", folder, "--set", "train.models=gnn:wide", check=2)
    assert "no variant gnn:wide" in refused.stderr
    assert (folder / "recipe.toml").read_bytes() == before
    piegraph("run", "--run", folder, "--set", "train.piegraph.steps=4", "--until", "train")
    assert open_run(folder).params("train").piegraph.steps == 4


def test_a_first_run_that_is_refused_keeps_the_recipe_as_it_was_named(tiny_recipe, tmp_path):
    piegraph("run", tiny_recipe, "--run", tmp_path / "r", "--set", "train.models=gnn@50", "--until", "train", check=2)
    assert open_run(tmp_path / "r").params("train").models == ("piegraph",)
    assert open_run(tmp_path / "r").params("simulate").sequences == 4


def test_a_recipe_is_kept_before_its_stages_run(folder, monkeypatch):
    """So that a run which was killed goes on with its settings."""
    seen = []

    def chain(run, until, options):
        seen.append(open_run(folder).params("train").piegraph.steps)
        raise KeyboardInterrupt

    monkeypatch.setattr("piegraph_cli.workspace.execute.run_chain", chain)
    piegraph("run", "--run", folder, "--set", "train.piegraph.steps=4", check=130)
    assert seen == [4]
    assert open_run(folder).params("train").piegraph.steps == 4
