"""The command line: exit codes, messages, JSON, and what --help may import."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from piegraph_cli.stages import STAGES
from tests.cli import piegraph, piegraph_json

COMMANDS = [*STAGES, "run", "status", "report", "calibrate", "view", "doctor", "bench"]


def test_help_imports_nothing_heavy():
    code = "import sys; from piegraph_cli.app import app; print([m for m in sys.modules if '.' not in m])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    heavy = {"torch", "numpy", "h5py", "cv2", "open3d", "mediapipe", "scipy", "matplotlib", "pymunk", "warp"}
    assert not heavy & set(json.loads(loaded.replace("'", '"')))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command):
    assert "Usage: " in piegraph(command, "--help").stdout


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["fly"], 2, "No such command"),
        (["track"], 2, "Missing option"),
        (["track", "--run", "r", "--speed", "3"], 2, "No such option"),
        (
            ["train", "--run", "r", "--steps", "0"],
            2,
            "train.piegraph.steps: Input should be greater than or equal to 1",
        ),
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
        (["simulate", "moon", "--out", "r"], 2, "simulate.environment: Input should be 'tblock'"),
        (["doctor", "--fetch", "moon"], 2, "unknown weights moon"),
    ],
)
def test_mistakes_end_with_their_code_one_message_and_no_traceback(tmp_path, arguments, code, message):
    done = piegraph(*arguments, check=code, cwd=tmp_path)
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_missing_package_names_the_extra(tmp_path):
    code = "import sys; sys.modules['pymunk'] = None; from piegraph_cli.app import main; main()"
    command = [sys.executable, "-c", code, "simulate", "tblock", "--out", str(tmp_path / "r"), "--sequences", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    assert "pip install 'piegraph[sim]'" in done.stderr


def test_status_and_evaluate_as_json(tiny_run):
    rows = piegraph_json("status", "--run", tiny_run)["artifacts"]
    assert {row["state"] for row in rows} == {"fresh"}
    assert [row["stage"] for row in rows if row["sequence"] is None] == ["dataset", "plan"]
    found = piegraph_json("evaluate", "--run", tiny_run)["rows"]
    assert {(row["model"], row["horizon"]) for row in found} >= {("static", 1), ("piegraph", 2)}
    mean, low, high = found[0]["pd"]
    assert mean > 0
    assert low is None, "one held-out sequence has no interval"
    assert high is None


def test_a_second_run_is_all_fresh(tiny_run):
    outcomes = piegraph_json("run", "--run", tiny_run)["outcomes"]
    assert {o["state"] for o in outcomes} == {"cached"}


def test_options_of_a_stage_are_kept_in_the_recipe(tiny_run, tmp_path):
    folder = tmp_path / "a run"
    shutil.copytree(tiny_run, folder)
    piegraph("train", "--run", folder, "--steps", "20", "--no-action-head")
    text = (folder / "recipe.toml").read_text()
    assert "steps = 20" in text
    assert "action_head = false" in text
    states = {row["stage"]: row["state"] for row in piegraph_json("status", "--run", folder)["artifacts"]}
    assert (states["train"], states["evaluate"]) == ("fresh", "stale")


def test_a_further_model_is_trained_beside_the_others(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    command = ("train", "--run", folder, "--model", "gnn@1", "--seed", "0,3", "--steps", "5", "--hidden", "8")
    assert [o["sequence"] for o in piegraph_json(*command)["outcomes"]] == ["gnn@1.seed0", "gnn@1.seed3"]
    states = {r["unit"]: r["state"] for r in piegraph_json("status", "--run", folder)["artifacts"]}
    assert states["piegraph.seed0"] == states["gnn@1.seed3"] == "fresh"
    assert states["piegraph.seed3"] == "missing"
    found = piegraph_json("evaluate", "--run", folder, "--models", "gnn@1,static,sms-no")["rows"]
    assert {(row["model"], row["seeds"]) for row in found} == {("gnn@1", 2), ("static", 1), ("sms-no", 1)}
    refused = piegraph("train", "--run", folder, "--model", "pgnd", "--hidden", "8", check=2)
    assert "train.pgnd.hidden: unknown setting" in refused.stderr
    assert "settings of train.pgnd: learning_rate, " in refused.stderr
    refused = piegraph("train", "--run", folder, "--model", "gnn@50", check=2)
    assert "2 sequences to train on, 50 are asked for" in refused.stderr
    refused = piegraph("train", "--run", folder, "--model", "static", check=2)
    assert "static is not trained" in refused.stderr
    refused = piegraph("train", "--run", folder, "--model", "gnn:wide", check=2)
    assert "no variant gnn:wide" in refused.stderr


@pytest.fixture
def planner(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    (folder / "recipe.toml").write_text((folder / "recipe.toml").read_text().split("[plan]")[0])
    return folder


def test_one_shot_plan_for_a_robot(planner, tmp_path):
    cloud = np.random.default_rng(0).uniform([-0.1, -0.1, 0], [0.1, 0.1, 0.03], (500, 3))
    np.savez(tmp_path / "now.npz", points=cloud)
    plan = piegraph_json(
        "plan",
        "--run",
        planner,
        "--state",
        tmp_path / "now.npz",
        "--goal-pose",
        "0.1,0,0.3",
        "--horizon",
        2,
        "--samples",
        10,
    )
    assert (plan["frame"], plan["units"]) == ("world", "m")
    assert len(plan["strokes"]) == 2
    missing = piegraph("plan", "--run", planner, "--state", tmp_path / "now.npz", check=2)
    assert "--state needs a goal" in missing.stderr, "a question to plan stands for itself"
    there = piegraph_json("plan", "--run", planner, "--state", tmp_path / "now.npz", "--goal-pose", "0,0,0")
    assert there["strokes"] == []
    assert "already" in there["quality"]
    assert set(plan["strokes"][0]) == {"episode", "mode", "start", "end", "predicted_distance"}


def test_a_goal_may_be_a_frame_of_a_track(planner, tiny_run):
    goal = tiny_run / "tracks" / "sequence_0001.h5"
    plan = piegraph_json(
        "plan", "--run", planner, "--env", "tblock", "--goal", f"{goal}:3", "--samples", 8, "--strokes", 1
    )
    assert len(plan["strokes"]) == 1


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "either --env or --state"),
        (["--env", "moon"], 2, "'moon' is not one of 'tblock'"),
        (["--state", "empty.npz"], 2, "--state needs a goal"),
        (["--env", "tblock", "--goal", "none.ply"], 3, "none.ply: no such file"),
        (["--env", "tblock", "--goal", "empty.npz"], 3, "holds no finite points"),
        (["--env", "tblock", "--goal", "empty.ply"], 3, "holds no finite points"),
        (["--env", "tblock", "--goal-pose", "50,0,0"], 3, "the goal lies around"),
        (["--env", "tblock", "--min-length", "0.2", "--max-length", "0.1"], 2, "min_length 0.2 is not below"),
        (["--env", "tblock", "--min-length", "0.01", "--max-length", "0.015"], 2, "do not go into the object"),
        (["--env", "tblock", "--goal", "words.txt"], 3, "cannot read clouds from .txt"),
        (["--env", "tblock", "--goal", "empty.npz", "--goal-pose", "0,0,1"], 2, "one goal, not two"),
        (["--env", "tblock", "--model", "oracle"], 2, "plan.model: no model oracle: piegraph, "),
        (["--env", "tblock", "--stiffness", "5"], 2, "stiffness 5 is unstable"),
    ],
)
def test_wrong_plans(planner, tmp_path, arguments, code, message):
    np.savez(tmp_path / "empty.npz", points=np.zeros((0, 3)))
    (tmp_path / "empty.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    (tmp_path / "words.txt").write_text("no cloud")
    done = piegraph("plan", "--run", planner, *arguments, check=code, cwd=tmp_path)
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_cloud_that_was_cut_off_moves_no_robot(planner, tiny_run, tmp_path):
    cloud = np.random.default_rng(0).uniform([-0.1, -0.1, 0], [0.1, 0.1, 0.03], (500, 3)).astype("<f4")
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 500\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    whole, cut, track = tmp_path / "now.ply", tmp_path / "cut.ply", tmp_path / "cut.h5"
    whole.write_bytes(header.encode() + cloud.tobytes())
    cut.write_bytes(whole.read_bytes()[: len(whole.read_bytes()) * 9 // 10])
    track.write_bytes((tiny_run / "tracks" / "sequence_0001.h5").read_bytes()[:-500])
    question = ("plan", "--run", planner, "--samples", 10, "--json")
    assert piegraph_json(*question[:-1], "--state", whole, "--goal-pose", "0.1,0,0.3")["strokes"]
    for given in (("--state", cut, "--goal-pose", "0.1,0,0.3"), ("--state", whole, "--goal", cut)):
        done = piegraph(*question, *given, check=3)
        assert "cut.ply: is cut off" in done.stderr
        assert '"start"' not in done.stdout
    done = piegraph(*question, "--state", track, "--goal-pose", "0.1,0,0.3", check=3)
    assert "cut.h5: not a readable HDF5 file" in done.stderr
    assert '"start"' not in done.stdout


def test_settings_that_failed_are_not_kept(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    before = (folder / "recipe.toml").read_text()
    piegraph("train", "--run", folder, "--device", "cuda", "--steps", "7", check=4)
    assert (folder / "recipe.toml").read_text() == before


def test_ray_that_is_not_installed_is_named(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    code = "import sys; sys.modules['ray'] = None; from piegraph_cli.app import main; main()"
    command = [sys.executable, "-c", code, "dataset", "--run", str(folder), "--backend", "ray", "--force"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    assert "piegraph[cluster]" in done.stderr
    assert "Traceback" not in done.stderr


def test_status_says_why_something_is_stale(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    piegraph("train", "--run", folder, "--steps", "39")
    (folder / "tracks" / "sequence_0001.h5").write_bytes(b"cut")
    rows = {(r["stage"], r["unit"]): r for r in piegraph_json("status", "--run", folder)["artifacts"]}
    assert "not a readable HDF5 file" in rows["simulate", "sequence_0001"]["reason"]
    assert "what it was made from has changed" in rows["evaluate", "piegraph.seed0"]["reason"]
    piegraph("train", "--run", folder, "--batch", "4", "--steps", "0", check=2)
    assert piegraph_json("status", "--run", folder)["artifacts"][5]["state"] == "fresh"
