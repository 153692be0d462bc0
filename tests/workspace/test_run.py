"""Keys, states and failures of a run; locks between processes."""

import shutil
import threading
import time
from typing import get_args

import numpy as np
import pytest

from piegraph_cli.dynamics.params import ModelName
from piegraph_cli.environments.params import EnvironmentName
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.stages import STAGES, open_run, sequences
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_stage, run_unit
from piegraph_cli.workspace.recipe import Recipe, find_recipe, load_recipe, parse_setting, shipped
from piegraph_cli.workspace.run import Run, content_hash
from piegraph_cli.workspace.survey import status
from tests.cli import piegraph
from tests.stages.make_recording import make_recording


def run_of(folder, **sections) -> Run:
    return Run(folder, Recipe(STAGES, sections))


def test_a_key_changes_with_setting_version_and_input_and_with_nothing_else(tmp_path, monkeypatch):
    base = {"simulate": {"sequences": 3}, "dataset": {"train": 1}}
    key = run_of(tmp_path, **base).key(STAGES["train"], "piegraph.seed0")
    assert run_of(tmp_path / "elsewhere", **base).key(STAGES["train"], "piegraph.seed0") == key
    assert run_of(tmp_path, **base, evaluate={"horizons": [1]}).key(STAGES["train"], "piegraph.seed0") == key
    assert run_of(tmp_path, **base, train={"piegraph": {"steps": 7}}).key(STAGES["train"], "piegraph.seed0") != key
    assert (
        run_of(tmp_path, **(base | {"simulate": {"sequences": 3, "seed": 1}})).key(STAGES["train"], "piegraph.seed0")
        != key
    )
    import dataclasses

    monkeypatch.setitem(STAGES, "dataset", dataclasses.replace(STAGES["dataset"], version=99))
    assert run_of(tmp_path, **base).key(STAGES["train"], "piegraph.seed0") != key


def test_a_recording_is_known_by_its_content(tmp_path):
    first, second = tmp_path / "a" / "seq", tmp_path / "b" / "seq"
    for folder in (first, second):
        folder.mkdir(parents=True)
        (folder / "0.png").write_bytes(b"x")
        (folder.parent / "cameras.json").write_text("{}")
    assert content_hash(first, "recording") == content_hash(second, "recording")
    (second / "0.png").write_bytes(b"y")
    assert content_hash(first, "recording") != content_hash(second, "recording")
    (second / "0.png").write_bytes(b"x")
    (second.parent / "cameras.json").write_text("{ }")
    assert content_hash(first, "recording") != content_hash(second, "recording")
    with pytest.raises(DataError, match="setting recording"):
        content_hash(tmp_path / "none", "recording")


def test_a_changed_setting_makes_only_what_depends_on_it_stale(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    assert {row["state"] for row in status(open_run(folder))} == {"fresh"}
    run = open_run(folder)
    run.recipe = run.recipe.with_values(STAGES["train"], {"piegraph.steps": 5}, "test", folder)
    run.save_recipe()
    states = {row["stage"]: row["state"] for row in status(open_run(folder))}
    assert states == dict.fromkeys(("simulate", "dataset"), "fresh") | dict.fromkeys(
        ("train", "evaluate", "plan"), "stale"
    )


def test_stale_inputs_are_not_used(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    (folder / "model" / "piegraph.seed0.h5").write_bytes(b"cut off")
    outcome = run_stage(open_run(folder), STAGES["evaluate"], Options(force=True))[0]
    assert outcome.error is not None
    assert "model is stale" in str(outcome.error)
    assert "--until train" in outcome.error.hint


def test_a_second_process_waits_and_then_finds_it_done(tiny_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(tiny_run, folder)
    dataset = folder / "dataset.h5"
    dataset.rename(tmp_path / "kept.h5")
    outcomes = []
    with open_run(folder).lock("dataset"):
        thread = threading.Thread(
            target=lambda: outcomes.append(run_unit(open_run(folder), STAGES["dataset"], None, Options()))
        )
        thread.start()
        time.sleep(0.5)
        assert not outcomes
        (tmp_path / "kept.h5").rename(dataset)
    thread.join(60)
    assert outcomes[0].state == "cached"


def test_runs_with_the_same_seed_are_equal(tiny_recipe, tiny_run, tmp_path):
    again = tmp_path / "again"
    piegraph("run", tiny_recipe, "--run", again, "--jobs", 2)
    for path in tiny_run.rglob("*.h5"):
        name = path.parent.name if path.parent != tiny_run else path.stem
        first, second = read_artifact(path, name), read_artifact(again / path.relative_to(tiny_run), name)
        assert first.key == second.key
        for dataset in set(first.arrays) - {"seconds"}:
            np.testing.assert_array_equal(first[dataset], second[dataset], err_msg=f"{name} {dataset}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[trian]\nsteps = 1", r"unknown section \[trian\]"),
        ("[train.piegraph]\nstep = 1", "train.piegraph.step: unknown setting"),
        ("[train.piegraph]\nsteps = 0", "train.piegraph.steps: Input should be greater"),
        ("[train.piegraph]\nsteps = nan", "train.piegraph.steps"),
        ("[train\n", "not a readable TOML file"),
    ],
)
def test_a_wrong_recipe_is_refused_by_name(tmp_path, text, message):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=message) as caught:
        load_recipe(path, STAGES)
    assert str(path) in str(caught.value)


