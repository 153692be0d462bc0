"""What a workspace does, on a toy pipeline in this process: what is made, kept, made again, left out, told and cleaned."""

import dataclasses
import json
import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.errors import DataError, InputError, MissingError, PiegraphError, UsageError
from piegraph_cli.workspace import execute, known
from piegraph_cli.workspace.artifact import read_artifact, read_header, read_key
from piegraph_cli.workspace.clean import find_waste, remove
from piegraph_cli.workspace.execute import Checkpoint, LeftOut, Options, run_chain, run_stage, run_unit
from piegraph_cli.workspace.progress import silent
from piegraph_cli.workspace.recipe import Recipe, load_recipe, parse_setting
from piegraph_cli.workspace.run import FROM_OTHERS, Run
from piegraph_cli.workspace.survey import count_states, foresee, status
from tests.hdf5 import edited
from tests.workspace.toy import CALLS, SEEN, TABLE, open_toy, prepare

GATHER, POLISH, PILE, PAINT = (TABLE[name] for name in ("gather", "polish", "pile", "paint"))
UNITS = ["s0", "s1", "s2"]


@pytest.fixture(autouse=True)
def toy(monkeypatch):
    prepare(monkeypatch)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "toy run"


@pytest.fixture
def made(folder):
    """A run of which all is made."""
    run = open_toy(folder, gather={"weight": 2.0})
    run.save_recipe()
    outcomes = run_chain(run, None, Options())
    assert [o.state for o in outcomes] == ["done"] * 7
    CALLS.clear()
    return folder


def change(folder: Path, stage: str, **settings) -> Run:
    """The run with other settings, kept in its recipe."""
    run = open_toy(folder)
    run.recipe = run.recipe.with_values(TABLE[stage], settings, "test", folder)
    run.save_recipe()
    return open_toy(folder)


def states(folder: Path) -> dict[str, str]:
    return {f"{row['stage']} {row['unit']}".removesuffix(" None"): row["state"] for row in status(open_toy(folder))}


def test_a_chain_makes_every_artifact_from_those_before_it(folder):
    outcomes = run_chain(open_toy(folder, gather={"weight": 5.0}), None, Options(device="cpu"))
    assert [(o.stage, o.unit) for o in outcomes] == [
        *(("gather", unit) for unit in UNITS),
        *(("polish", unit) for unit in UNITS),
        ("pile", None),
    ]
    assert [o.quality for o in outcomes] == ["5 kg", "10 kg", "15 kg", *["shines 2"] * 3, "3 pebbles"]
    assert [o.warnings for o in outcomes][:3] == [(), ("heavy",), ("heavy",)]
    assert all(o.state == "done" and o.error is None and o.seconds > 0 for o in outcomes)
    run = open_toy(folder, gather={"weight": 5.0})
    heap, pebble = run.read("heap"), run.read("pebbles", "s1")
    assert float(heap["height"]) == 3 * 2 * 2 * (5 + 10 + 15)
    assert (heap.path, pebble.path) == (folder / "heap.h5", folder / "pebbles" / "s1.h5")
    assert heap.inputs == {f"pebbles/{unit}": run.key(POLISH, unit) for unit in UNITS}
    assert pebble.inputs == {"stones/s1": run.key(GATHER, "s1")}
    assert (pebble.params, pebble.quality, pebble.key) == (
        {"shine": 2.0, "breaks": ""},
        "shines 2",
        run.key(POLISH, "s1"),
    )
    header = read_header(pebble.path, "pebbles")
    assert header is not None
    assert (header.version, header.params, header.quality) == (3, pebble.params, "shines 2")
    inputs, params, context = SEEN["polish"]
    assert list(inputs) == ["stones"]
    assert inputs["stones"]["weight"].tolist() == [15, 15]
    assert (params.shine, context.unit, context.device, context.tell) == (2.0, "s2", "cpu", silent)
    gathered = SEEN["pile"][0]["pebbles"]
    assert (len(gathered), list(gathered)) == (3, UNITS)
    with pytest.raises(KeyError):
        gathered["s3"]


