"""Trials: the grid and its keys, what is done once and what again, failures of single trials, the command line."""

import json
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.evaluation.metrics import chamfer_distance
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_stage
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.cli import PROGRAM, piegraph, piegraph_json
from tests.report.page import Page

STAGE = STAGES["trials"]
SMALL = {"envs": ["tblock"], "models": ["piegraph", "static"], "goals": 1, "seeds": 2, "strokes": 2}
KILLER = Path(__file__).parents[1] / "killer.py"


@pytest.fixture
def runs(tiny_run, tmp_path):
    """A folder with a trained run of the T-block; runs of trials go beside it."""
    folder = tmp_path / "runs"
    (folder / "tblock").mkdir(parents=True)
    shutil.copytree(tiny_run / "model", folder / "tblock" / "model")
    shutil.copy(tiny_run / "recipe.toml", folder / "tblock")
    return folder


def play(folder, **settings):
    """States of the grid's trials by name, after running what is not fresh."""
    outcomes = run_stage(Run(folder, Recipe(STAGES, {"trials": SMALL | settings})), STAGE, Options())
    return {o.unit: o.state for o in outcomes}, {o.unit: o.error for o in outcomes if o.error}


def keys(folder, **settings):
    run = Run(folder, Recipe(STAGES, {"trials": SMALL | settings}))
    return {name: run.key(STAGE, name) for name in run.units(STAGE)}


def test_a_larger_grid_keeps_what_is_done(runs):
    states, failed = play(runs / "paper")
    assert not failed
    assert set(states) == {f"tblock.{model}.goal00.seed0{s}" for model in ("piegraph", "static") for s in (0, 1)}
    assert set(states.values()) == {"done"}
    assert set(play(runs / "paper")[0].values()) == {"cached"}
    larger = {"goals": 2, "seeds": 3, "models": ["static", "piegraph-ng", "piegraph"], "thresholds": [0.3, 0.02]}
    again, _ = play(runs / "paper", **larger)
    assert {name for name, state in again.items() if state == "cached"} == set(states)
    assert len(again) == 18


def test_every_model_meets_the_same_start_and_goal_and_distances_are_kept(runs):
    play(runs / "paper")
    found = {p.stem: read_artifact(p, "trials") for p in (runs / "paper" / "trials").glob("*.h5")}
    one, other = found["tblock.piegraph.goal00.seed00"], found["tblock.static.goal00.seed00"]
    np.testing.assert_array_equal(one["before"][0], other["before"][0])
    np.testing.assert_array_equal(one["goal"], other["goal"])
    assert not np.array_equal(one["before"][0], found["tblock.static.goal00.seed01"]["before"][0])
    for trial in found.values():
        states = [*trial["before"], trial["after"][-1]]
        np.testing.assert_allclose(
            trial["pd"], [np.linalg.norm(x - trial["goal"], axis=-1).mean() for x in states], atol=1e-6
        )
        assert trial["cd"][-1] == pytest.approx(chamfer_distance(states[-1], trial["goal"]) / 100)
        assert trial["pd"][-1] == pytest.approx(float(trial["end_distance"]), abs=1e-6)
        assert trial["candidate_cost"].shape[:1] == trial["mode"].shape


@pytest.mark.parametrize(
    ("settings", "changes"),
    [
        ({"strokes": 3}, True),
        ({"thresholds": [0.01, 0.05]}, True),
        ({"thresholds": [0.02, 0.4]}, False),
        ({"goals": 4, "seeds": 4, "models": ["static", "piegraph", "kabsch"], "envs": ["tshirt", "tblock"]}, False),
        ({"options": {"tblock.friction": 0.3}}, True),
        ({"options": {"friction": "0.3"}}, True),
        ({"options": {"tshirt.friction": 0.3}}, False),
        ({"daxbench_python": "/usr/bin/python3"}, False),
        ({"fixed_goals": True}, True),
        ({"fixed_goals": False}, False),
    ],
)
def test_the_key_of_a_trial_depends_on_its_own_settings_alone(runs, settings, changes):
    before, after = keys(runs / "paper"), keys(runs / "paper", **settings)
    assert all((after[name] != key) == changes for name, key in before.items())


