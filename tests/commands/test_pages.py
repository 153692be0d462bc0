"""Every command of README.md and docs/, word by word and run: long ones at a small size, in a user's folder."""

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer

from piegraph_cli.commands.program import GROUPS, app
from piegraph_cli.dynamics import choosing, own_block
from piegraph_cli.dynamics.tuning import KINDS
from piegraph_cli.recording.boards import Board
from piegraph_cli.recording.points import write_points
from piegraph_cli.workspace.artifact import read_artifact
from tests.cli import REPOSITORY, SAMPLE
from tests.commands.inside import piegraph, piegraph_json
from tests.recording.board_scene import RIG, picture, pose, record
from tests.recording.test_robot_files import BASE, GRIPPER, held, poses, table, to_robot

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
SMALL = {"train": ("--steps", "30", "--hidden", "8", "--layers", "2")}
FEW = ("--sequences", "1", "--strokes", "1", "--jobs", "1")
ONE = ("--envs", "tblock", "--goals", "1", "--seeds", "1", "--strokes", "1")
TINY = [
    *("simulate.sequences=4", "simulate.strokes=1", "dataset.train=2", "dataset.validation=1"),
    *("train.piegraph.steps=10", "train.piegraph.hidden=8", "train.piegraph.layers=2"),
    *("evaluate.horizons=[1]", "plan.samples=8", "plan.cem_iterations=1", "plan.strokes=1", "plan.episodes=1"),
]
SIZES: dict[str, tuple[str, ...]] = {
    r"run (tblock|tshirt)": ("--jobs", "1", *(word for setting in TINY for word in ("--set", setting))),
    r"train .*--model pgnd": ("--steps", "2"),
    r"train (?!.*--model)": SMALL["train"],
    r"simulate .*--trouble": (*FEW, "--cameras", "2"),
    r"simulate .*--render": (*FEW, "--cameras", "1"),
    r"simulate": FEW,
    r"plan .*--env": ("--samples", "8", "--cem-iterations", "1", "--strokes", "1"),
    r"trials .*--look": (*ONE, "--models", "piegraph"),
    r"trials": (*ONE, "--models", "static,piegraph"),
}
"""What makes the first command that it fits small: of options given twice the last counts."""
BOARDS = {
    r"calibrate .*--intrinsics": "several",
    r"calibrate .*--board grid": "tags",
    r"calibrate .*--robot": "gripper",
    r"calibrate .*--table": "tilted",
    r"calibrate .*(--touched|--sequence board --columns)": "flat",
}
"""Which recording of boards stands for the user's."""
ELSEWHERE = {
    r"view|serve": "serves until it is interrupted: tests/viewer, tests/service",
    r"record|look .*--live": "needs cameras: tests/capture",
    r"\w+ .*daxbench": "needs DaXBench: tests/environments/test_daxbench.py, tests/stages/test_steps.py",
    r"--install-completion": "changes the shell",
    r"reproduce": "hours; small ones: tests/test_experiments.py",
    r"doctor --fetch": "needs the network",
    r"hands .*--source": "needs a recording with a stick or a glove: tests/stages/test_end_effectors.py",
    r"train .*--outline": "needs an outline: tests/dynamics",
    r"bench": "measures for minutes: tests/bench",
}
"""Commands that cannot be run here, and where their tests are."""