def test_what_is_fresh_is_not_made_again_unless_it_is_forced(made):
    again = run_chain(open_toy(made), None, Options())
    assert [(o.state, o.seconds) for o in again] == [("cached", 0.0)] * 7
    assert [o.quality for o in again] == ["2 kg", "4 kg", "6 kg", *["shines 2"] * 3, "3 pebbles"]
    assert CALLS == []
    forced = run_stage(open_toy(made), POLISH, Options(force=True, only=("s2", "s0")))
    assert [(o.unit, o.state) for o in forced] == [("s0", "done"), ("s2", "done")]
    assert CALLS == [("polish", "s0"), ("polish", "s2")]
    assert run_unit(open_toy(made), POLISH, "s1", Options()).state == "cached"
    assert run_unit(open_toy(made), POLISH, "s1", Options()).quality == "shines 2"
    assert run_unit(open_toy(made), POLISH, "s1", Options(force=True)).state == "done"


def test_a_damaged_artifact_is_stale_with_the_reason_and_made_again(made):
    path, whole = made / "stones" / "s1.h5", (made / "stones" / "s1.h5").read_bytes()
    path.write_bytes(whole[:-9] + bytes([whole[-9] ^ 4]) + whole[-8:])
    rows = {(row["stage"], row["unit"]): row for row in status(open_toy(made))}
    assert rows["gather", "s1"]["state"] == "stale"
    assert "the checksum differs" in rows["gather", "s1"]["reason"]
    outcomes = run_chain(open_toy(made), None, Options())
    assert [(o.stage, o.unit) for o in outcomes if o.state == "done"] == [("gather", "s1")], "the rest is what it was"
    assert set(states(made).values()) == {"fresh"}


def test_values_that_cannot_be_make_an_artifact_stale_when_they_are_read(made):
    with edited(made / "stones" / "s1.h5") as file:
        file["weight"][0] = np.nan
    change(made, "polish", shine=3.0)
    outcomes = run_chain(open_toy(made), "polish", Options())
    (failed,) = [o for o in outcomes if o.error]
    assert (failed.stage, failed.unit) == ("polish", "s1")
    assert "not finite at index (0,)" in str(failed.error)
    assert states(made)["gather s1"] == "stale"
    known._known_of.cache_clear()
    assert states(made)["gather s1"] == "stale", "another process knows it too"
    assert {o.state for o in run_chain(open_toy(made), None, Options())} == {"cached", "done"}
    assert set(states(made).values()) == {"fresh"}


def test_a_chain_ends_where_it_is_told_to(folder):
    run = open_toy(folder, paint={"colour": "blue"}, gather={})
    assert [o.stage for o in run_chain(run, "polish", Options())] == ["gather"] * 3 + ["polish"] * 3
    assert [o.stage for o in run_chain(run, None, Options()) if o.state == "done"] == ["pile", "paint"]
    assert float(open_toy(folder, paint={}, gather={}).read("heap")["height"]) == 72


def test_a_setting_makes_stale_what_depends_on_it_and_says_so(made):
    assert set(states(made).values()) == {"fresh"}
    run = change(made, "polish", shine=3.0)
    rows = {row["unit"] if row["stage"] == "polish" else row["stage"]: row for row in status(run)}
    assert rows["gather"]["state"] == "fresh"
    assert (rows["s1"]["state"], rows["s1"]["reason"], rows["s1"]["quality"]) == (
        "stale",
        "settings changed: shine",
        "",
    )
    assert (rows["pile"]["state"], rows["pile"]["reason"]) == ("stale", FROM_OTHERS)
    assert rows["gather"]["quality"] == "6 kg"
    assert rows["s1"]["bytes"] == (made / "pebbles" / "s1.h5").stat().st_size
    assert rows["s1"]["artifact"] == str(made / "pebbles" / "s1.h5")
    counts = {row["stage"]: row for row in count_states(list(status(run)))}
    assert (counts["polish"]["stale"], counts["polish"]["fresh"], counts["gather"]["fresh"]) == (3, 0, 3)
    assert counts["pile"]["bytes"] == (made / "heap.h5").stat().st_size
    would = [(row["stage"], row["unit"], row["reason"]) for row in foresee(open_toy(made), None, False)]
    assert would == [
        *(("polish", unit, "settings changed: shine") for unit in UNITS),
        ("pile", None, "pebbles would be made again"),
    ]
    assert [row["stage"] for row in foresee(open_toy(made), "polish", False)] == ["polish"] * 3
    done = [(o.stage, o.unit) for o in run_chain(open_toy(made), None, Options()) if o.state == "done"]
    assert done == [(stage, unit) for stage, unit, _ in would]
    assert set(states(made).values()) == {"fresh"}