def test_keys_follow_the_network_and_the_planning_settings_of_the_trained_run(runs, tmp_path):
    before = keys(runs / "paper")
    shutil.copytree(runs, tmp_path / "moved")
    assert keys(tmp_path / "moved" / "paper") == before
    assert keys(tmp_path / "elsewhere" / "paper", trained=str(runs)) == before
    text = (runs / "tblock" / "recipe.toml").read_text()
    (runs / "tblock" / "recipe.toml").write_text(text.replace("samples = 12", "samples = 13"))
    assert all(key != before[name] for name, key in keys(runs / "paper").items())
    (runs / "tblock" / "recipe.toml").write_text(
        text.replace('env = "tblock"', 'env = "tblock"\nepisodes = 5\nseed = 8')
    )
    assert keys(runs / "paper") == before
    (runs / "tblock" / "model" / "piegraph.seed0.h5").unlink()
    assert {name for name, key in keys(runs / "paper").items() if key != before[name]} == {
        name for name in before if "piegraph" in name
    }


def test_starts_take_turns_with_the_seeds_of_the_trained_run(runs):
    text = (runs / "tblock" / "recipe.toml").read_text()
    (runs / "tblock" / "recipe.toml").write_text(text.replace("[train]", "[train]\nseeds = [4, 7]"))
    run = Run(runs / "paper", Recipe(STAGES, {"trials": SMALL | {"models": ["piegraph-ng@20", "sms-no"], "seeds": 3}}))
    found = [run.settings(STAGE, name).network for name in run.units(STAGE)]
    names = [f"piegraph@20.seed{seed}.h5" for seed in (4, 7, 4)]
    assert [path and path.name for path in found] == [n for name in names for n in (name, None)]


def test_goals_of_another_kind_are_rows_of_their_own(runs):
    settings = {"envs": ["tshirt", "tshirt:crumpled"], "models": ["static"], "options": {"tshirt.young": 2e4}}
    run = Run(runs / "paper", Recipe(STAGES, {"trials": SMALL | settings}))
    names = [f"{task}.static.goal00.seed0{s}" for task in settings["envs"] for s in (0, 1)]
    assert run.units(STAGE) == names
    moved, crumpled = (run.settings(STAGE, name).plan for name in names[::2])
    assert (moved.env, crumpled.env) == ("tshirt", "tshirt")
    assert (moved.options, crumpled.options) == ({"young": 2e4}, {"young": 2e4, "goal": "crumpled"})
    assert isinstance(STAGE.check(run, names, 1), list)  # what is checked before the first trial knows tasks too
    assert run.key(STAGE, names[0]) != run.key(STAGE, names[2])
    recipe = Recipe(STAGES, {"trials": SMALL | {"envs": ["tshirt"], "models": ["static"], "options": {"young": 2e4}}})
    alone = Run(runs / "paper", recipe)
    assert alone.key(STAGE, names[0]) == run.key(STAGE, names[0])


def test_goals_in_place_are_played(runs):
    assert set(play(runs / "paper", models=["static"], seeds=3, fixed_goals=True)[0].values()) == {"done"}
    found = [read_artifact(p, "trials") for p in sorted((runs / "paper" / "trials").glob("*.h5"))]
    assert len(found) == 3
    for one in found[1:]:
        np.testing.assert_array_equal(one["goal"], found[0]["goal"])
        assert not np.array_equal(one["before"][0], found[0]["before"][0])


def test_greedy_is_a_planner_without_a_network(runs):
    run = Run(runs / "paper", Recipe(STAGES, {"trials": SMALL | {"envs": ["tshirt"], "models": ["greedy"]}}))
    params = run.settings(STAGE, "tshirt.greedy.goal03.seed12")
    assert (params.goal, params.seed, params.network) == (3, 12, None)
    assert (params.plan.planner, params.plan.model, params.plan.env) == ("greedy", "static", "tshirt")


