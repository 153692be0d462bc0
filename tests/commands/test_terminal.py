"""Tables: drawn on a terminal, plain in files and pipes; what `doctor` and `status` say; counted words; pasted commands."""

import os
import pty
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

from piegraph_cli import doctor
from piegraph_cli.doctor import Check, check_machine
from piegraph_cli.errors import command_line
from piegraph_cli.text import Column, Table, counted, plain
from tests.commands.inside import envelope, piegraph, piegraph_json

LONG = "a cell that is longer than a narrow terminal is wide [1.00, 2.00]"
SMALL = Table([Column("model", 6), Column("error", 6, right=True)], [("static", "12.5"), ("a longer name", "-")])


def on_a_terminal(code: str, **environment: str) -> str:
    """What code prints when stdout is a terminal of 60 columns."""
    parent, child = pty.openpty()
    kept = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR")}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=child, env=kept | {"TERM": "xterm", "COLUMNS": "60"} | environment
    )
    os.close(child)
    said = b""
    try:
        while part := os.read(parent, 65536):
            said += part
    except OSError:  # the other end is closed
        pass
    os.close(parent)
    assert process.wait() == 0
    return said.decode().replace("\r\n", "\n")


SHOW = f"""
from piegraph_cli.commands.output import _show
from piegraph_cli.text import Column, Table
_show(["before", Table([Column("unit"), Column("state"), Column("why")], [("s0", "failed", {LONG!r})])])
"""


def test_a_table_is_drawn_on_a_terminal_and_no_word_is_lost():
    text = on_a_terminal(SHOW)
    assert "\x1b[31mfailed" in text
    bare = re.sub(r"\x1b\[[0-9;]*m", "", text)
    assert max(map(len, bare.splitlines())) <= 60
    assert "─" in bare
    words = bare.split()
    assert [word for word in words if word in LONG.split()] == LONG.split()
    assert "\x1b[3" not in on_a_terminal(SHOW, NO_COLOR="1"), "no colour"


def test_a_table_is_plain_elsewhere():
    done = subprocess.run([sys.executable, "-c", SHOW], capture_output=True, text=True, check=True)
    assert done.stdout == f"before\nunit state  why\ns0   failed {LONG}\n"


def test_columns_are_as_wide_as_they_must_be_and_no_narrower_than_asked_for():
    assert SMALL.plain() == ["model          error", "static          12.5", "a longer name      -"]
    assert Table([Column("", 4), Column()], [("a", "b")], gap=2).plain() == ["a     b"]
    assert Table([Column("", 4)], []).plain() == []
    assert plain(["x", SMALL, "y"])[::3] == ["x", "a longer name      -"]


def test_counted_words():
    assert [counted(k, "stroke") for k in range(3)] == ["0 strokes", "1 stroke", "2 strokes"]


def test_commands_can_be_pasted():
    command = command_line("run", "--run", "my runs/it's", "--set", "a=1,2")
    assert shlex.split(command) == ["piegraph", "run", "--run", "my runs/it's", "--set", "a=1,2"]
    assert command_line("train", "--model", "gnn@1", "--seed", 0) == "piegraph train --model gnn@1 --seed 0"


@pytest.fixture
def packages(monkeypatch):
    """Three packages are all there is; what importing one says comes from here."""
    monkeypatch.setattr(doctor, "NEEDED", ("json", "killer", "csv"))
    monkeypatch.setattr(doctor, "OPTIONAL", {"no_such_package": "sim"})
    monkeypatch.setattr(doctor, "WITH_TORCH", 2)
    code = doctor.IMPORT.replace("    try:", "    if name == 'killer':\n        import os; os._exit(3)\n    try:", 1)
    monkeypatch.setattr(doctor, "IMPORT", code.replace("import torch", "torch = 1 / 0"))


def test_doctor_tells_needed_from_optional(packages):
    checks = {check.name: check for check in check_machine()}
    assert [check.needed for check in checks.values()] == sorted((c.needed for c in checks.values()), reverse=True)
    assert (checks["json"].ok, checks["csv"].ok, checks["killer"].ok) == (True, True, False)
    assert checks["killer"].detail.startswith("importing it ended the process; on Debian")
    assert (checks["no_such_package"].ok, checks["no_such_package"].needed) == (False, False)
    assert checks["no_such_package"].detail == (
        "ModuleNotFoundError: No module named 'no_such_package'; pip install 'piegraph[sim]'"
    )
    assert not checks["cuda"].ok
    assert not checks["cuda"].needed