def test_a_new_version_a_lost_file_and_a_broken_one_are_told_apart(made, monkeypatch):
    (made / "stones" / "s0.h5").unlink()
    (made / "stones" / "s1.h5").write_bytes(b"no hdf5")
    monkeypatch.setitem(TABLE, "polish", dataclasses.replace(POLISH, version=4))
    rows = {(row["stage"], row["unit"]): row for row in status(open_toy(made))}
    assert rows["gather", "s0"]["state"] == "missing"
    assert rows["gather", "s0"]["bytes"] == 0
    assert rows["gather", "s1"]["state"] == "stale"
    assert "not a readable HDF5 file" in rows["gather", "s1"]["reason"]
    assert rows["polish", "s2"]["reason"] == "made by version 3 of the stage, this is version 4"
    would = {(row["stage"], row["unit"]): row["reason"] for row in foresee(open_toy(made), None, True)}
    assert would["gather", "s0"] == "missing"
    assert would["gather", "s2"] == "--force"
    assert would["polish", "s2"].startswith("--force, and made by version 3")


def test_further_units_keep_those_that_are_done(made):
    more = run_chain(change(made, "gather", count=4), None, Options())
    assert Counter((o.stage, o.state) for o in more) == {
        ("gather", "cached"): 3,
        ("gather", "done"): 1,
        ("polish", "cached"): 3,
        ("polish", "done"): 1,
        ("pile", "done"): 1,
    }


def test_a_unit_that_fails_leaves_the_others_be_and_is_left_out_after(folder, caplog):
    run = open_toy(folder, gather={}, polish={"breaks": "s1"})
    run.save_recipe()
    outcomes = run_chain(run, None, Options())
    assert [(o.unit, o.state) for o in outcomes if o.stage == "polish"] == [
        ("s0", "done"),
        ("s1", "failed"),
        ("s2", "done"),
    ]
    assert outcomes[-1].quality == "2 pebbles"
    assert "polish failed on s1: s1: the stone broke" in caplog.text
    record = json.loads((folder / "failures.json").read_text())
    assert list(record) == ["polish/s1"]
    assert record["polish/s1"]["message"] == "s1: the stone broke\n  try: take another"
    (row,) = (row for row in status(open_toy(folder)) if row["state"] == "failed")
    assert (row["stage"], row["unit"], row["failure"]) == ("polish", "s1", record["polish/s1"]["message"])
    assert open_toy(folder).made("pebbles") == ["s0", "s2"]
    would = [(row["unit"], row["reason"]) for row in foresee(open_toy(folder), None, False)]
    assert would == [("s1", "failed before: s1: the stone broke"), (None, "pebbles would be made again")]
    CALLS.clear()
    again = run_chain(open_toy(folder), None, Options())
    assert CALLS == [("polish", "s1")], "what failed is tried again, what is done is not"
    assert [o.state for o in again if o.stage == "pile"] == ["cached"]
    repaired = run_chain(change(folder, "polish", breaks="nothing"), None, Options())
    assert all(o.state == "done" for o in repaired if o.stage != "gather")
    assert json.loads((folder / "failures.json").read_text()) == {}
    assert set(states(folder).values()) == {"fresh"}


