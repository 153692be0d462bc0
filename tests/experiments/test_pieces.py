"""Pieces of experiments: how they are kept and read, which rows they make, and what cannot stand beside what."""

import json
from contextlib import contextmanager

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.tables import as_json
from piegraph_cli.experiments import pieces as of_pieces
from piegraph_cli.experiments.budget import budget_rows, hours
from piegraph_cli.experiments.pieces import (
    Made,
    Training,
    check_comparable,
    keep_pieces,
    read_piece,
    read_pieces,
    rounded,
)
from piegraph_cli.experiments.recipes import load_experiment, recipe_of
from piegraph_cli.experiments.results import put_together
from piegraph_cli.experiments.tables import describe, empty_lines, origin_lines
from piegraph_cli.stages import STAGES, open_run
from tests.experiments.made_up import COMMAND, MADE, experiment, played, predicted

PARAMS = experiment()
OURS = [predicted(PARAMS, "tblock", "piegraph@6", seed, [2.0, 4.0 + seed]) for seed in (0, 1)]
PGND = [predicted(PARAMS, "tblock", "pgnd@6", seed, [3.0, 5.0 + seed]) for seed in (0, 1)]
STATIC = predicted(PARAMS, "tblock", "static", 0, [9.0, 11.0])
LOST = Training(steps=9, parameters=3, loss=0.5, static_loss=0.5)
WHOLE = [*OURS, *PGND, STATIC]


def told(found) -> dict[str, str]:
    return {empty.model: empty.reason for empty in found.empty}


def test_a_piece_is_a_line_for_each_sequence_and_is_read_as_it_was_written(tmp_path):
    whole = OURS[0].model_copy(update={"rows": [[*row[:-1], None] for row in OURS[0].rows]})
    assert keep_pieces([whole, STATIC], tmp_path) == []
    path = tmp_path / "tblock" / "piegraph@6.seed0.json"
    text = path.read_text()
    assert json.loads(text)["rows"][0] == ["s0", 0.5, 5.0, 50.0, 2.0, 20.0, None]
    assert sum(line.startswith('  ["s') for line in text.splitlines()) == 2
    assert read_pieces(tmp_path) == [whole, STATIC]
    assert STATIC.name == "tblock/static.json"
    variant = OURS[0].model_copy(update={"place": "planning/tshirt:crumpled", "model": "piegraph:nohead@6"})
    assert variant.name == "planning/tshirt_crumpled/piegraph_nohead@6.seed0.json"
    arrays = read_piece(path).arrays
    np.testing.assert_array_equal(arrays["pd"], [0.5, 1.0, 2.0, 4.0])
    np.testing.assert_array_equal(arrays["horizon"], [1, 1, 4, 4])
    assert np.isnan(arrays["s"]).tolist() == [False, False, True, True]
    assert np.isnan(arrays["pd_truth"]).all()
    assert rounded([1.23456789, 0.000123456789], 4) == [1.235, 0.0001235]


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("{", "{{", "Invalid JSON"),
        ('"kind": "model"', '"kind": "dynamics"', "kind"),
        ('"seed": 0', '"seed": 1', "belongs to tblock/piegraph@6.seed1.json"),
        ('["s0",', '["s0",7,', "a row of 8 in place of 7 values"),
        ('"failed"', '"faild"', "faild: Extra inputs"),
    ],
)
def test_what_is_no_piece_is_refused_by_name(old, new, reason, tmp_path):
    keep_pieces(OURS[:1], tmp_path)
    path = tmp_path / OURS[0].name
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(DataError, match=reason) as caught:
        read_pieces(tmp_path)
    assert caught.value.where == str(path)


def test_a_piece_of_the_same_artifacts_stays_as_it_was_written(tmp_path):
    keep_pieces(OURS[:1], tmp_path)
    later = OURS[0].model_copy(update={"made": Made(date="2027-01-01"), "command": "another"})
    keep_pieces([later], tmp_path)
    assert read_pieces(tmp_path) == OURS[:1]
    other = later.model_copy(update={"keys": OURS[0].keys | {"metrics": "new"}})
    keep_pieces([other], tmp_path)
    assert read_pieces(tmp_path) == [other]


def test_a_full_disk_in_the_middle_loses_nothing(tmp_path, monkeypatch):
    real, count = of_pieces.atomic_file, []

    @contextmanager
    def full_at_the_second(path):
        count.append(path)
        with real(path) as temporary:
            yield temporary
            if len(count) == 2:
                raise OSError(28, "No space left on device")

    monkeypatch.setattr(of_pieces, "atomic_file", full_at_the_second)
    (error,) = keep_pieces(WHOLE[:3], tmp_path)
    assert "No space left" in str(error)
    assert error.where == str(tmp_path / WHOLE[1].name)
    assert read_pieces(tmp_path) == sorted([WHOLE[0], WHOLE[2]], key=lambda p: p.name)
    assert keep_pieces(WHOLE[:3], tmp_path) == []
    assert len(read_pieces(tmp_path)) == 3
    assert not list(tmp_path.rglob("*.tmp"))