def test_what_doctor_prints(monkeypatch):
    good = [Check("torch", True, True, "torch 2"), Check("viser", False, False, "pip install 'piegraph[view]'")]
    monkeypatch.setattr("piegraph_cli.doctor.check_machine", lambda: good)
    assert piegraph("doctor").stdout.splitlines() == [
        "needed",
        "ok       torch                    torch 2",
        "",
        "optional",
        "missing  viser                    pip install 'piegraph[view]'",
        "",
        "all that is needed is there",
    ]
    assert [row["needed"] for row in piegraph_json("doctor")["checks"]] == [True, False]
    bad = [Check("torch", False, True, "pip install torch"), *good[1:]]
    monkeypatch.setattr("piegraph_cli.doctor.check_machine", lambda: bad)
    assert piegraph("doctor", check=4).stdout.splitlines()[-1] == "torch: needed, and missing"
    found = envelope("doctor", check=4)
    assert (found["error"]["kind"], found["error"]["try"]) == ("missing", "pip install torch")
    assert found["result"]["checks"][0]["ok"] is False


@pytest.mark.parametrize(
    "command",
    [
        ("simulate", "toy", "--out", "r", "--sequences", 1),
        ("simulate", "toy", "--render", "--out", "r"),
        ("hands", "--run", "r"),
        ("run", "tblock", "--run", "r"),
        ("reproduce", "table1", "--quick", "--runs", "r"),
    ],
)
def test_a_gpu_that_is_not_there_is_refused_before_anything_is_done(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    done = piegraph(*command, "--device", "cuda", check=4)
    assert done.stderr == (
        "error: --device cuda: PyTorch finds no CUDA device\n  try: leave --device out, or use --device cpu\n"
    )
    assert not list(tmp_path.iterdir())


def following(folder, monkeypatch, *states):
    """What `status` says is next, where stages are in these states."""
    rows = [
        {"stage": stage, "unit": "s0", "artifact": "a", "bytes": 0, "state": state, "quality": "", "reason": ""}
        | {"failure": why}
        for stage, state, why in states
    ]
    monkeypatch.setattr("piegraph_cli.workspace.survey.status", lambda run: rows)
    return piegraph_json("status", "--run", folder)["next"]


def test_status_says_what_to_do_next(tmp_path, monkeypatch):
    folder = tmp_path / "a run"
    folder.mkdir()
    (folder / "recipe.toml").write_text("[simulate]\n")
    whole = f"piegraph run --run '{folder}'"
    fresh, hands = ("ingest", "fresh", ""), f"piegraph hands --run '{folder}'"
    simulate = ("simulate", "missing", "")
    assert following(folder, monkeypatch, simulate, ("dataset", "missing", "")) == [f"{whole} --until simulate", whole]
    assert following(folder, monkeypatch, fresh, ("hands", "stale", "")) == [hands]
    failed = ("hands", "failed", "it is dark\n  try: more light")
    assert following(folder, monkeypatch, fresh, failed) == [f"more light, then {hands}"]
    missing = ("dataset", "missing", "")
    told = following(folder, monkeypatch, fresh, ("hands", "failed", "dark\n  try: piegraph doctor"), missing)
    assert told == ["piegraph doctor", f"piegraph dataset --run '{folder}'"]
    assert following(folder, monkeypatch, fresh, ("hands", "failed", "dark"))[0] == hands
    assert following(folder, monkeypatch, fresh) == [
        f"piegraph report --run '{folder}'",
        f"piegraph view --run '{folder}'",
    ]
    last = piegraph("status", "--run", folder).stdout.splitlines()[-2:]
    assert [line.partition(":")[0] for line in last] == ["next", "or"]


def test_units_are_listed_in_the_order_of_the_pipeline(tiny_run):
    """Also those whose results read alike."""
    lines = piegraph("status", "--run", tiny_run, "--units").stdout.split("\n\n")[1].splitlines()
    units = [line.split()[1] for line in lines if line.startswith("simulate")]
    assert units == [f"sequence_000{k}" for k in range(4)]


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (("import", "none.npz"), 3),
        (("import", "few.npz"), 3),
        (("ingest", "--recording", "none"), 3),
        (("plan", "--env", "tblock", "--goal-pose", "50,0,0", "--model", "static"), 2),
    ],
)
def test_a_stage_that_fails_leaves_no_new_folder(command, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("few.npz", positions=np.zeros((1, 3, 3)), time=np.zeros(1))
    piegraph(*command, "--run", "r", check=code)
    assert [path.name for path in tmp_path.iterdir()] == ["few.npz"]