def test_what_failed_in_an_earlier_stage_is_not_tried_in_the_next(folder, monkeypatch):
    shiny = dataclasses.replace(PAINT, name="shiny", reads=("pebbles",), units=None, unit="stone", on_demand=False)
    monkeypatch.setitem(TABLE, "shiny", dataclasses.replace(shiny, run="tests.workspace.toy:gather", writes="stones2"))
    run = open_toy(folder, gather={}, polish={"breaks": "s0"})
    run_stage(run, GATHER, Options())
    run_stage(run, POLISH, Options())
    CALLS.clear()
    found = run_stage(open_toy(folder, gather={}, polish={"breaks": "s0"}), TABLE["shiny"], Options(only=("s0",)))
    (outcome,) = found
    assert isinstance(outcome.error, LeftOut)
    assert (outcome.state, outcome.unit, CALLS) == ("failed", "s0", [])
    assert "left out, since it failed before: s0: the stone broke" in str(outcome.error)
    assert "take another" not in str(outcome.error)
    assert open_toy(folder, gather={}, polish={"breaks": "s0"}).state(TABLE["shiny"], "s0") == "failed"


def test_what_all_failed_has_nothing_to_be_gathered_from(folder):
    run = open_toy(folder, gather={"count": 1}, polish={"breaks": "s0"})
    with pytest.raises(DataError, match="no stone has pebbles: s0: the stone broke") as caught:
        run_chain(run, None, Options())
    assert "take another" not in str(caught.value)
    assert f"piegraph status --run '{folder}'" in caught.value.hint


def test_a_bug_is_told_as_one_with_its_place(folder, caplog):
    run = open_toy(folder, gather={"count": 1}, polish={"shine": -1.0})
    run_stage(run, GATHER, Options())
    (outcome,) = run_stage(run, POLISH, Options())
    assert outcome.state == "failed"
    assert type(outcome.error) is PiegraphError
    assert "bug in polish: ValueError: no shine" in str(outcome.error)
    assert outcome.error.hint == f"the traceback is in {folder}/run.log"
    assert "toy.py" in outcome.error.traceback
    assert (outcome.error.exit_code, outcome.seconds > 0) == (1, True)


def test_a_stage_that_fails_for_the_run_as_a_whole_ends_the_chain(folder):
    run = open_toy(folder, gather={}, pile={"stops": 3}, paint={})
    outcomes = run_chain(run, None, Options())
    assert (outcomes[-1].stage, outcomes[-1].state) == ("pile", "failed")


def test_a_long_stage_goes_on_from_its_checkpoint(folder):
    kept = folder / "checkpoints" / "pile.None.h5"
    run_chain(open_toy(folder, gather={}, pile={"steps": 4, "stops": 3}), None, Options())
    key = read_key(kept, "checkpoint")
    assert key == open_toy(folder, gather={}, pile={"steps": 4, "stops": 3}).key(PILE, None)
    CALLS.clear()
    run_stage(open_toy(folder, gather={}, pile={"steps": 5}), PILE, Options())
    assert ("pile from", 0) in CALLS, "another key"
    run_chain(open_toy(folder, gather={}, pile={"steps": 4, "stops": 3}), None, Options())
    assert ("pile from", 2) not in CALLS, "the other one's state was in its place, and is gone"
    CALLS.clear()
    run_stage(open_toy(folder, gather={}, pile={"steps": 4, "stops": 3}), PILE, Options())
    assert ("pile from", 2) in CALLS
    checkpoint = Checkpoint(kept, PILE, str(key))
    state = checkpoint.load()
    assert state is not None
    checkpoint.clock.add(7000, 5000)
    checkpoint.save(state)
    assert 7000 <= read_artifact(kept, "checkpoint").made["wall_ms"] < 9000
    assert Checkpoint(kept, PILE, str(key)).clock.spent()["cpu_ms"] < 3000
    again = Checkpoint(kept, PILE, str(key))
    again.load()
    assert again.clock.spent()["cpu_ms"] >= 5000, "what the first try took counts"
    assert {name: float(value) for name, value in state.items()} == {"done": 2, "total": 48}
    assert Checkpoint(kept, PILE, "other").load() is None
    assert Checkpoint(kept.with_name("none.h5"), PILE, str(key)).load() is None


def test_a_finished_stage_leaves_no_checkpoint(made):
    assert list((made / "checkpoints").iterdir()) == []
    assert not list(made.rglob("*.tmp"))


def test_the_state_of_what_is_made_goes(made):
    """Its process was killed after it had written the artifact."""
    state = Checkpoint(made / "checkpoints" / "pile.None.h5", PILE, str(open_toy(made).key(PILE, None)))
    state.save({"done": np.array(1)})
    run_chain(open_toy(made), None, Options())
    assert not state.path.exists()