def test_rows_are_of_models_that_are_whole():
    found = put_together("known", PARAMS, WHOLE)
    assert {m: len(of) for m, of in found.metrics["tblock"].items()} == {"piegraph@6": 2, "pgnd@6": 2, "static": 1}
    assert (found.empty, found.models, found.trials) == ([], {}, [])
    value, lines = describe(PARAMS, found)
    rows = {(r["model"], r["horizon"]): (r["pd"][0], r["windows"], r["seeds"]) for r in value["predictions"]}
    assert rows["piegraph", 4] == (pytest.approx(3.25), 2, 2)
    assert rows["piegraph", 1] == (pytest.approx(0.8125), 8, 2)
    assert rows["static", 4] == (pytest.approx(10), 2, 1)
    assert {r["model"]: (r["pd"][0], r["verdict"]) for r in value["against"]} == {
        "pgnd": (pytest.approx(1), "better"),
        "static": (pytest.approx(6.75), "better"),
    }
    assert "tblock: first or level against all of these" in lines
    assert value["empty"] == []


@pytest.mark.parametrize(
    ("pieces", "reason"),
    [
        ([*OURS, STATIC], "not measured"),
        ([*OURS, PGND[1], STATIC], "1 seed missing: 0"),
        (
            [*OURS, PGND[0], PGND[1].model_copy(update={"failed": "training diverged at step 30\nmore"}), STATIC],
            "seed 1 failed: training diverged at step 30",
        ),
        (
            [*OURS, PGND[0].model_copy(update={"training": LOST}), PGND[1]],
            "seed 0 did not learn: its loss, 0.5, is not below 0.5, that of nothing moving",
        ),
        (
            [*OURS, PGND[0], PGND[1].model_copy(update={"settings": {**PGND[1].settings, "train": {"steps": 7}}})],
            "seed 1 made with other settings than those in force: train.",
        ),
    ],
)  # fmt: skip
def test_a_row_that_lacks_something_is_empty_and_named_never_averaged_over_the_rest(pieces, reason):
    found = put_together("known", PARAMS, pieces)
    assert "pgnd@6" not in found.metrics["tblock"]
    assert told(found)["pgnd@6"].startswith(reason)
    assert any(line.startswith(f"tblock: pgnd@6: {reason}") for line in empty_lines(found))
    value, _ = describe(PARAMS, found)
    assert {r["model"] for r in value["predictions"]} <= {"piegraph", "static"}
    assert value["empty"][0]["model"] == "pgnd@6"


def test_a_model_whose_loss_is_below_that_of_nothing_moving_has_learned_as_far_as_is_known():
    assert OURS[0].trouble is None
    assert OURS[0].model_copy(update={"training": Training(steps=9, parameters=3, loss=0.5)}).trouble is None
    lost = Training(steps=9, parameters=3, loss=None, static_loss=0.5)
    assert "did not learn: its loss, nothing," in str(OURS[0].model_copy(update={"training": lost}).trouble)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"versions": OURS[1].versions | {"train": 8}}, "version of train is 8, there 7"),
        ({"keys": OURS[1].keys | {"dataset": "e" * 64}}, "dataset is eeeeeeeeeeee, there dddddddddddd"),
        (
            {"settings": OURS[1].settings | {"evaluate": OURS[1].settings["evaluate"] | {"gain": 9.0}}},
            "evaluate.gain is 9.0, there 0.03",
        ),
    ],
)
def test_rows_of_other_versions_or_data_are_refused_with_both_names(change, what):
    odd = PGND[0].model_copy(update=change)
    with pytest.raises(DataError, match=what) as caught:
        check_comparable([*OURS, odd, STATIC])
    assert "piegraph@6.seed0.json" in str(caught.value)
    assert "pgnd@6.seed0.json" in str(caught.value)
    check_comparable([*OURS, odd.model_copy(update={"environment": "toy"})])
    if "settings" not in change:
        with pytest.raises(DataError, match="cannot stand beside"):
            put_together("known", PARAMS, [*OURS, odd, PGND[1], STATIC])


def test_the_version_of_train_does_not_concern_what_is_not_trained():
    assert "train" not in STATIC.versions
    check_comparable([STATIC, *[p.model_copy(update={"versions": p.versions | {"train": 8}}) for p in OURS]])