def test_a_network_that_is_not_trained_fails_its_trials_alone(runs):
    (runs / "tblock" / "model" / "piegraph.seed0.h5").rename(runs / "kept.h5")
    states, failed = play(runs / "paper")
    assert {name.split(".")[1] for name, state in states.items() if state == "failed"} == {"piegraph"}
    assert {name.split(".")[1] for name, state in states.items() if state == "done"} == {"static"}
    error = failed["tblock.piegraph.goal00.seed00"]
    assert isinstance(error, DataError)
    assert "piegraph is not trained for tblock" in str(error)
    assert f"piegraph run tblock --run {runs}/tblock" in str(error)
    assert (
        "is not trained"
        in json.loads((runs / "paper" / "failures.json").read_text())["trials/tblock.piegraph.goal00.seed01"]["message"]
    )
    (runs / "kept.h5").rename(runs / "tblock" / "model" / "piegraph.seed0.h5")
    states, _ = play(runs / "paper")
    assert {name.split(".")[1] for name, state in states.items() if state == "done"} == {"piegraph"}
    assert json.loads((runs / "paper" / "failures.json").read_text()) == {}


def test_a_simulation_that_diverges_fails_its_trial_and_the_rest_goes_on(runs, monkeypatch):
    from piegraph_cli.environments.tblock import TBlock

    push, reset, resets = TBlock._push, TBlock.reset, []

    def count(self, **options):
        resets.append(1)
        return reset(self, **options)

    def diverge(self, start, end):
        motion = push(self, start, end)
        if len(resets) == 2:
            motion.shapes[-1] = np.nan
        return motion

    monkeypatch.setattr(TBlock, "reset", count)
    monkeypatch.setattr(TBlock, "_push", diverge)
    states, failed = play(runs / "paper", models=["static"], seeds=3)
    assert list(states.values()) == ["done", "failed", "done"]
    assert "the simulation diverged" in str(failed["tblock.static.goal00.seed01"])
    run = open_run(runs / "paper", Recipe(STAGES, {"trials": SMALL | {"models": ["static"], "seeds": 3}}))
    assert run.state(STAGE, "tblock.static.goal00.seed01") == "failed"