def test_leftovers_of_a_killed_process_go_when_the_artifact_is_made(made):
    left = [made / "stones" / ".s0.h5.77.tmp", made / "checkpoints" / ".gather.s0.h5.77.tmp"]
    for path in left:
        path.write_bytes(b"half")
    run_stage(open_toy(made), GATHER, Options(only=("s0",), force=True))
    assert not any(path.exists() for path in left)


def test_a_second_process_waits_and_uses_what_the_first_one_made(made):
    outcomes: list[execute.Outcome] = []
    work = threading.Thread(target=lambda: outcomes.append(run_unit(open_toy(made), POLISH, "s1", Options(force=True))))
    with open_toy(made).lock("pebbles/s1"):
        work.start()
        work.join(0.3)
        assert not outcomes
    work.join(30)
    assert (outcomes[0].state, CALLS) == ("cached", [])


def test_other_processes_find_what_is_known_when_they_start(folder, monkeypatch):
    """What many units share is hashed before the processes begin, and not by each."""
    source = folder.with_name("source.bin")
    source.write_bytes(b"stone")
    monkeypatch.setattr(known, "TICK", 0)
    begun = []

    def each(work, items, jobs, backend, lost):
        begun.append((jobs, backend, list(items), (folder / known.NAME).exists()))
        return map(work, items)

    monkeypatch.setattr(execute, "each", each)
    folder.mkdir()
    run = open_toy(folder, gather={"source": str(source)})
    for stage, options in ((GATHER, Options(jobs=2)), (POLISH, Options(jobs=8)), (PILE, Options(jobs=2))):
        known._known_of.cache_clear()
        (folder / known.NAME).unlink(missing_ok=True)
        run_stage(run, stage, options)
        assert (folder / known.NAME).exists(), "what a stage found out is kept after it too"
    run_stage(run, GATHER, Options(only=("s0",), force=True, backend="ray"))
    assert begun == [
        (2, "local", UNITS, True),
        (3, "local", UNITS, True),
        (1, "local", [None], False),
        (1, "ray", ["s0"], True),
    ]


def test_an_item_that_is_lost_is_a_failure_of_its_unit(folder, monkeypatch):
    error = DataError("gone")
    monkeypatch.setattr(execute, "each", lambda work, items, jobs, backend, lost: (lost(u, error) for u in items))
    outcomes = run_stage(open_toy(folder, gather={}), GATHER, Options())
    assert [(o.stage, o.unit, o.state, o.error) for o in outcomes] == [("gather", u, "failed", error) for u in UNITS]


def test_a_full_disk_for_failures_keeps_the_outcomes(folder, monkeypatch, caplog):
    def full(*_):
        raise DataError("no space")

    monkeypatch.setattr(Run, "record_failures", full)
    assert [o.state for o in run_stage(open_toy(folder, gather={}), GATHER, Options())] == ["done"] * 3
    assert "no space" in caplog.text


def test_equal_failures_and_warnings_are_told_once_with_their_units(folder, caplog):
    caplog.set_level("DEBUG", "piegraph")
    run_chain(open_toy(folder, gather={"weight": 4.0}, polish={"shine": -1.0}), "polish", Options())
    told = [r.getMessage() for r in caplog.records]
    assert sum("polish failed on s0, s1, s2: " in text for text in told) == 1
    assert "gather s2: heavy" in told
    assert any(text.startswith("gather s1: 8 kg (") for text in told)
    assert any("Traceback" in text for text in told)


def test_inputs_that_are_not_fresh_are_refused_with_the_command_that_makes_them(made):
    run = change(made, "polish", shine=5.0)
    with pytest.raises(InputError, match="pebbles is stale") as caught:
        run.read("pebbles", "s0")
    assert caught.value.where == str(made / "pebbles" / "s0.h5")
    assert caught.value.hint == f"piegraph run --run '{made}' --until polish"
    with pytest.raises(InputError, match="heap is stale") as caught:
        run.read("heap")
    assert caught.value.hint == "pile it in toy run"
    (made / "heap.h5").unlink()
    with pytest.raises(InputError, match="heap is missing"):
        open_toy(made).read("heap")
    (outcome,) = run_stage(change(made, "polish", shine=6.0), PILE, Options())
    assert isinstance(outcome.error, InputError)
    assert not [place for place in open_toy(made).failures if place.startswith(PILE.name)], "it is tried again"


