"""The envelope of `--json`: one object for every command, however it ends."""

import json
import logging
import os
import subprocess

import numpy as np
import pytest

from piegraph_cli import __version__
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.errors import DataError, MissingError
from tests.cli import PROGRAM
from tests.commands.inside import envelope, piegraph

NAMES = ["command", "version", "result", "warnings", "error"]
ERROR = ["kind", "message", "where", "try", "exit_code"]


def test_what_succeeds():
    found = envelope("list", "models")
    assert list(found) == NAMES
    assert (found["command"], found["version"], found["warnings"], found["error"]) == ("list", __version__, [], None)
    assert "piegraph" in found["result"]["models"]


@pytest.mark.parametrize(
    ("arguments", "code", "kind", "where", "tries"),
    [
        (["status", "--run", "r"], 2, "usage", "r", "start with piegraph ingest, or piegraph run"),
        (["status"], 2, "usage", None, "piegraph status --help"),
        (["fly"], 2, "usage", None, "piegraph --help"),
        (["list", "moons"], 2, "usage", None, "piegraph list --help"),
        (["simulate", "toy", "--out", "r", "--sequences", "0"], 2, "usage", None, None),
        (["run", "none.toml"], 3, "data", "none.toml", None),
    ],
)
def test_a_mistake_is_an_object_too(arguments, code, kind, where, tries, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = envelope(*arguments, check=code)
    assert list(found) == NAMES
    assert list(found["error"]) == ERROR
    assert found["command"] == (None if arguments[0] == "fly" else arguments[0])
    assert (found["result"], found["error"]["kind"], found["error"]["exit_code"]) == (None, kind, code)
    assert where is None or found["error"]["where"] == where
    assert tries is None or found["error"]["try"] == tries
    said = piegraph(*arguments, check=code)
    assert said.stdout == ""
    assert found["error"]["message"] in said.stderr


def command(monkeypatch, work):
    """`piegraph unpack` does this instead."""
    monkeypatch.setattr("piegraph_cli.recording.unpack.unpack", lambda *_: work())
    monkeypatch.setattr("piegraph_cli.recording.folders.list_sequences", lambda *_: ["bag"])
    return "unpack", "there", "--out", "here"


def fails(error):
    def work():
        raise error

    return work


def test_ctrl_c(monkeypatch):
    found = envelope(*command(monkeypatch, fails(KeyboardInterrupt())), check=130)
    assert (found["result"], found["error"]["kind"], found["error"]["exit_code"]) == (None, "interrupted", 130)


def test_a_bug_is_told_to_programs_and_raised(monkeypatch, capsys):
    arguments = command(monkeypatch, fails(ZeroDivisionError("by nought")))
    with pytest.raises(ZeroDivisionError):
        piegraph(*arguments)
    assert capsys.readouterr().out == ""
    said = []
    monkeypatch.setattr("builtins.print", lambda text, **_: said.append(text))
    with pytest.raises(ZeroDivisionError):
        piegraph(*arguments, "--json")
    found = json.loads("".join(said))
    assert (found["result"], found["error"]["kind"]) == (None, "bug")
    assert found["error"]["message"] == "ZeroDivisionError: by nought"


def test_warnings_are_those_that_were_said(monkeypatch):
    def work():
        logging.getLogger("piegraph").warning("%d points are gone", 3)
        logging.getLogger("piegraph").info("on the way")
        return "seq", 2, ["no times"]

    arguments = command(monkeypatch, work)
    said = piegraph(*arguments)
    assert said.stderr == "3 points are gone\non the way\n"
    assert envelope(*arguments)["warnings"] == ["3 points are gone", "seq: no times"]
    assert envelope("list")["warnings"] == []
    assert not logging.getLogger("piegraph").handlers


def test_what_was_done_before_a_failure_is_kept(monkeypatch):
    def work():
        emit(Report({"takes": [float("nan"), np.float32(1.5), np.array([1, 2])]}, []), True)
        raise DataError("a cable is out", "front", "plug it in")

    found = json.loads(piegraph(*command(monkeypatch, work), "--json", check=3).stdout)
    assert found["result"] == {"takes": [None, 1.5, [1, 2]]}
    assert found["error"] == {
        "kind": "data",
        "message": "a cable is out",
        "where": "front",
        "try": "plug it in",
        "exit_code": 3,
    }


def test_a_report_that_ends_badly_has_its_error(monkeypatch):
    for error in (None, MissingError("no scale", "kitchen")):
        report = Report({"weight": None}, ["nothing to weigh with"], 4, error)
        monkeypatch.setattr("piegraph_cli.commands.tools.Report", lambda *_, told=report, **__: told)
        found = json.loads(piegraph(*command(monkeypatch, lambda: ("seq", 2, [])), "--json", check=4).stdout)
        assert (found["result"], found["error"]["kind"]) == ({"weight": None}, "missing")
        assert found["error"]["message"] == (error.message if error else "nothing to weigh with")


def test_units_that_fail_are_objects_and_the_first_is_the_error(tmp_path):
    asked = ("trials", "--run", tmp_path / "r", "--envs", "tblock", "--models", "gnn", "--goals", 1, "--seeds", 2)
    found = envelope(*asked, check=3)
    (first, second) = found["result"]["failed"]
    assert list(first["error"]) == ERROR
    assert first["error"] == found["error"]
    assert first["trial"] != second["trial"]


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_reader_that_leaves_is_no_bug(options):
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([*PROGRAM, "list", *options], stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")
