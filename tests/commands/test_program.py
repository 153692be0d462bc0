"""The program as a whole: help, what it may import, completion, exit codes and messages."""

import json
import os
import subprocess
import sys

import pytest

from piegraph_cli.commands.names import KINDS
from piegraph_cli.commands.program import GROUPS
from piegraph_cli.stages import STAGES
from tests.cli import piegraph as in_process
from tests.commands.inside import piegraph, piegraph_json

COMMANDS = [name for commands in GROUPS.values() for name in commands]


def test_help_imports_nothing_heavy():
    code = "import sys; from piegraph_cli.commands.program import app; print([m for m in sys.modules if '.' not in m])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    heavy = {"torch", "numpy", "h5py", "cv2", "open3d", "mediapipe", "scipy", "matplotlib", "pymunk", "warp", "rich"}
    assert not heavy & set(json.loads(loaded.replace("'", '"')))


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_every_command_has_help(command, flag):
    assert piegraph(command, flag).stdout.startswith(f"Usage: piegraph {command} ")


@pytest.mark.parametrize("arguments", [["-h"], ["--help"], []])
def test_help_lists_the_stages_in_the_order_of_the_pipeline_and_the_rest_under_headings(arguments):
    text = piegraph(*arguments).stdout.partition("Stages")[2]
    words = [line.split()[0] for line in text.splitlines() if line.startswith("  ") and line.split()[0] in COMMANDS]
    assert words == COMMANDS
    assert words[: len(STAGES)] == list(STAGES)
    headings = [line.rstrip(":") for line in text.splitlines()[1:] if line.endswith(":") and not line.startswith(" ")]
    assert headings == [*GROUPS, "Options"][1:]


def test_settings_that_people_set_first_fit_on_a_screen_and_the_rest_follows(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    first, rest = piegraph("plan", "--help").stdout.split("More settings:")
    assert len(first.splitlines()) <= 25
    for name in STAGES["plan"].call.first:
        assert f"--{name.replace('_', '-')} <" in first
    rest, running = rest.split("Running:")
    assert "--converged" in rest
    assert "--jobs" in running


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_the_help_of_a_stage_has_every_setting(stage):
    text = piegraph(stage.name, "--help").stdout
    assert all(f"--{name.rstrip('_').replace('_', '-')}" in text for name in stage.call.first)
    for name, field in stage.params.model_fields.items():
        flag = name.upper() if name == stage.call.argument else f"--{name.replace('_', '-')}"
        tables = not field.metadata and "dict" in str(field.annotation)
        assert flag in text or tables or stage.call.options, name


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ("evaluate", "models"),
        ("plan", "models"),
        ("trials", "models"),
        ("plan", "environments"),
        ("trials", "environments"),
        ("simulate", "environments"),
        ("run", "recipes"),
        ("reproduce", "experiments"),
    ],
)
def test_names_stand_in_the_help_of_what_takes_them(command, kind, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    text = "".join(piegraph(command, "--help").stdout.split())
    assert all(name in text for name in KINDS[kind]())


def test_version():
    from piegraph_cli import __version__

    assert piegraph("--version").stdout == f"piegraph {__version__}\n"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("piegraph tr", {"track", "train", "trials"}),
        ("piegraph plan --en", {"--env"}),
        ("piegraph plan --env rope", {"rope-stiff", "rope-bendy"}),
        ("piegraph simulate to", {"toy"}),
        ("piegraph run tb", {"tblock"}),
        ("piegraph reproduce ta", {"table1"}),
        ("piegraph list mo", {"models"}),
    ],
)
def test_completion(words, found, monkeypatch, capsys):
    from piegraph_cli.commands.program import app

    monkeypatch.setenv("_PIEGRAPH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit):
        app([], prog_name="piegraph", standalone_mode=False)
    assert set(capsys.readouterr().out.split()) == found


def test_the_script_for_completion_asks_this_program():
    """The shell is named: what starts the tests need not be one."""
    done = in_process(
        "--show-completion", "bash", env=os.environ | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    )
    assert "_PIEGRAPH_COMPLETE=complete_" in done.stdout
    assert " piegraph" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["fly"], 2, "No such command"),
        (["track"], 2, "Missing option '--run'"),
        (["track", "--run", "r", "--speed", "3"], 2, "No such option"),
        (
            ["train", "--run", "r", "--steps", "0"],
            2,
            "train.piegraph.steps: Input should be greater than or equal to 1",
        ),
        (
            ["train", "--run", "r", "--model", "pgnd", "--seed", "0,x"],
            2,
            "train.seeds.1: Input should be a valid integer",
        ),
        (["train", "--run", "r", "--model", "pgnd@many", "--steps", "3"], 2, "'pgnd@many' is no model"),
        (["ingest", "--run", "r", "--workspace", "1,2"], 2, "ingest.workspace"),
        (["run", "--run", "r"], 2, "no recipe given"),
        (["run", "none.toml", "--run", "r"], 3, "no such recipe"),
        (["run", "tblock", "--run", "r", "--set", "train.speed=1"], 2, "train.speed: unknown setting"),
        (["run", "tblock", "--run", "r", "--until", "fly"], 2, "no stage fly"),
        (["status", "--run", "r"], 2, "not a run folder"),
        (["hands", "--run", "r"], 2, "not a run folder"),
        (["report", "--run", "r"], 2, "not a run folder"),
        (["ingest", "--run", "r", "--workspace", "1,0,0,1,0,1"], 2, "xmin 1 is not below xmax 0"),
        (["ingest", "--run", "r", "--recording", "none"], 3, "no such recording folder"),
        (["simulate", "moon", "--out", "r"], 2, "'moon' is not one of 'tblock', 'rope-stiff'"),
        (["simulate"], 2, "Missing argument 'ENVIRONMENT'"),
        (["doctor", "--fetch", "moon"], 2, "unknown weights moon"),
        (["list", "moons"], 2, "'moons' is not one of 'models'"),
    ],
)
def test_mistakes_end_with_their_code_one_message_and_no_traceback(tmp_path, arguments, code, message):
    done = piegraph(*arguments, check=code, cwd=tmp_path)
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("recipe.toml"))


def test_a_mistake_ends_the_process_with_its_code(tmp_path):
    done = in_process("status", "--run", "r", check=2, cwd=tmp_path)
    assert done.stderr.startswith("error: r: not a run folder")


def test_lists_of_names():
    found = piegraph_json("list")
    assert {kind: set(names) for kind, names in found.items()} == {kind: set(names()) for kind, names in KINDS.items()}
    assert all(text and not text.startswith("#") for names in found.values() for text in names.values())
    assert piegraph_json("list", "recipes") == {"recipes": found["recipes"]}
    lines = piegraph("list", "models").stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(found["models"])


def test_every_name_has_a_line():
    from piegraph_cli.dynamics.models import MODELS
    from piegraph_cli.environments import ENVIRONMENTS
    from piegraph_cli.experiments.recipes import names
    from piegraph_cli.workspace.recipe import shipped

    assert list(KINDS["models"]()) == list(MODELS)
    assert list(KINDS["environments"]()) == list(ENVIRONMENTS)
    assert list(KINDS["recipes"]()) == shipped()
    assert sorted(KINDS["experiments"]()) == sorted([*names(), "troubles"])
