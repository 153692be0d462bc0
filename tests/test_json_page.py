"""docs/json.md is as the models make it, and the models are what commands print: `tests/envelopes.py` holds every one."""

import json
import shutil

import pytest
import typer
from pydantic import ValidationError

from piegraph_cli.commands.program import app
from tests.commands.inside import envelope
from tests.envelopes import checked
from tools.json_page import PAGE, WITHOUT, commands, filled, kind_text


def test_the_page_is_as_the_models_make_it():
    page = PAGE.read_text(encoding="utf-8")
    assert filled(page) == page, "`make tables` writes it again"
    assert filled(page.replace("list of", "")) == page
    with pytest.raises(ValueError, match="missing"):
        filled("no marks")


def test_every_command_has_json_or_says_why_not():
    program = typer.main.get_command(app)
    without = {
        name for name in commands() if "--json" not in {o for p in program.commands[name].params for o in p.opts}
    }
    assert without == set(WITHOUT)


def test_words_for_types():
    assert kind_text(list[tuple[float, float | None]]) == "list of [number, number or null]"
    assert kind_text(dict[str, int]) == "object of integer by name"


@pytest.mark.parametrize(
    "change",
    [
        {"extra": 1},
        {"warnings": None},
        {"error": {"kind": "usage", "message": "no"}},
        {"result": {"run": "r", "stages": [], "bytes": 0}},
        {"result": {"run": "r", "stages": [], "bytes": 0.5, "artifacts": []}},
        {"result": {"run": "r", "stages": [], "bytes": 0, "artifacts": [], "next": 1}},
    ],
)
def test_what_is_not_as_it_is_written_is_seen(change, tiny_run):
    good = envelope("status", "--run", tiny_run)
    with pytest.raises(ValidationError):
        checked(json.dumps(good | change))
    with pytest.raises(ValueError, match="no JSON"):
        checked('{"result": NaN}')


def test_commands_on_a_run(tiny_run, tmp_path):
    """Beside those that have tests of their own."""
    folder = shutil.copytree(tiny_run, tmp_path / "a run")
    for command in (
        ("run", "--dry", "--force"),
        ("run", "--force", "--until", "dataset"),
        ("evaluate", "--models", "static,pgnd"),
        ("clean",),
        ("plan", "--env", "tblock", "--samples", 8, "--strokes", 1),
    ):
        found = envelope(*command, "--run", folder, check=3 if "static,pgnd" in command else 0)
        assert found["result"], command
