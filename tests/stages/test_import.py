"""`piegraph import`: from files of others to a trained model, and nothing half-written where one is wrong."""

import h5py
import numpy as np
import pytest

from piegraph_cli.stages import open_run
from piegraph_cli.workspace.artifact import read_artifact
from tests.cli import piegraph, piegraph_json


def rope(seed: int, markers: int = 12, frames: int = 6, strokes: int = 2) -> dict[str, np.ndarray]:
    """A rope of markers that a hand pushes sideways; each stroke begins beside it and ends `frames` later."""
    rng = np.random.default_rng(seed)
    shape = np.stack([np.linspace(-0.15, 0.15, markers), np.zeros(markers), np.full(markers, 0.01)], 1)
    rows: dict[str, list] = {"particles": [], "end_effector": [], "contact": []}
    for _ in range(strokes):
        at = shape[rng.integers(markers)].copy()
        near = np.exp(-(((shape[:, 0] - at[0]) / 0.08) ** 2))
        begin = shape.copy()
        for share in np.linspace(0, 1, frames):
            shape = begin + np.array([0, 0.04 * share, 0]) * near[:, None]
            rows["particles"].append(shape)
            rows["end_effector"].append(at + np.array([0, 0.05 * share - 0.01, 0.01]))
            rows["contact"].append(True)
        rows["particles"].append(shape)
        rows["end_effector"].append(at + np.array([0, -0.2, 0.2]))
        rows["contact"].append(False)
    return {name: np.array(value) for name, value in rows.items()} | {"times": np.arange(len(rows["contact"])) / 5}


def write_csv(path, data) -> None:
    markers = data["particles"].shape[1]
    names = ["time", "ee_x", "ee_y", "ee_z", "contact", *(f"p{k}_{axis}" for k in range(markers) for axis in "xyz")]
    flat = data["particles"].reshape(len(data["times"]), -1)
    columns = (data["times"][:, None], data["end_effector"], data["contact"][:, None], flat)
    np.savetxt(path, np.concatenate(columns, 1), delimiter=",", header=",".join(names), comments="")


@pytest.fixture
def takes(tmp_path):
    """A folder of four takes, of two kinds of files."""
    folder = tmp_path / "takes"
    folder.mkdir()
    for k in range(3):
        np.savez(folder / f"take{k}.npz", **rope(k))
    write_csv(folder / "take3.csv", rope(3))
    return folder


def test_a_rope_of_markers_is_learned_and_planned_with(takes, tmp_path):
    run = tmp_path / "run"
    more = tmp_path / "more.npz"
    np.savez(more, **rope(7))
    found = piegraph_json("import", takes, more, "--run", run)
    assert [o["unit"] for o in found["outcomes"]] == ["more", "take0", "take1", "take2", "take3"]
    piegraph("dataset", "--run", run, "--train-names", "take0,take1", "--validation-names", "take2")
    data = read_artifact(run / "dataset.h5", "dataset")
    assert dict(zip(data.texts("sequence_name"), data["sequence_split"].tolist(), strict=True)) == {
        "take0": 0,
        "take1": 0,
        "take2": 1,
        "take3": 2,
        "more": 2,
    }
    assert len(data["strokes"]) == 10
    piegraph("train", "--run", run, "--steps", 20)
    rows = piegraph_json("evaluate", "--run", run, "--models", "static,piegraph", "--horizons", "1,2")["rows"]
    assert {(row["model"], row["windows"]) for row in rows} >= {("static", 4), ("piegraph", 4)}
    question = ("--state", run / "tracks" / "take0.h5", "--goal-pose", "0.1,0.1,0.3", "--samples", 8)
    assert piegraph_json("plan", "--run", run, *question)["strokes"]
    assert "import" in piegraph("status", "--run", run).stdout


def test_strokes_of_two_frames_give_a_pair_each(tmp_path):
    for k in range(3):
        np.savez(tmp_path / f"push{k}.npz", **rope(k, frames=2, strokes=1))
    piegraph("import", *(tmp_path / f"push{k}.npz" for k in range(3)), "--run", tmp_path / "run")
    piegraph("dataset", "--run", tmp_path / "run", "--train", 2)
    data = read_artifact(tmp_path / "run" / "dataset.h5", "dataset")
    assert data["strokes"].tolist() == data["pairs"].tolist() == [[0, 1], [3, 4], [6, 7]]
    piegraph("train", "--run", tmp_path / "run", "--steps", 3)
    piegraph("evaluate", "--run", tmp_path / "run", "--horizons", 1)


def test_what_is_fresh_is_kept_and_what_changed_is_read_again(takes, tmp_path):
    run = tmp_path / "run"
    piegraph("import", takes, "--run", run)
    np.savez(takes / "take1.npz", **rope(11))
    np.savez(takes / "take4.npz", **rope(4))
    states = {o["unit"]: o["state"] for o in piegraph_json("import", takes, "--run", run)["outcomes"]}
    assert states == {"take0": "cached", "take1": "done", "take2": "cached", "take3": "cached", "take4": "done"}
    changed = piegraph_json("import", takes, "--run", run, "--mode", "pick")["outcomes"]
    assert all(o["state"] == "done" for o in changed)
    assert read_artifact(run / "tracks" / "take0.h5", "tracks")["mode"].all()


