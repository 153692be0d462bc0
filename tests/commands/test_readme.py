"""The README's commands, word by word, from a recording to a plan."""

import re
import shlex
import shutil

import pytest
import typer

from piegraph_cli.commands.program import GROUPS, app
from tests.cli import REPOSITORY, SAMPLE
from tests.commands.inside import piegraph, piegraph_json

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
SMALL = {"train": ("--steps", "30", "--hidden", "8", "--layers", "2")}


def commands(page) -> list[list[str]]:
    """What the code blocks of a page say, each line that calls piegraph as a list of words."""
    blocks = re.findall(r"^```\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    lines = [line.split(" #")[0].strip() for block in blocks for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("piegraph ")]


def stage_by_stage() -> list[list[str]]:
    """The README's path from `ingest` to `report`."""
    found = commands(REPOSITORY / "README.md")
    names = [words[0] for words in found]
    return found[names.index("ingest") : names.index("report") + 1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_the_pages_is_understood(page):
    """Options by their names, and values of a kind that fits: the rest shows when they are run."""
    program, found = typer.main.get_command(app), commands(page)
    assert page.name != "README.md" or len(found) > 25
    for words in found:
        if words[0] in [name for option in program.params for name in option.opts]:
            continue
        assert any(words[0] in group for group in GROUPS.values()), words
        command = program.commands[words[0]]
        with command.make_context(words[0], [w for w in words[1:] if w != "…"]) as context:
            assert context.params, words


def test_from_a_recording_to_pictures_stage_by_stage(sample_run, tmp_path):
    """What costs minutes is taken from a run of the same settings and must be found fresh; no stage `score` was run."""
    path = stage_by_stage()
    assert [words[0] for words in path] == [
        *("ingest", "hands", "segment", "fuse", "track", "dataset", "train", "evaluate", "report")
    ]
    folder = tmp_path / "runs" / "mine"
    for artifact in ("frames", "hands", "masks", "clouds", "tracks"):
        shutil.copytree(sample_run / artifact, folder / artifact)
    names = {"my_recording": str(SAMPLE), "runs/mine": str(folder), "4": "2"}
    done = {}
    for words in path:
        arguments = [names.get(word, word) for word in words]
        done[words[0]] = piegraph_json(*arguments, *SMALL.get(words[0], ()))
    for stage in ("ingest", "hands", "segment", "fuse", "track"):
        assert [o["state"] for o in done[stage]["outcomes"]] == ["cached"] * 4
    found = done["evaluate"]
    assert {row["model"] for row in found["rows"]} == {"static", "piegraph-ng", "piegraph", "kabsch"}
    assert (found["scores"], found["missing"]) == ([], [])
    assert {"tracks", "model"} <= {verdict["part"] for verdict in done["report"]["verdicts"]}
    text = (folder / "recipe.toml").read_text()
    assert "[ingest]" in text
    assert "train = 3" in text
    assert "sequence_0000" in piegraph("status", "--run", folder).stdout