def test_a_model_without_settings_says_so(tmp_path):
    path = tmp_path / "r.toml"
    path.write_text("[train.sms-o]\nradius = 0.4")
    with pytest.raises(UsageError, match="radius: unknown setting") as caught:
        load_recipe(path, STAGES)
    assert caught.value.hint == "train.sms-o has no settings: leave it out"


def test_recipe_paths_are_relative_to_the_recipe(tmp_path):
    (tmp_path / "rec").mkdir()
    path = tmp_path / "r.toml"
    path.write_text('[ingest]\nrecording = "rec"\n[plan]\ngoal = "rec/goal.ply:3"\n')
    recipe = load_recipe(path, STAGES)
    assert recipe.params(STAGES["ingest"]).recording == (tmp_path / "rec",)
    assert recipe.params(STAGES["plan"]).goal == f"{tmp_path}/rec/goal.ply:3"


@pytest.mark.parametrize(("given", "placed"), [("./x", "x"), ("a//b", "a/b"), ("../x", "../x"), ("x", "x")])
def test_paths_are_made_absolute_however_they_are_spelled(tmp_path, given, placed):
    recipe = Recipe(STAGES).with_values(STAGES["ingest"], {"recording": given}, "test", tmp_path)
    place = str((tmp_path / placed).resolve())
    assert recipe.sections["ingest"]["recording"] == place
    for frame in ("", ":3"):
        recipe = Recipe(STAGES).with_values(STAGES["plan"], {"goal": f"{given}.npz{frame}"}, "test", tmp_path)
        assert recipe.sections["plan"]["goal"] == f"{place}.npz{frame}"


def test_a_part_of_what_has_no_parts_is_refused(tmp_path):
    recipe = Recipe(STAGES, {"track": {"mode": "pick"}})
    with pytest.raises(UsageError, match=r"track\.mode"):
        recipe.with_values(STAGES["track"], {"mode.x": 1}, "test", tmp_path)


def test_how_a_training_is_watched_is_in_no_key(tmp_path):
    keys = [
        run_of(tmp_path, simulate={"sequences": 3}, train=given).key(STAGES["train"], "piegraph.seed0")
        for given in ({}, {"tensorboard": True}, {"checkpoint_every": 7}, {"piegraph": {"steps": 7}})
    ]
    assert keys[0] == keys[1] == keys[2] != keys[3]


def test_a_stage_of_the_whole_run_that_failed_says_why(tmp_path):
    run = run_of(tmp_path, simulate={"sequences": 3}, dataset={"train": 1})
    run.record_failures(STAGES["dataset"], [None], {None: DataError("no stroke was found")})
    (row,) = (row for row in status(Run(run.folder, run.recipe)) if row["stage"] == "dataset")
    assert (row["state"], row["failure"]) == ("failed", "no stroke was found")


def test_a_new_question_forgets_the_old_one(tmp_path):
    recipe = Recipe(STAGES, {"plan": {"env": "tblock", "goal": "a.ply", "samples": 20}})
    recipe = recipe.with_values(STAGES["plan"], {"state": "now.ply"}, "test", tmp_path)
    assert recipe.sections["plan"] == {"samples": 20, "state": str(tmp_path / "now.ply")}


def test_a_recording_that_was_moved_away_leaves_its_artifacts_usable(tmp_path):
    recording = make_recording(tmp_path / "rec")
    run = Run(tmp_path / "run", Recipe(STAGES, {"ingest": {"recording": str(recording)}}))
    run.save_recipe()
    run_stage(run, STAGES["ingest"], Options())
    recording.rename(tmp_path / "elsewhere")
    moved = open_run(run.folder)
    assert sequences(moved) == ["seq 0", "seq 1"]
    assert [moved.state(STAGES["ingest"], s) for s in sequences(moved)] == ["fresh", "fresh"]
    other = Run(run.folder, Recipe(STAGES, {"ingest": {"recording": str(tmp_path / "none")}}))
    with pytest.raises(DataError, match="none: no such recording folder"):
        other.key(STAGES["ingest"], "seq 0")


def test_the_names_in_settings_are_those_of_the_tables():
    from piegraph_cli.dynamics.models import MODELS
    from piegraph_cli.environments import ENVIRONMENTS

    assert set(get_args(ModelName)) == set(MODELS)
    assert set(get_args(EnvironmentName)) == set(ENVIRONMENTS)


def test_settings_from_the_command_line():
    stage, setting, value = parse_setting("track.damping=0.7", STAGES)
    assert (stage.name, setting, value) == ("track", "damping", 0.7)
    assert parse_setting("evaluate.models=static,piegraph", STAGES)[2] == "static,piegraph"
    with pytest.raises(UsageError):
        parse_setting("damping=0.7", STAGES)


def test_shipped_recipes_load():
    assert {"tblock", "demo"} <= set(shipped())
    for name in shipped():
        assert load_recipe(find_recipe(name), STAGES).chain()


def test_a_recipe_of_notepad_is_read_and_a_backslash_told(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes('[ingest]\r\nrecording = "rec"\r\n'.encode("utf-8-sig"))
    assert load_recipe(path, STAGES).sections["ingest"]["recording"].endswith("rec")
    path.write_text('[ingest]\nrecording = "C:\\Users\\me"\n')
    with pytest.raises(UsageError, match="not a readable TOML file") as refused:
        load_recipe(path, STAGES)
    assert "'quotes'" in refused.value.hint