@pytest.mark.parametrize("gone", ["folder", "file"])
def test_what_was_imported_stays_when_its_files_are_gone(takes, tmp_path, gone):
    run = tmp_path / "run"
    sources = [takes] if gone == "folder" else sorted(takes.iterdir())
    piegraph("import", *sources, "--run", run)
    takes.rename(tmp_path / "elsewhere")
    opened = open_run(run)
    stage = opened.producer("tracks")
    assert {unit: opened.state(stage, unit) for unit in opened.units(stage)} == {f"take{k}": "fresh" for k in range(4)}
    piegraph("dataset", "--run", run, "--train", 2)


@pytest.mark.parametrize("gone", [("one",), ("one", "two.v2")])
def test_of_several_folders_some_may_be_gone(tmp_path, gone):
    """What was made of them stays, wherever it came from, and the others are read as ever."""
    for k, folder in enumerate(("one", "two.v2")):
        (tmp_path / folder).mkdir()
        np.savez(tmp_path / folder / f"take{k}.npz", **rope(k))
    run = tmp_path / "run"
    piegraph("import", tmp_path / "one", tmp_path / "two.v2", "--run", run)
    for folder in gone:
        (tmp_path / folder).rename(tmp_path / f"elsewhere {folder}")
    rows = {row["unit"]: row["state"] for row in piegraph_json("status", "--run", run)["artifacts"] if row["unit"]}
    assert {name: rows[name] for name in ("take0", "take1")} == dict.fromkeys(("take0", "take1"), "fresh")


def test_an_h5_of_nothing_is_refused(tmp_path):
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file["particles"] = h5py.Empty("f4")
    done = piegraph("import", tmp_path / "none.h5", "--run", tmp_path / "run", check=3)
    assert "dataset particles: is empty" in done.stderr


def test_a_recipe_names_its_sources_beside_itself(takes, tmp_path):
    (tmp_path / "mine.toml").write_text('[import]\nsources = ["takes"]\n[dataset]\ntrain = 2\n')
    piegraph("run", tmp_path / "mine.toml", "--run", tmp_path / "run", "--until", "dataset", cwd=takes)
    assert len(read_artifact(tmp_path / "run" / "dataset.h5", "dataset")["strokes"]) == 8


def test_one_wrong_file_is_named_and_leaves_the_others_be(takes, tmp_path):
    bad = rope(1)
    np.savez(takes / "take1.npz", **bad | {"particles": bad["particles"] * 1000})
    done = piegraph("import", takes, "--run", tmp_path / "run", check=3)
    assert "take1.npz, frame 0: the object is 300 m large" in done.stderr
    assert "divide by 1000" in done.stderr
    assert sorted(path.name for path in (tmp_path / "run" / "tracks").iterdir()) == ["take0.h5", "take2.h5", "take3.h5"]
    done = piegraph("dataset", "--run", tmp_path / "run", "--train", 2)
    assert "6 strokes" in done.stdout


def test_a_file_that_is_wrong_leaves_nothing_behind(tmp_path):
    np.savez(tmp_path / "one.npz", **rope(0) | {"times": np.arange(14)[::-1] / 5})
    piegraph("import", tmp_path / "one.npz", "--run", tmp_path / "run", check=3)
    assert not (tmp_path / "run" / "tracks").exists()
    assert not (tmp_path / "run" / "recipe.toml").exists()


def test_sources_that_are_not_there_or_of_one_name(takes, tmp_path):
    done = piegraph("import", tmp_path / "none.csv", "--run", tmp_path / "run", check=3)
    assert "none.csv: no such file or folder" in done.stderr
    assert not (tmp_path / "run" / "recipe.toml").exists()
    np.savez(tmp_path / "take0.npz", **rope(0))
    done = piegraph("import", takes, tmp_path / "take0.npz", "--run", tmp_path / "run", check=3)
    assert "two files are called take0" in done.stderr


def test_a_run_has_its_tracks_from_one_source(tiny_run, takes, tmp_path):
    (tmp_path / "recipe.toml").write_text((tiny_run / "recipe.toml").read_text())
    done = piegraph("import", takes, "--run", tmp_path, check=2)
    assert "this run has its tracks from simulate" in done.stderr


def test_tracks_of_another_run_can_be_imported(tiny_run, tmp_path):
    source = tiny_run / "tracks" / "sequence_0001.h5"
    piegraph("import", source, "--run", tmp_path / "run")
    given, found = (read_artifact(path, "tracks") for path in (source, tmp_path / "run" / "tracks" / source.name))
    for name in ("positions", "end_effector", "time", "contact", "mode", "visibility"):
        np.testing.assert_array_equal(given[name], found[name])
