"""Several recordings in one run: names that do not collide, cameras of their own, and what stays when one is added or goes."""

import json

import pytest

from piegraph_cli.stages import open_run
from piegraph_cli.stages.score import read_truth
from piegraph_cli.workspace.artifact import read_artifact
from tests.cli import piegraph, piegraph_json
from tests.envelopes import checked
from tests.stages.make_recording import make_recording


@pytest.fixture
def days(tmp_path):
    """Two recordings with the same names of sequences; on the second day the cameras stand higher."""
    folders = [make_recording(tmp_path / name) for name in ("monday", "tuesday")]
    path = folders[1] / "cameras.json"
    entries = json.loads(path.read_text())
    for entry in entries["cameras"].values():
        entry["T_world_camera"][2][3] = 0.9
    path.write_text(json.dumps(entries))
    return folders


def ingest(run, *recordings, **more):
    options = [word for path in recordings for word in ("--recording", path)]
    return {o["unit"]: o["state"] for o in piegraph_json("ingest", "--run", run, *options, **more)["outcomes"]}


def heights(run, unit):
    return read_artifact(run / "frames" / f"{unit}.h5", "frames")["T_world_camera"][:, 2, 3].tolist()


def test_a_recording_that_is_added_leaves_the_others_fresh(days, tmp_path):
    run = tmp_path / "run"
    assert ingest(run, days[0]) == {"seq 0": "done", "seq 1": "done"}
    alone = {p.stem: read_artifact(p).key for p in (run / "frames").iterdir()}
    added = {"seq 0": "cached", "seq 1": "cached", "tuesday-seq 0": "done", "tuesday-seq 1": "done"}
    assert ingest(run, *days) == added
    assert {unit: read_artifact(run / "frames" / f"{unit}.h5").key for unit in alone} == alone
    assert heights(run, "seq 0") == [0.8, 0.8]
    assert heights(run, "tuesday-seq 0") == [0.9, 0.9]
    assert set(ingest(run).values()) == {"cached"}, "the recipe keeps both"
    assert open_run(run).recipe.sections["ingest"]["recording"] == [str(day) for day in days]


def test_other_names_stay_and_folders_of_one_name_get_more_of_their_path(tmp_path):
    first = make_recording(tmp_path / "a" / "rec", sequences=1)
    second = make_recording(tmp_path / "b" / "rec", sequences=2)
    third = make_recording(tmp_path / "c" / "rec", sequences=1)
    names = list(ingest(tmp_path / "run", first, second, third))
    assert sorted(names) == sorted(["seq 0", "rec-seq 0", "seq 1", "c-rec-seq 0"])


def test_a_recipe_may_list_them_and_one_is_one(days, tmp_path):
    (tmp_path / "two.toml").write_text('[ingest]\nrecording = ["monday", "tuesday"]\nexclude = ["tuesday-seq 1"]\n')
    piegraph("run", tmp_path / "two.toml", "--run", tmp_path / "run", "--until", "ingest", cwd="/")
    assert open_run(tmp_path / "run").units(open_run(tmp_path / "run").chain[0]) == ["seq 0", "seq 1", "tuesday-seq 0"]
    ingest(tmp_path / "other", days[0])
    assert open_run(tmp_path / "other").recipe.sections["ingest"]["recording"] == str(days[0])


def test_one_that_is_gone_is_named_and_what_was_read_of_it_stays(days, tmp_path):
    run = tmp_path / "run"
    ingest(run, *days)
    moved = days[0].rename(tmp_path / "archive")
    done = piegraph("ingest", "--run", run, "--json")
    assert f"the recording {days[0]} is gone: its 2 sequences stay as they were read" in done.stderr
    assert {o["state"] for o in checked(done.stdout)["result"]["outcomes"]} == {"cached"}
    assert set(ingest(run, moved, days[1]).values()) == {"cached"}, "content counts, not the place"
    assert read_truth(open_run(run), "seq 0") is None


def test_what_is_wrong_with_several_is_said(days, tmp_path):
    run = tmp_path / "run"
    refused = piegraph("ingest", "--run", run, "--recording", days[0], "--recording", days[0], check=2)
    assert f"{days[0]}: ingest.recording: one recording is given twice" in refused.stderr
    refused = piegraph("ingest", "--run", run, "--recording", days[0], "--recording", tmp_path / "none", check=3)
    assert f"{tmp_path / 'none'}: no such recording folder" in refused.stderr
    refused = piegraph("ingest", "--run", run, "--recording", days[0], "--exclude", "tuesday-seq 0", check=2)
    assert "no sequence tuesday-seq 0" in refused.stderr
    assert not (run / "frames").exists()


def test_boards_are_told_for_each_recording(days, tmp_path):
    for day, board in zip(days, ("seq 0", "seq 1"), strict=True):
        entries = json.loads((day / "cameras.json").read_text()) | {"calibration_sequence": board}
        (day / "cameras.json").write_text(json.dumps(entries))
    run = tmp_path / "run"
    done = piegraph("ingest", "--run", run, "--recording", days[0], "--recording", days[1])
    assert sorted(p.stem for p in (run / "frames").iterdir()) == ["seq 1", "tuesday-seq 0"]
    for board in ("seq 0", "seq 1"):
        assert f"{board} is left out: by cameras.json it shows the calibration board" in done.stderr
