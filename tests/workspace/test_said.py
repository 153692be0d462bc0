"""Warnings are kept beside the artifact they are about, and no longer than it."""

import json

import pytest

from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.said import keep_warnings, kept_warnings
from tests.workspace.toy import TABLE, open_toy, prepare

GATHER = TABLE["gather"]


@pytest.fixture(autouse=True)
def toy(monkeypatch):
    prepare(monkeypatch)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "toy run"


def test_warnings_are_kept_as_long_as_their_artifact(folder):
    run = open_toy(folder, gather={"weight": 5.0})
    run.save_recipe()
    run_chain(run, None, Options())
    heavy = {("gather", "s1"): ["heavy"], ("gather", "s2"): ["heavy"]}
    assert kept_warnings(open_toy(folder)) == heavy
    run_stage(open_toy(folder), GATHER, Options())
    assert kept_warnings(open_toy(folder)) == heavy, "what is fresh keeps what was said when it was made"
    again = open_toy(folder)
    again.recipe = again.recipe.with_values(GATHER, {"weight": 6.0}, "test", folder)
    run_stage(again, GATHER, Options(only=("s1",)))
    record = json.loads((folder / "warnings.json").read_text())
    record["gather/s2"]["key"] = "of another artifact"
    (folder / "warnings.json").write_text(json.dumps(record))
    assert kept_warnings(open_toy(folder)) == {("gather", "s1"): ["heavy"]}


def test_where_nothing_is_said_nothing_is_written(folder):
    run = open_toy(folder, gather={})
    keep_warnings(run, GATHER, {"s0": []})
    assert not folder.exists()
    keep_warnings(run, GATHER, {"s0": ["one"], "s1": ["two"]})
    keep_warnings(run, GATHER, {"s0": ()})
    assert list(json.loads((folder / "warnings.json").read_text())) == ["gather/s1"]


@pytest.mark.parametrize("text", ["", "[1]", "{", '{"gather/s0": 3, "none/x": {"key": "1"}, "gather": {}}'])
def test_a_damaged_record_says_nothing(folder, text):
    folder.mkdir()
    (folder / "warnings.json").write_text(text)
    assert kept_warnings(open_toy(folder, gather={})) == {}