def test_a_source_counts_by_its_content_and_may_be_gone_later(folder):
    sources = folder.with_name("sources")
    (sources / "s0").mkdir(parents=True)
    (sources / "s1").mkdir()
    for unit in ("s0", "s1"):
        (sources / unit / "stone.bin").write_bytes(unit.encode())
    run = open_toy(folder, gather={"count": 2, "source": str(sources)})
    run.save_recipe()
    run_stage(run, GATHER, Options())
    assert states(folder)["gather s0"] == "fresh"
    (sources / "s1" / "stone.bin").write_bytes(b"other")
    assert [states(folder)[f"gather {unit}"] for unit in ("s0", "s1")] == ["fresh", "stale"], "a part per unit"
    sources.rename(sources.with_name("elsewhere"))
    assert [states(folder)[f"gather {unit}"] for unit in ("s0", "s1")] == ["fresh", "fresh"]
    with pytest.raises(DataError, match="no such file or folder"):
        change(folder, "gather", weight=3.0).key(GATHER, "s0")


def test_two_processes_that_record_failures_keep_each_others(folder):
    first, second = open_toy(folder, gather={}), open_toy(folder, gather={})
    assert second.failures == {}
    first.record_failures(GATHER, ["s0"], {"s0": DataError("one")})
    second.record_failures(GATHER, ["s1"], {"s1": DataError("two")})
    assert set(json.loads((folder / "failures.json").read_text())) == {"gather/s0", "gather/s1"}
    assert second.failure(GATHER, "s0") == "one"
    second.record_failures(GATHER, ["s0", "s2"], {})
    assert set(open_toy(folder, gather={}).failures) == {"gather/s1"}
    assert open_toy(folder, gather={"weight": 2.0}).failure(GATHER, "s1") is None, "not with other settings"


def test_a_run_keeps_its_recipe_and_a_folder_is_no_file(folder):
    run = open_toy(folder, gather={"weight": 7.0})
    run.save_recipe()
    kept = folder / "recipe.toml"
    assert Run.open(folder, TABLE).recipe == run.recipe
    assert Run.open(folder, TABLE).params("gather").weight == 7
    stamp = kept.stat().st_mtime_ns
    open_toy(folder, gather={"weight": 7.0}).save_recipe()
    assert kept.stat().st_mtime_ns == stamp
    open_toy(folder, gather={"weight": 8.0}).save_recipe()
    assert load_recipe(kept, TABLE).params(GATHER).weight == 8
    with pytest.raises(UsageError, match="is a file"):
        Run.open(kept, TABLE)
    assert Run.open(folder.with_name("none"), TABLE).recipe == Recipe(TABLE)
    beside = run.beside(folder)
    assert beside is run.beside(folder)
    assert beside.params("gather").weight == 8


@pytest.mark.parametrize(
    ("sections", "chain"),
    [
        ((), ["gather", "polish", "pile"]),
        (("polish",), ["gather", "polish", "pile"]),
        (("paint",), ["gather", "polish", "pile", "paint"]),
        (("quarry",), ["quarry", "polish", "pile"]),
        (("gather", "quarry"), ["quarry", "polish", "pile"]),
    ],
)
def test_a_recipe_has_its_sources_and_what_follows_from_them(sections, chain):
    recipe = Recipe(TABLE, {name: {} for name in sections})
    assert [stage.name for stage in recipe.chain()] == chain


def test_the_maker_of_an_artifact_is_that_of_the_chain_or_else_the_first(folder):
    assert open_toy(folder, quarry={}).maker("stones").name == "quarry"
    assert open_toy(folder, gather={}).maker("stones").name == "gather"
    run = open_toy(folder, gather={})
    assert (run.maker("picture").name, run.producer("picture")) == ("paint", None)
    assert run.made("picture") == []
    assert run.units(POLISH) == UNITS
    assert open_toy(folder, quarry={}).units(POLISH) == ["s0"]