def limited():
    """No file beyond 16 kB, for the child process: what a full disk does to a trial."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16 << 10, 16 << 10))


def test_a_full_disk_keeps_what_is_done_and_the_next_run_goes_on(runs):
    command = [
        "trials",
        "--run",
        runs / "paper",
        "--envs",
        "tblock",
        "--models",
        "static",
        "--seeds",
        2,
        "--strokes",
        12,
    ]
    piegraph(*command, "--goals", 1)
    done = {path: path.stat().st_mtime_ns for path in (runs / "paper" / "trials").iterdir()}
    program = [*PROGRAM, *map(str, command), "--goals", "2", "--jobs", "2"]
    full = subprocess.run(program, capture_output=True, text=True, preexec_fn=limited)
    assert full.returncode == 3, full.stderr
    assert "failed on tblock.static.goal01.seed00: " in full.stderr
    assert "cannot be written" in full.stderr
    assert "failed: tblock.static.goal01.seed00, tblock.static.goal01.seed01" in full.stdout
    assert {path: path.stat().st_mtime_ns for path in (runs / "paper" / "trials").iterdir()} == done
    piegraph(*command, "--goals", 2)
    after = {path: path.stat().st_mtime_ns for path in (runs / "paper" / "trials").iterdir()}
    assert len(after) == 4
    assert done.items() <= after.items()


def test_killed_trials_go_on(runs):
    arguments = ["trials", "--run", runs / "paper", "--envs", "tblock", "--goals", 1, "--seeds", 2, "--strokes", 2]
    command = [sys.executable, KILLER, "3", *map(str, arguments)]
    assert subprocess.run(command, capture_output=True).returncode == -signal.SIGKILL
    whole = sorted(path.name for path in (runs / "paper" / "trials").glob("*.h5"))
    assert len(whole) == 2
    found = piegraph_json(*arguments)
    assert [row["trials"] for row in found["results"]] == [2, 2, 2]
    assert not list(runs.rglob("*.tmp"))
    others = Run(runs / "other", Recipe(STAGES, {"trials": SMALL | {"models": ["piegraph", "piegraph-ng", "static"]}}))
    run_stage(others, STAGE, Options())
    for path in (others.folder / "trials").iterdir():
        one, other = read_artifact(path, "trials"), read_artifact(runs / "paper" / "trials" / path.name, "trials")
        assert one.key == other.key
        assert all(
            np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f")
            for name in set(one.arrays) - {"seconds"}
        )


def test_the_command_prints_one_object_and_the_report_has_plots(runs):
    arguments = ["--models", "piegraph,static", "--goals", 1, "--seeds", 3, "--strokes", 3, "--envs", "tblock"]
    found = piegraph_json("trials", "--run", runs / "paper", *arguments, "--jobs", 2)
    assert [(row["environment"], row["model"], row["trials"]) for row in found["results"]] == [
        ("tblock", "piegraph", 3),
        ("tblock", "static", 3),
    ]
    assert [s["below"] for s in found["results"][0]["success"]] == [0.02, 0.03, 0.05, 0.1]
    (row,) = found["cliffs_delta"]
    assert (row["first"], row["second"], row["pairs"]) == ("piegraph", "static", 3)
    assert found["failed"] == []
    rows = piegraph_json("status", "--run", runs / "paper")["artifacts"]
    assert [r["state"] for r in rows] == ["fresh"] * 6
    text = piegraph("run", "--run", runs / "paper").stdout
    assert "tblock.static.goal00.seed02" in text
    found = piegraph_json("report", "--run", runs / "paper")
    ((part, figure),) = [(verdict["part"], verdict["figure"]) for verdict in found["verdicts"]]
    assert part == "trials"
    assert figure.startswith("piegraph solves ")
    page = Page(Path(found["report"]))
    assert len(page.all("svg")) == 3, "boxes, success over thresholds, distance over strokes"
    assert "piegraph" in page.text("tbody")
    assert page.all("article") == []


def test_trials_come_last_in_a_recipe_that_trains():
    simulated = Recipe(STAGES, {"simulate": {}, "trials": {}})
    assert [stage.name for stage in simulated.chain()] == ["simulate", "dataset", "train", "evaluate", "trials"]
    assert [stage.name for stage in Recipe(STAGES, {"trials": {}}).chain()] == ["trials"]
    assert "trials" not in [stage.name for stage in Recipe(STAGES, {"simulate": {}}).chain()]


def test_options_that_an_environment_lacks_are_refused_before_anything_runs(runs):
    with pytest.raises(UsageError, match=r"option young.*tblock|tblock: option young"):
        play(runs / "paper", options={"tblock.young": 3e4})
    assert not (runs / "paper" / "trials").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--envs", "tblock,moon"], "trials.envs.1: Input should be 'tblock'"),
        (["--envs", "tblock:crumpled"], "trials.envs.0: Input should be 'tblock'"),
        (["--models", "oracle"], "trials.models.0"),
        (["--envs", "tblock", "--thresholds", "0"], "trials.thresholds.0: Input should be greater than 0"),
        (["--envs", "tblock", "--options", "young"], "give NAME=VALUE"),
    ],
)
def test_mistakes_end_with_2_and_no_traceback(tmp_path, arguments, message):
    done = piegraph("trials", "--run", tmp_path / "paper", *arguments, check=2)
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_an_environment_whose_package_is_missing_ends_with_4(runs):
    code = "import sys; sys.modules['pymunk'] = None; from piegraph_cli.__main__ import main; main()"
    arguments = [
        "trials",
        "--run",
        runs / "paper",
        "--envs",
        "tblock",
        "--models",
        "static",
        "--goals",
        1,
        "--seeds",
        2,
    ]
    done = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    assert "pip install 'piegraph[sim]'" in done.stderr
    assert "failed: tblock.static.goal00.seed00, tblock.static.goal00.seed01" in done.stdout