def commands(page: Path) -> list[list[str]]:
    """What the code blocks of a page say, each line that calls piegraph as a list of words."""
    blocks = re.findall(r"^```\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    lines = [line.split(" #")[0].strip() for block in blocks for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("piegraph ")]


def fits(table: dict, words: list[str]):
    """What a table has for a command; None where it has nothing."""
    line = " ".join(words)
    return next((value for pattern, value in table.items() if re.match(pattern, line)), None)


TILTED = [
    pose([0.9 * np.cos(t), 0.9 * np.sin(t), 0.2 * t], [0.1 * np.cos(3 * t), 0.1 * np.sin(2 * t), 0.08 + 0.12 * (k % 3)])
    for k, t in enumerate(np.linspace(0, 4 * np.pi, 20, endpoint=False))
]
SHEETS = {
    "flat": (Board(7, 5, 0.04, 0.03), {"board": [np.eye(4)]}),
    "tags": (Board(6, 6, 0.1144, 0.088, "DICT_APRILTAG_36h11", kind="grid"), {"board": [np.eye(4)]}),
    "several": (Board(7, 5, 0.04, 0.03), {"board1": [np.eye(4), *TILTED[:10]], "board2": TILTED[10:]}),
    "gripper": (Board(7, 5, 0.04, 0.03), {"hand": held()}),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, sample_run: Path, tiny_run: Path) -> Path:
    """What a user has who followed the pages: a recording, runs of it, boards, a cloud now and one to reach."""
    made = tmp_path_factory.mktemp("user")
    for name in ("pipelines", "sample_data"):
        (made / name).symlink_to(REPOSITORY / name)
    for name in ("my_recording", "tilted"):
        shutil.copytree(SAMPLE, made / name)
    cameras = json.loads((made / "my_recording" / "cameras.json").read_text())
    (made / "my_recording" / "cameras.json").write_text(json.dumps(cameras | {"T_world_robot": BASE.tolist()}))
    for name, of in {"demo": sample_run, "mine": sample_run, "x": sample_run, "tblock": tiny_run}.items():
        shutil.copytree(of, made / "runs" / name)
    for name, (board, sequences) in SHEETS.items():
        for sequence, places in sequences.items():
            images = [[picture(RIG[k], board, T) for T in places] for k in (0, 1)]
            record(made / name, images, (0, 1), sequence, posed=name in ("flat", "gripper"))
    corners = SHEETS["flat"][0].corners()[[0, 5, 18, 23]]
    rows = [[*p, c] for p, c in zip(to_robot(corners), (0, 5, 18, 23), strict=True)]
    table(made / "points.csv", "x,y,z,corner", rows)
    poses(made / "poses.csv", GRIPPER)
    cloud = read_artifact(sample_run / "clouds" / "sequence_0000.h5", "clouds")
    points = cloud["points"][: cloud["offsets"][1]]
    write_points(made / "now.ply", points)
    write_points(made / "goal.ply", points + np.float32([0.05, 0.02, 0]))
    (made / "takes").mkdir()
    tracks = read_artifact(sample_run / "tracks" / "sequence_0000.h5", "tracks")
    hand = np.nan_to_num(tracks["end_effector"], nan=0.4)
    np.savez(made / "takes" / "one.npz", positions=tracks["positions"], end_effector=hand, time=tracks["time"])
    return made


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch):
    """Priors learn, and are compared, for a few steps: no option makes them shorter."""
    monkeypatch.setattr(own_block, "SIMULATED", 80)
    monkeypatch.setattr(choosing, "STEPS", 10)
    monkeypatch.setitem(KINDS, "blocks", replace(KINDS["blocks"], steps=20, compared=6))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_the_pages_runs(page: Path, folder: Path, brief: None):
    """In the order of the page; what an earlier command made is there for a later one."""
    for words in commands(page):
        if fits(ELSEWHERE, words):
            continue
        recording = fits(BOARDS, words)
        words = [word.replace("my_recording", recording) if recording else word for word in words]
        piegraph(*words, *(fits(SIZES, words) or ()), cwd=folder)


def stage_by_stage() -> list[list[str]]:
    """The path of docs/train.md from `ingest` to `report`."""
    found = commands(REPOSITORY / "docs" / "train.md")
    names = [words[0] for words in found]
    return found[names.index("ingest") : names.index("report") + 1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_the_pages_is_understood(page):
    """Options by their names, and values of a kind that fits: the rest shows when they are run."""
    program, found = typer.main.get_command(app), commands(page)
    assert page.name != "train.md" or len(found) > 15
    for words in found:
        if words[0] in [name for option in program.params for name in option.opts]:
            continue
        assert any(words[0] in group for group in GROUPS.values()), words
        command = program.commands[words[0]]
        with command.make_context(words[0], [w for w in words[1:] if w != "…"]) as context:
            assert context.params, words


def test_from_a_recording_to_pictures_stage_by_stage(sample_run, tmp_path):
    """What costs minutes is taken from a run of the same settings and must be found fresh. `score` may be left out."""
    path = stage_by_stage()
    assert [words[0] for words in path] == [
        *("ingest", "hands", "segment", "fuse", "track", "score", "dataset", "train", "evaluate", "report")
    ]
    folder = tmp_path / "runs" / "mine"
    for artifact in ("frames", "hands", "masks", "clouds", "tracks"):
        shutil.copytree(sample_run / artifact, folder / artifact)
    names = {"my_recording": str(SAMPLE), "runs/mine": str(folder), "4": "2"}
    done = {}
    for words in path:
        if words[0] == "score":
            continue
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