def test_further_models_and_variants_leave_rows_and_keys_of_others_as_they_are(tmp_path):
    more = experiment(
        models=("piegraph:wide", "egnn-g", "piegraph", "pgnd", "static"), variants={"piegraph:wide": {"hidden": 77}}
    )
    before, after = (describe(p, put_together("known", p, WHOLE))[0]["predictions"] for p in (PARAMS, more))
    assert as_json(before) == as_json(after)
    runs = [open_run(tmp_path, recipe_of(p, "tblock", None)) for p in (PARAMS, more)]
    for stage, units in (("train", ("piegraph@6.seed0", "pgnd@6.seed1")), ("evaluate", ("piegraph@6.seed0", "static"))):
        assert len({run.key(STAGES[stage], unit) for run in runs for unit in units}) == len(units)


PLAYS = {"models": ("piegraph", "pgnd"), "goals": 2, "seeds": 2, "strokes": 1, "thresholds": (0.05,)}


def test_trials_are_in_the_table_where_all_were_played():
    params = experiment(trials=PLAYS)
    ours = played(params, "known", "tblock", "piegraph@6", [[0.01, 0.02], [0.03, 0.04]])
    rival = played(params, "known", "tblock", "pgnd@6", [[0.02, 0.1], [0.2, 0.3]])
    found = put_together("known", params, [*WHOLE, ours, rival])
    value, _ = describe(params, found)
    assert {r["model"]: (r["trials"], r["pd"]["mean"]) for r in value["trials"]} == {
        "piegraph": (4, pytest.approx(0.025)),
        "pgnd": (4, pytest.approx(0.155)),
    }
    failed = rival.model_copy(update={"failed": "tblock.pgnd@6.goal01.seed01: the planner fell over"})
    found = put_together("known", params, [*WHOLE, ours, failed])
    assert [t.model for t in found.trials] == ["piegraph@6"] * 4
    assert [(e.model, e.trials, e.tried) for e in found.empty] == [("pgnd@6", True, True)]
    found = put_together("known", params, [*WHOLE, ours])
    assert "tblock: pgnd@6: trials not measured" in empty_lines(found)
    other = rival.model_copy(update={"versions": {"trials": 5, "train": 7}})
    with pytest.raises(DataError, match="version of trials is 5, there 4"):
        put_together("known", params, [*WHOLE, ours, other])
    fewer = {**rival.settings, "trials": rival.settings["trials"] | {"strokes": 9}}
    found = put_together("known", params, [*WHOLE, ours, rival.model_copy(update={"settings": fewer})])
    assert told(found)["pgnd@6"] == "made with other settings than those in force: trials.strokes was 9, is 1"


def test_tables_say_when_where_and_by_what_their_figures_were_made():
    assert origin_lines(WHOLE) == [
        "2026-11-27; a processor, 2 cores",
        "piegraph 1.2.0; versions: simulate 3, dataset 4, evaluate 5, train 7",
        f"{(5 * 30 + 4 * 30) / 3600:.1f} hours of one core",
        COMMAND,
        "",
    ]
    assert hours(WHOLE) == pytest.approx(270 / 3600)
    assert hours([*WHOLE, STATIC.model_copy(update={"made": Made()})]) is None, "one does not say"
    assert hours([OURS[0], OURS[0]]) == pytest.approx(90 / 3600), "the same training"


def test_a_budget_has_what_each_model_was_given():
    search = load_experiment("search", quick=False)
    tried = [predicted(search, "tblock", f"pgnd:{v}@10", 0, [1.0]) for v in ("base", "rate", "batch", "step")]
    params = experiment(trials=PLAYS)
    plays = played(params, "known", "tblock", "pgnd@6", [[0.02, 0.1], [0.2, 0.3]])
    slower = PGND[1].training.model_copy(update={"steps": 5200, "made": MADE.model_copy(update={"cpu_s": 90.0})})
    pieces = [*OURS, PGND[0], PGND[1].model_copy(update={"training": slower}), STATIC, plays]
    rows = {r["model"]: r for r in budget_rows(put_together("known", params, pieces), tried)}
    assert rows.keys() == {"piegraph@6", "pgnd@6"}, "nothing is learned for static"
    pgnd, ours = rows["pgnd@6"], rows["piegraph@6"]
    assert (pgnd["candidates"], ours["candidates"]) == (4, None)
    assert (pgnd["steps"], pgnd["minutes"], pgnd["parameters"]) == (3900, pytest.approx(1.0), 26884)
    assert (pgnd["candidates_per_plan"], pgnd["trial_minutes"]) == (500, pytest.approx(0.5))
    assert (ours["candidates_per_plan"], ours["trial_minutes"]) == (None, None)
