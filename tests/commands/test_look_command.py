"""The command `look` on frames of a recording: what it prints and writes, and that `plan --state` takes it."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli import load_model, look, look_settings, open_run, read_artifact, read_points, read_scene
from tests.cli import SAMPLE
from tests.commands.inside import piegraph, piegraph_json


def test_a_look_is_the_state_of_a_plan(tiny_run, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(tiny_run, run)
    source, ply, npz = SAMPLE / "sequence_0000:0", tmp_path / "now.ply", tmp_path / "now.npz"
    found = piegraph_json("look", source, "--run", run, "--out", ply, "--picture", tmp_path / "now.png")
    piegraph("look", source, "--run", run, "--out", npz)
    seen = look(*read_scene(source), look_settings(run))
    assert found["verdict"] == seen.verdict == "good"
    np.testing.assert_allclose(found["particles"], seen.particles)
    assert (tmp_path / "now.png").stat().st_size > 10_000
    for file in (ply, npz):
        np.testing.assert_array_equal(read_points(file, None), seen.cloud)
        (stroke,) = piegraph_json("plan", "--run", run, "--state", file, "--goal-pose", "0.1,0,0.3")["strokes"]
        plan = load_model(run).plan(seen.cloud, goal_pose=(0.1, 0, 0.3))
        np.testing.assert_allclose([stroke["start"], stroke["end"]], plan.strokes.ends[0], atol=1e-6)


def test_a_plan_looks_for_itself(tiny_run, tmp_path):
    """The same strokes as from the cloud that `look` writes; another frame is another question."""
    run = tmp_path / "run"
    shutil.copytree(tiny_run, run)
    source, ply = SAMPLE / "sequence_0000", tmp_path / "now.ply"
    found = {}
    for frame in (0, 42):
        piegraph("look", f"{source}:{frame}", "--run", run, "--out", ply)
        for state in (ply, f"{source}:{frame}"):
            plan = piegraph_json("plan", "--run", run, "--state", state, "--goal-pose", "0.1,0,0.3")
            found[frame, str(state)] = plan["strokes"][0]["start"]
        assert found[frame, str(ply)] == found[frame, f"{source}:{frame}"]
    assert len({tuple(start) for start in found.values()}) == 2
    refused = piegraph("plan", "--run", run, "--state", f"{source}:20", "--goal-pose", "0.1,0,0.3", check=3)
    assert "the look is bad" in refused.stderr
    assert "piegraph look" in refused.stderr


def test_another_frame_of_a_goal_is_another_question(tiny_run, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(tiny_run, run)
    positions = open_run(tiny_run).read("tracks", "sequence_0000")["positions"]
    np.savez(tmp_path / "goals.npz", np.stack([positions[0] + [0.1, 0, 0], positions[0] + [0, 0.1, 0]]))
    np.savez(tmp_path / "now.npz", positions[0])
    ask = ("plan", "--run", run, "--state", tmp_path / "now.npz", "--goal")
    first, second = (piegraph_json(*ask, f"{tmp_path / 'goals.npz'}:{frame}")["strokes"] for frame in (0, 1))
    assert first != second


def test_a_bad_look_ends_with_3_and_writes_no_cloud(tmp_path):
    source, out = SAMPLE / "sequence_0000:20", tmp_path / "now.ply"
    found = piegraph_json("look", source, "--out", out, check=3)
    assert (found["verdict"], found["particles"], found["cloud"]) == ("bad", None, None)
    assert any(f["check"] == "cut" and "hands" in f["try"] for f in found["findings"])
    assert not out.exists()
    said = piegraph("look", source, "--out", out, "--accept", "cut")
    assert "accepted: cut" in said.stdout
    unknown = piegraph("look", source, "--out", out, "--accept", "cute", check=2)
    assert "no check is called cute" in unknown.stderr
    assert out.exists()
    again = piegraph("look", source, "--out", out, check=3)
    assert "that of an earlier look is now" in again.stdout
    assert not out.exists()
    assert (tmp_path / "now.ply.earlier").exists()


def test_a_folder_of_single_frames_is_a_scene(tmp_path):
    shutil.copy(SAMPLE / "cameras.json", tmp_path)
    for camera in ("cam0", "cam1", "cam2", "cam3"):
        for kind, suffix in (("color", "jpg"), ("depth", "png")):
            image = SAMPLE / "sequence_0000" / camera / kind / f"000000.{suffix}"
            shutil.copy(image, tmp_path / f"{camera}_{kind}.{suffix}")
    now, then = (look(*read_scene(place)) for place in (tmp_path, SAMPLE / "sequence_0000:0"))
    np.testing.assert_array_equal(now.particles, then.particles)


def test_prompts_are_those_of_segment():
    said = piegraph("look", SAMPLE / "sequence_0000:0", "--set", "segment.points.cam0=[5, 5]", check=3)
    assert "segment.points.cam0 meets nothing" in said.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        ((), 2, "nothing to look at"),
        ((SAMPLE,), 3, "a recording of 4 sequences"),
        ((SAMPLE / "sequence_0000:99",), 3, "no frame 99"),
        ((SAMPLE / "none",), 3, "no such folder"),
        ((SAMPLE / "sequence_0000:0", "--run", SAMPLE), 2, "not a run folder"),
        ((SAMPLE / "sequence_0000:0", "--out", "now.obj"), 2, "use .ply or .npz"),
        ((SAMPLE / "sequence_0000:0", "--picture", "now.ply"), 2, "cannot draw a picture"),
        ((SAMPLE / "sequence_0000:0", "--set", "train.seeds=3"), 2, "no settings of train"),
    ],
)
def test_what_cannot_be_looked_at_is_said(arguments, code, text):
    assert text in piegraph("look", *arguments, check=code).stderr


def contents(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_plan_may_be_written_elsewhere_and_then_leaves_the_run_alone(tiny_run, tmp_path, monkeypatch):
    run = tmp_path / "run"
    shutil.copytree(tiny_run, run)
    np.savez(tmp_path / "now.npz", open_run(run).read("tracks", "sequence_0000")["positions"][0])
    ask = ("plan", "--run", run, "--state", tmp_path / "now.npz", "--goal-pose", "0.1,0,0.3")
    before = contents(run)
    told = piegraph_json(*ask, "--out", tmp_path / "a b" / "plan.h5")
    assert told["plan"] == str(tmp_path / "a b" / "plan.h5")
    assert read_artifact(tmp_path / "a b" / "plan.h5", "plan").arrays["stroke"].shape == (1, 2, 2)
    piegraph(*ask, "--out", tmp_path / "a b" / "plan.h5")  # over what it wrote itself
    model = run / "model" / "piegraph.seed0.h5"
    for taken, why in ((model, "no plan"), (run / "recipe.toml", "no plan"), (tmp_path, "is a folder")):
        assert why in piegraph(*ask, "--out", taken, check=2).stderr
    monkeypatch.setattr(os, "access", lambda path, mode, **how: mode != os.W_OK)
    unkept = piegraph(*ask)
    assert "cannot be written, so the answer is not kept" in unkept.stderr
    assert "push from" in unkept.stdout
    assert contents(run) == before
