"""The public face: what docs/python.md says, and that it answers lightly and without a second way."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import piegraph_cli
from piegraph_cli import Model, Strokes, load_model, open_run, read_artifact, save_model, sequences
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.planning.goals import GOAL_POINTS, thinned
from tests.cli import REPOSITORY, piegraph_json

EXAMPLES = re.findall(r"```python\n(.*?)```", (REPOSITORY / "docs" / "python.md").read_text(), re.S)


@pytest.fixture(scope="module")
def mine(sample_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose runs/mine is the demo's run."""
    folder = tmp_path_factory.mktemp("face")
    shutil.copytree(sample_run, folder / "runs" / "mine")
    (folder / "sample_data").symlink_to(REPOSITORY / "sample_data")
    return folder


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_the_examples_of_the_page_run(mine, monkeypatch, capsys, number):
    monkeypatch.chdir(mine)
    exec(compile(EXAMPLES[number], f"docs/python.md example {number}", "exec"), {})
    assert capsys.readouterr().out.strip()


def test_every_name_is_there_and_the_package_imports_nothing_heavy():
    assert set(piegraph_cli.__all__) == {*piegraph_cli._FACE, "__version__"}
    for name in piegraph_cli._FACE:
        assert getattr(piegraph_cli, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = piegraph_cli.nothing
    code = "import sys, piegraph_cli; print([m for m in ('torch', 'numpy', 'h5py', 'pydantic') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert (Path(piegraph_cli.__file__).parent / "py.typed").is_file()


def test_a_model_of_a_file_is_the_model_of_the_run(tiny_run, tmp_path):
    file = tmp_path / "model of mine.h5"
    save_model(tiny_run, file)
    ours, theirs = load_model(tiny_run), load_model(file)
    assert (theirs.label, theirs.particles, theirs.settings) == (ours.label, ours.particles, ours.settings)
    now = open_run(tiny_run).read("tracks", "sequence_0000")["positions"][0]
    strokes = Strokes.of([[-0.2, 0.0]], [[-0.02, 0.0]], 0)
    np.testing.assert_array_equal(ours.predict(now, strokes), theirs.predict(now, strokes))
    assert load_model(file, "piegraph-ng").label == "piegraph-ng"
    with pytest.raises(DataError, match="piegraph-ng is what piegraph has learned"):
        save_model(tiny_run, file, "piegraph-ng")
    with pytest.raises(DataError, match="holds seed 0, not 1"):
        load_model(file, seed=1)
    with pytest.raises(DataError, match="holds piegraph, not pgnd"):
        load_model(file, "pgnd")
    assert read_artifact(file).key == read_artifact(tiny_run / "model" / "piegraph.seed0.h5").key


def test_python_and_the_command_plan_the_same(tiny_run, tmp_path):
    now = open_run(tiny_run).read("tracks", "sequence_0000")["positions"][0]
    np.savez(tmp_path / "now.npz", now)
    question = ("--run", tiny_run, "--state", tmp_path / "now.npz", "--goal-pose", "0.1,0,0.5")
    run = tmp_path / "run"
    shutil.copytree(tiny_run, run)
    (row,) = piegraph_json("plan", "--run", run, *question[2:])["strokes"]
    plan = load_model(tiny_run).plan(now, goal_pose=(0.1, 0, 0.5))
    assert plan.strokes is not None
    np.testing.assert_allclose(plan.strokes.ends[0].numpy(), [row["start"], row["end"]], atol=1e-7)
    assert plan.steps[0].plan.cost == pytest.approx(row["predicted_distance"])
    spelled = load_model(tiny_run).plan(now, goal_pose="0.1,0,0.5")
    np.testing.assert_array_equal(spelled.strokes.ends, plan.strokes.ends)


def test_a_prediction_for_one_state_or_one_for_each_stroke(tiny_run):
    model = load_model(tiny_run)
    now = open_run(tiny_run).read("tracks", sequences(open_run(tiny_run))[0])["positions"][0]
    strokes = Strokes.of([[-0.2, 0.0], [0.0, 0.2]], [[-0.02, 0.0], [0.0, 0.02]], 0)
    np.testing.assert_array_equal(model.predict(now, strokes), model.predict(np.stack([now, now]), strokes, rest=now))
    still = Model("static", None).predict(now, strokes)
    np.testing.assert_array_equal(still, np.stack([now, now]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal_pose": None}, "one goal is needed"),
        ({"goal": [[0.0, 0, 0]]}, "one goal is needed"),
        ({"goal_pose": (5.0, 0, 0)}, "outside plan.workspace"),
        ({"state": np.zeros((10, 3))}, "the model needs 50 or more"),
        ({"state": np.full((60, 3), np.nan)}, "not finite points"),
        ({"state": np.zeros((60, 2))}, "not finite points"),
        ({"smaples": 3}, "plan.smaples: unknown setting"),
        ({"samples": 1}, "plan.samples"),
        ({"goal_pose": (0.1, 0, 90)}, "90 degrees are 1.571"),
    ],
)
def test_what_cannot_be_planned_is_said(tiny_run, change, message):
    now = open_run(tiny_run).read("tracks", "sequence_0000")["positions"][0]
    given = {"state": now, "goal_pose": (0.1, 0, 0)} | change
    with pytest.raises((DataError, UsageError), match=message):
        load_model(tiny_run).plan(given.pop("state"), **given)


def test_a_plan_does_not_depend_on_how_dense_the_clouds_are(tiny_run):
    """Ten times as many points as a thinned goal has: nearly the same plan, in the time and memory of the thinned one."""
    model, rng = load_model(tiny_run), np.random.default_rng(0)
    block = rng.uniform([-0.1, -0.1, 0], [0.1, 0.1, 0.035], (GOAL_POINTS, 3)).astype(np.float32)
    goals = block + np.float32([0.1, 0, 0]), np.repeat(block, 10, 0) + np.float32([0.1, 0, 0])
    thin, dense = (model.plan(block, goal=goal, horizon=1) for goal in goals)
    assert dense.start_distance == pytest.approx(thin.start_distance, abs=1e-3)
    assert dense.steps[0].plan.cost == pytest.approx(thin.steps[0].plan.cost, abs=2e-3)
    assert len(thinned(goals[1], GOAL_POINTS)) == GOAL_POINTS
    assert thinned(goals[0], GOAL_POINTS) is goals[0]


def test_wrong_predictions_are_refused(tiny_run):
    model, now = load_model(tiny_run), np.zeros((50, 3), np.float32)
    one = Strokes.of(torch.zeros(1, 2), torch.ones(1, 2), 0)
    with pytest.raises(DataError, match="for 1 strokes"):
        model.predict(np.zeros((2, 50, 3)), one)
    with pytest.raises(DataError, match="for 0 strokes"):
        model.predict(now, one[:0])
    with pytest.raises(DataError, match="no heading"):
        model.predict(now, Strokes.of(torch.zeros(1, 2), torch.zeros(1, 2), 0))
    with pytest.raises(DataError, match="not finite"):
        model.predict(now * np.nan, one)
