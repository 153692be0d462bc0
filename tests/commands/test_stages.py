"""The commands of the stages: what settings they keep, what they tell, and what they say of mistakes."""

import shutil
import subprocess
import sys

import numpy as np
import pytest

from piegraph_cli.stages import open_run
from tests.commands.inside import piegraph, piegraph_json


@pytest.fixture
def folder(tiny_run, tmp_path):
    """A copy of the finished run."""
    return shutil.copytree(tiny_run, tmp_path / "a run")


def train_params(folder):
    return open_run(folder).params("train")


def test_a_missing_package_names_the_extra(tmp_path):
    code = "import sys; sys.modules['pymunk'] = None; from piegraph_cli.__main__ import main; main()"
    command = [sys.executable, "-c", code, "simulate", "tblock", "--out", str(tmp_path / "r"), "--sequences", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    assert "pip install 'piegraph[sim]'" in done.stderr


def test_options_of_a_stage_are_kept_in_the_recipe(folder):
    piegraph("train", "--run", folder, "--steps", "20", "--no-action-head")
    text = (folder / "recipe.toml").read_text()
    assert "steps = 20" in text
    assert "action_head = false" in text
    states = {row["stage"]: row["state"] for row in piegraph_json("status", "--run", folder)["artifacts"]}
    assert (states["train"], states["evaluate"]) == ("fresh", "stale")


def test_a_further_model_is_trained_beside_the_others(folder):
    command = ("train", "--run", folder, "--model", "gnn@1", "--seed", "0,3", *QUICK)
    assert [o["unit"] for o in piegraph_json(*command)["outcomes"]] == ["gnn@1.seed0", "gnn@1.seed3"]
    states = {r["unit"]: r["state"] for r in piegraph_json("status", "--run", folder)["artifacts"]}
    assert states["piegraph.seed0"] == states["gnn@1.seed3"] == "fresh"
    assert "piegraph.seed3" not in states, "seeds of a call are those of its model"
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


QUICK = ("--steps", 3, "--hidden", 8)


def test_seeds_of_a_call_are_those_of_its_model(folder):
    """README: `train --model pgnd --seed 0,1,2`, then `evaluate --models static,piegraph,pgnd,sms-no`."""
    settings = ("--steps", 2, "--batch", 1, "--rollout", 1)
    done = piegraph_json("train", "--run", folder, "--model", "pgnd", "--seed", "0,1,2", *settings)
    assert [(o["unit"], o["state"]) for o in done["outcomes"]] == [(f"pgnd.seed{k}", "done") for k in range(3)]
    params = train_params(folder)
    assert (params.models, params.seeds, params.seeds_of("piegraph")) == (("piegraph", "pgnd"), (0,), (0,))
    assert params.seeds_of("pgnd") == (0, 1, 2)
    found = piegraph_json("evaluate", "--run", folder, "--models", "static,piegraph,pgnd,sms-no")
    assert {row["model"]: row["seeds"] for row in found["rows"]} == {"static": 1, "piegraph": 1, "pgnd": 3, "sms-no": 1}
    assert (found["missing"], found["failed"]) == ([], [])


def test_a_model_keeps_its_seeds_beside_further_ones(folder):
    piegraph("train", "--run", folder, "--model", "gnn", *QUICK)
    assert train_params(folder).model_seeds == {}
    done = piegraph_json("train", "--run", folder, "--model", "gnn", "--seed", "2", *QUICK)
    assert [o["unit"] for o in done["outcomes"]] == ["gnn.seed2"]
    assert train_params(folder).model_seeds == {"gnn": (0, 2)}
    done = piegraph_json("train", "--run", folder, "--model", "piegraph-ng", "--seed", "1", "--steps", "40")
    assert {o["unit"]: o["state"] for o in done["outcomes"]} == {"piegraph.seed1": "done"}
    assert train_params(folder).seeds_of("piegraph") == (0, 1)
    done = piegraph_json("train", "--run", folder, "--model", "gnn")
    assert {o["unit"]: o["state"] for o in done["outcomes"]} == {"gnn.seed0": "cached", "gnn.seed2": "cached"}


def test_seeds_without_a_model_are_those_of_all(folder):
    done = piegraph_json("train", "--run", folder, "--seed", "0,1")
    assert {o["unit"]: o["state"] for o in done["outcomes"]} == {"piegraph.seed0": "cached", "piegraph.seed1": "done"}
    params = train_params(folder)
    assert (params.seeds, params.model_seeds) == ((0, 1), {})


def test_evaluate_prints_what_there_is_and_names_what_is_missing(folder):
    before = (folder / "recipe.toml").read_text()
    command = ("evaluate", "--run", folder, "--models", "static,piegraph,pgnd,gnn@1")
    found = piegraph_json(*command, check=3)
    assert {row["model"] for row in found["rows"]} == {"static", "piegraph"}
    assert found["failed"] == []
    trains = f"piegraph train --run '{folder}' --model"
    assert {row["model"]: row["command"] for row in found["missing"]} == {
        "gnn@1.seed0": f"{trains} gnn@1 --seed 0",
        "pgnd.seed0": f"{trains} pgnd --seed 0",
    }
    done = piegraph(*command, check=3)
    assert " piegraph " in done.stdout
    assert f"missing: pgnd.seed0 (model is missing)\n  try: {trains} pgnd --seed 0" in done.stdout
    assert f"try: {trains} pgnd --seed 0" in done.stderr
    assert (folder / "recipe.toml").read_text() == before, "a model that is not there is not asked for again"


def test_a_model_of_the_recipe_is_made_by_its_recipe(folder):
    for artifact in ("model", "metrics"):
        shutil.rmtree(folder / artifact)
    found = piegraph_json("evaluate", "--run", folder, "--models", "static,piegraph", check=3)
    assert [row["command"] for row in found["missing"]] == [f"piegraph run --run '{folder}' --until train"]
    assert {row["model"] for row in found["rows"]} == {"static"}


def test_a_rate_counts_what_was_made(tmp_path):
    command = ("simulate", "tblock", "--out", tmp_path / "r", "--sequences", 2, "--strokes", 3)
    assert piegraph_json(*command)["strokes_per_second"] > 0
    assert " strokes a second" not in piegraph(*command).stdout, "what was there already is not counted"


def test_render_records_in_place_of_tracks(tmp_path, monkeypatch):
    """README: `simulate tblock --render --sequences 4 --strokes 3 --out my_recording`; without --out into recordings/."""
    made = []

    def record(out, params, *, jobs, force):
        made.append((str(out), params.environment, params.sequences, params.strokes, jobs, force))
        return ["sequence_0000"]

    monkeypatch.setattr("piegraph_cli.stages.simulate.record_sequences", record)
    monkeypatch.chdir(tmp_path)
    command = ("simulate", "tblock", "--render", "--sequences", 4, "--strokes", 3)
    found = piegraph_json(*command, "--out", "my_recording")
    assert found == {"recording": "my_recording", "sequences": ["sequence_0000"]}
    assert piegraph(*command, "--jobs", 2, "--force").stdout == "recordings/tblock: 1 sequence\n"
    assert made == [("my_recording", "tblock", 4, 3, 1, False), ("recordings/tblock", "tblock", 4, 3, 2, True)]


@pytest.fixture
def planner(folder):
    """A run whose recipe asks nothing of `plan`."""
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
    assert set(plan["strokes"][0]) == {
        "episode",
        "mode",
        "start",
        "end",
        "predicted_distance",
        "expected_error",
        "path",
    }
    first, *_, last = plan["strokes"][0]["path"]
    assert first["point"] == pytest.approx([*plan["strokes"][0]["start"], 0.1])
    assert (first["time"], first["part"], last["part"], last["point"][2]) == (
        0,
        "approach",
        "retreat",
        pytest.approx(0.1),
    )
    assert "moved from where it is by (+0.100, +0.000) m, turned by +0.300 rad" in plan["goal"]


def test_a_goal_may_be_an_array_by_key_or_a_pose_in_the_world_and_boxes_are_kept_out_of(planner, tiny_run, tmp_path):
    track = tiny_run / "tracks" / "sequence_0001.h5"
    now = open_run(tiny_run).read("tracks", "sequence_0001")["positions"][0]
    np.savez(
        tmp_path / "all.npz",
        note=np.zeros(4),
        now=now,
        goal=np.stack([now, now + np.float32([0.1, 0, 0])]),
        **{"a/b:c": now},
    )
    of_file, ask = f"{tmp_path / 'all.npz'}:", ("plan", "--run", planner, "--samples", 10, "--cem-iterations", 1)
    by_key = piegraph_json(*ask, "--state", f"{of_file}now", "--goal", f"{of_file}goal:1")
    tracked = piegraph_json(*ask, "--state", f"{track}:0", "--goal-pose", "0.1,0,0")
    assert by_key["start_distance"] == pytest.approx(tracked["start_distance"], abs=2e-3)
    slashed = piegraph_json(*ask, "--state", f"{of_file}a/b:c", "--goal-pose", "0.1,0,0")
    assert slashed["strokes"] == piegraph_json(*ask, "--state", f"{of_file}now", "--goal-pose", "0.1,0,0")["strokes"]
    for one, other in zip(
        slashed["strokes"], tracked["strokes"], strict=True
    ):  # particles in another order: sums differ
        assert [one[name] for name in ("mode", "start", "end", "path")] == [
            other[name] for name in ("mode", "start", "end", "path")
        ]
        assert one["predicted_distance"] == pytest.approx(other["predicted_distance"], rel=1e-6)
    missing = piegraph(*ask, "--state", f"{of_file}then", "--goal-pose", "0.1,0,0", check=3)
    assert "has no array then\n  try: it has note, now, goal, a/b:c" in missing.stderr
    first = piegraph(*ask, "--state", tmp_path / "all.npz", "--goal-pose", "0.1,0,0", check=3)
    assert "which of its arrays are the points: now, goal, a/b:c" in first.stderr
    turned = piegraph(*ask, "--state", f"{of_file}now", "--goal-at", "0.1,0,90", check=2)
    assert "90 degrees are 1.571" in turned.stderr
    world = piegraph(*ask, "--state", f"{of_file}now", "--goal-at", "0.1,0.05,0.5").stdout
    assert "goal: the trained rest shape, its middle at (+0.100, +0.050) m in the world, turned by +0.500 rad" in world
    assert "tool, stroke 0: from above (" in world
    boxes = ("--keep-out", "-1,0,-1,1,0,0.2;0,1,-1,1,0,0.2")
    refused = piegraph(*ask, "--state", f"{of_file}now", "--goal-pose", "0.1,0,0", *boxes, check=3)
    assert "no stroke touches the object inside the workspace and outside the boxes of plan.keep_out" in refused.stderr


HEAVY = {
    *("cv2", "gymnasium", "matplotlib", "mediapipe", "mujoco", "open3d", "pandas", "pymunk", "sympy"),
    *("scipy.ndimage", "scipy.optimize", "scipy.stats", "torch._dynamo", "torch._inductor"),
    *("piegraph_cli.environments.base", "piegraph_cli.perception.parts", "piegraph_cli.dynamics.dataset"),
}
"""Modules that a one-shot plan starts faster without."""


def test_a_one_shot_plan_imports_nothing_heavy_but_what_predicts(planner, tiny_run, tmp_path):
    code = "import sys; from piegraph_cli.commands.program import call; code = call(sys.argv[1:]); print(*sys.modules)"
    track = tiny_run / "tracks" / "sequence_0001.h5"
    asked = ("plan", "--run", planner, "--state", f"{track}:0", "--goal-pose", "0.1,0,0.3", "--samples", 4)
    command = [sys.executable, "-c", code, *map(str, (*asked, "--out", tmp_path / "plan.h5"))]
    done = subprocess.run(command, capture_output=True, text=True)
    modules = set(done.stdout.splitlines()[-1].split())
    assert {"torch", "h5py", "piegraph_cli.planning.question"} <= modules, done.stderr
    assert not HEAVY & modules


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
    assert "cut.h5: its bytes are not those that were written" in done.stderr
    assert '"start"' not in done.stdout


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
        (["--env", "tblock", "--goal-pose", "5,0,0"], 3, "the goal lies around"),
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


@pytest.mark.parametrize("model", ["static", "sms-no"])
def test_a_model_that_is_not_trained_plans_without_one(planner, model):
    shutil.rmtree(planner / "model")
    plan = piegraph_json("plan", "--run", planner, "--env", "tblock", "--model", model, "--samples", 8, "--strokes", 1)
    assert len(plan["end_distance"]) == 1
    assert "[plan]" not in (planner / "recipe.toml").read_text()


def test_a_plan_with_a_model_that_is_not_there_names_what_trains_it_and_shows_no_old_plan(planner):
    done = piegraph("plan", "--run", planner, "--env", "tblock", "--model", "pgnd", check=3)
    assert f"try: piegraph train --run '{planner}' --model pgnd --seed 0" in done.stderr
    assert done.stdout == "failed: plan\n"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("train", "--model", "gnn@50"), 2),
        (("train", "--model", "gnn:wide"), 2),
        (("train", "--model", "pgnd", "--hidden", "8"), 2),
        (("evaluate", "--models", "static,gnn", "--horizons", "1"), 3),
        (("dataset", "--train", "2", "--min-stroke", "0.9"), 3),
    ],
)
def test_settings_that_were_refused_are_not_kept(folder, arguments, code):
    before = (folder / "recipe.toml").read_text()
    command, *settings = arguments
    piegraph(command, "--run", folder, *settings, check=code)
    assert (folder / "recipe.toml").read_text() == before


def test_settings_that_failed_are_not_kept(folder):
    before = (folder / "recipe.toml").read_text()
    piegraph("train", "--run", folder, "--device", "cuda", "--steps", "7", check=4)
    assert (folder / "recipe.toml").read_text() == before


def test_ray_that_is_not_installed_is_named(folder):
    code = "import sys; sys.modules['ray'] = None; from piegraph_cli.__main__ import main; main()"
    command = [sys.executable, "-c", code, "dataset", "--run", str(folder), "--backend", "ray", "--force"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    assert "piegraph[cluster]" in done.stderr
    assert "Traceback" not in done.stderr