def test_settings_as_text():
    assert parse_setting("polish.shine = 3", TABLE) == (POLISH, "shine", 3)
    assert parse_setting("polish.breaks=s=1", TABLE) == (POLISH, "breaks", "s=1")
    assert parse_setting("pile.a.b=[1, 2]", TABLE) == (PILE, "a.b", [1, 2])
    for wrong in ("shine=3", "polish.shine", "grind.shine=3", "polish=3"):
        with pytest.raises(UsageError, match="cannot read --set"):
            parse_setting(wrong, TABLE)


def test_waste_is_what_nothing_uses(made):
    stray = made / "stones" / "s9.h5"
    stray.write_bytes((made / "stones" / "s0.h5").read_bytes())
    (made / "notes.h5").write_bytes((made / "heap.h5").read_bytes())
    change(made, "pile", steps=2)
    Checkpoint(made / "checkpoints" / "pile.None.h5", PILE, "other").save({"done": np.array(1)})
    Checkpoint(made / "checkpoints" / "pile.gone.h5", PILE, "other").save({"done": np.array(1)})
    found = {one.path.relative_to(made).as_posix(): one for one in find_waste(open_toy(made))}
    reasons = {name: one.reason for name, one in found.items()}
    assert reasons == {
        "stones/s9.h5": "of no stone of this run",
        "heap.h5": "stale: settings changed: steps",
        "checkpoints/pile.None.h5": "checkpoint that nothing goes on from",
        "checkpoints/pile.gone.h5": "checkpoint of nothing in this run",
    }
    assert found["stones/s9.h5"].lock == made / ".locks" / "stones.s9.lock"
    assert found["heap.h5"].bytes == (made / "heap.h5").stat().st_size
    gone = remove(list(found.values()))
    assert {one.path for one in gone} == {one.path for one in found.values()}
    assert not any(one.path.exists() for one in found.values())
    assert (made / "notes.h5").exists()
    assert find_waste(open_toy(made)) == []


def test_an_artifact_of_another_kind_in_the_place_of_one_is_made_again(made):
    (made / "stones" / "s0.h5").write_bytes((made / "pebbles" / "s0.h5").read_bytes())
    assert states(made)["gather s0"] == "stale"
    with pytest.raises(DataError, match="holds pebbles, expected stones"):
        read_artifact(made / "stones" / "s0.h5", "stones")
    assert read_artifact(made / "stones" / "s0.h5").name == "pebbles"


def checking(folder: Path, checks: dict, **sections) -> Run:
    """A run some of whose stages look before anything is done."""
    table = TABLE | {name: dataclasses.replace(TABLE[name], check=check) for name, check in checks.items()}
    return Run(folder, Recipe(table, sections))


def test_stages_look_at_what_they_need_before_the_first_one_works(folder, caplog):
    seen = []

    def look(run, units, processes):
        seen.append((units, processes, list(CALLS)))
        return ["bring a ladder"]

    run_chain(checking(folder, {"gather": look, "pile": look}), None, Options(jobs=1))
    assert seen == [(UNITS, 1, []), ([None], 1, [])]
    assert caplog.messages[:2] == ["gather: bring a ladder", "pile: bring a ladder"]
    seen.clear()
    run_chain(checking(folder, {"gather": look, "pile": look}, pile={"steps": 4}), None, Options(jobs=1))
    assert [units for units, _, _ in seen] == [[None]]  # what is fresh needs nothing
    seen.clear()
    again = checking(folder, {"gather": look})
    run_stage(again, again.recipe.table["gather"], Options(force=True, only=("s0", "s2"), jobs=1))
    assert [units for units, _, _ in seen] == [["s0", "s2"]]


def test_what_a_later_stage_lacks_ends_a_chain_before_it_begins(folder):
    def lack(run, units, processes):
        raise MissingError("no ladder")

    with pytest.raises(MissingError, match="no ladder"):
        run_chain(checking(folder, {"pile": lack}), None, Options())
    assert CALLS == []
    assert not (folder / "stones").exists()
    assert [o.state for o in run_chain(checking(folder, {"pile": lack}), "polish", Options())] == ["done"] * 6
