"""Cleaning a run folder: what goes, and what must never go."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.clean import ABANDONED, find_waste, remove
from piegraph_cli.workspace.execute import Checkpoint
from piegraph_cli.workspace.survey import status
from tests.cli import piegraph, piegraph_json


@pytest.fixture
def copied(tiny_run, tmp_path):
    """A copy of the tiny run, without its locks."""
    shutil.copytree(tiny_run, tmp_path / "run", ignore=shutil.ignore_patterns(".locks"))
    return tmp_path / "run"


def waste(folder: Path) -> dict[str, str]:
    return {str(one.path.relative_to(folder)): one.reason for one in find_waste(open_run(folder))}


def old(path: Path) -> Path:
    path.write_bytes(b"half")
    os.utime(path, (time.time() - 2 * ABANDONED,) * 2)
    return path


def test_a_run_of_which_all_is_used_has_no_waste(copied):
    assert waste(copied) == {}


def test_stale_artifacts_and_those_of_no_unit(copied):
    run = open_run(copied)
    run.recipe = run.recipe.with_values(STAGES["simulate"], {"sequences": 3}, "test", copied)
    run.save_recipe()
    found = waste(copied)
    assert found["tracks/sequence_0003.h5"] == "of no sequence of this run"
    assert found["dataset.h5"] == "stale: what it was made from has changed"
    assert "tracks/sequence_0000.h5" not in found
    (copied / "recipe.toml").write_text("[trials]\n")
    assert waste(copied)["model/piegraph.seed0.h5"] == "no stage of the recipe makes it"


def test_answers_of_stages_that_the_recipe_does_not_name_are_kept(copied):
    run = open_run(copied)
    run.recipe.sections.pop("plan")
    run.save_recipe()
    assert "plan" not in [stage.name for stage in open_run(copied).chain]
    assert waste(copied) == {}


def test_models_of_an_earlier_comparison_are_kept_as_long_as_the_run_trains_them(copied):
    recipe = copied / "recipe.toml"
    text = recipe.read_text()
    recipe.write_text(text.replace("[evaluate]", '[evaluate]\nmodels = ["static"]'))
    assert (copied / "metrics" / "kabsch.seed0.h5").exists()
    assert set(waste(copied)) == {"plan.h5"}, "its model is no longer measured"
    recipe.write_text(text.replace("[train]", "[train]\nseeds = [1]"))
    found = waste(copied)
    assert {"model/piegraph.seed0.h5", "metrics/piegraph.seed0.h5", "metrics/kabsch.seed0.h5"} <= set(found)
    assert "metrics/static.h5" not in found


def test_leftovers(copied):
    run = open_run(copied)
    left = [old(copied / ".recipe.toml.123.tmp"), old(copied / "tracks" / ".sequence_0000.h5.99.tmp")]
    (copied / "tracks" / ".sequence_0001.h5.98.tmp").write_bytes(b"being written")
    for unit, key in (("piegraph.seed0", "of other settings"), ("pgnd.seed0", "k")):
        Checkpoint(run.checkpoint(STAGES["train"], unit), STAGES["train"], key).save({"step": np.array(3)})
    with run.lock("dataset"):
        pass
    found = waste(copied)
    expected = {str(path.relative_to(copied)) for path in left}
    expected |= {"checkpoints/train.piegraph.seed0.h5", "checkpoints/train.pgnd.seed0.h5"}
    assert set(found) == expected
    assert {path.relative_to(copied).as_posix() for path in copied.rglob("*.lock")} == {".locks/dataset.lock"}


def test_a_checkpoint_to_go_on_from_is_kept(copied):
    run = open_run(copied)
    (copied / "model" / "piegraph.seed0.h5").unlink()
    stage = STAGES["train"]
    Checkpoint(run.checkpoint(stage, "piegraph.seed0"), stage, run.key(stage, "piegraph.seed0")).save(
        {"a": np.zeros(1)}
    )
    assert waste(copied) == {}


def test_what_another_process_works_on_is_kept(copied):
    (copied / "recipe.toml").write_text("[simulate]\nsequences = 3\n")
    run = open_run(copied)
    with run.lock("tracks/sequence_0003"):
        assert "tracks/sequence_0003.h5" not in waste(copied)
        assert ".locks/tracks.sequence_0003.lock" not in waste(copied)
    found = find_waste(run)
    assert any(one.path.name == "sequence_0003.h5" for one in found)
    with run.lock("tracks/sequence_0003"):
        gone = remove(found)
    assert (copied / "tracks" / "sequence_0003.h5").exists()
    assert all(one.path.name != "sequence_0003.h5" for one in gone)


def test_what_was_made_again_since_it_was_listed_is_kept(copied):
    (copied / "recipe.toml").write_text("[simulate]\nsequences = 3\n")
    found = find_waste(open_run(copied))
    os.utime(copied / "tracks" / "sequence_0003.h5")
    remove(found)
    assert (copied / "tracks" / "sequence_0003.h5").exists()
    assert not (copied / "dataset.h5").exists()


def test_only_what_piegraph_wrote_goes_and_links_are_not_followed(copied, tmp_path):
    outside = tmp_path / "outside"
    shutil.copytree(copied / "tracks", outside)
    (copied / "scores").symlink_to(outside)
    (copied / "frames").mkdir()
    (copied / "frames" / "linked.h5").symlink_to(outside / "sequence_0000.h5")
    (copied / "tracks" / "linked.h5").symlink_to(outside / "sequence_0000.h5")
    for name in ("notes.txt", "mine.h5", "tracks/mine.h5", "tracks/readme.md", "masks.tmp", ".hidden", ".a.tmp"):
        old(copied / name)
    shutil.copy(copied / "tracks" / "sequence_0000.h5", copied / "backup.h5")
    shutil.copy(copied / "dataset.h5", copied / "tracks" / "not_tracks.h5")
    assert waste(copied) == {}


def test_the_command_shows_sizes_and_removes_only_with_yes(copied):
    (copied / "recipe.toml").write_text((copied / "recipe.toml").read_text().replace("sequences = 4", "sequences = 3"))
    old(copied / "tracks" / ".sequence_0000.h5.99.tmp")
    size = (copied / "tracks" / "sequence_0003.h5").stat().st_size
    before = sorted(copied.rglob("*"))
    text = piegraph("clean", "--run", copied).stdout
    assert "tracks/sequence_0003.h5" in text
    assert "--yes" in text
    assert sorted(copied.rglob("*")) == before
    value = piegraph_json("clean", "--run", copied, "--yes")
    assert value["removed"] is True
    assert {row["bytes"] for row in value["files"] if "sequence_0003" in row["file"]} == {size}
    assert value["bytes"] == sum(row["bytes"] for row in value["files"])
    assert not (copied / "tracks" / "sequence_0003.h5").exists()
    assert not list(copied.rglob("*.tmp"))
    assert not list(copied.rglob("*.lock"))
    assert {r["state"] for r in status(open_run(copied)) if r["stage"] == "simulate"} == {"fresh"}
    assert piegraph_json("clean", "--run", copied)["files"] == []
    assert "not a run folder" in piegraph("clean", "--run", copied / "none", check=2).stderr
