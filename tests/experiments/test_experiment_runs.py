"""An experiment in this process, small: its runs, what is read of them, and what is reported."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.dynamics.params import EGNNParams, PGNDParams
from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments import collect as of_collect
from piegraph_cli.experiments import run as of_run
from piegraph_cli.experiments.collect import collect, shown_trials
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import read_pieces
from piegraph_cli.experiments.recipes import recipe_of
from piegraph_cli.experiments.results import put_together
from piegraph_cli.experiments.run import Work, run_experiment, write_report
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.learning import read_model
from piegraph_cli.workspace.execute import Options

SMALL = ExperimentParams(
    title="small",
    table="guidance",
    interactions={"tblock": (2,)},
    models=("static", "piegraph-ng", "piegraph"),
    seeds=(3, 5),
    training=2,
    validation=1,
    test=1,
    strokes=2,
    horizons=(1,),
    steps=1e-6,
    trials={
        "models": ("piegraph", "static"),
        "goals": 1,
        "seeds": 3,
        "strokes": 1,
        "plan": {"samples": 4, "cem_iterations": 1},
    },
)


def work_in(folder, **settings) -> Work:
    """An experiment done in a folder, its pieces beside the runs."""
    return Work(folder, Options(device="cpu"), folder / "pieces", "piegraph reproduce small", **settings)


SEARCH = SMALL.model_copy(update={"table": "search", "trials": None, "models": ("piegraph",), "seeds": (3,)})


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of the finished experiment: read it, never write to it."""
    folder = tmp_path_factory.mktemp("experiments")
    assert [str(error) for error in run_experiment("small", SMALL, work_in(folder))] == []
    return folder


def test_an_experiment_makes_its_runs_and_its_grid_and_keeps_their_recipes(done):
    assert sorted(path.name for path in done.iterdir()) == ["pieces", "small", "tblock"]
    run, grid = open_run(done / "tblock"), open_run(done / "small" / "tblock")
    assert run.recipe == recipe_of(SMALL, "tblock", None)
    assert run.params("train").piegraph.steps == 10, "ten at least"
    fresh = [stage.name for stage in run.chain if all(run.fresh(stage, unit) for unit in run.units(stage))]
    assert fresh == ["simulate", "dataset", "train", "evaluate"], "all but the plan"
    assert [stage.name for stage in grid.chain] == ["trials"]
    assert len(list((done / "small" / "tblock" / "trials").iterdir())) == 6


def stages_of(monkeypatch) -> list[tuple[str, list[str], set[str]]]:
    """Stage, units and states of every call from now on."""
    ran: list[tuple[str, list[str], set[str]]] = []
    real = of_run.run_stage

    def noted(run, stage, options):
        outcomes = real(run, stage, options)
        ran.append((stage.name, list(options.only), {o.state for o in outcomes}))
        return outcomes

    monkeypatch.setattr(of_run, "run_stage", noted)
    return ran


def test_what_is_done_is_not_done_again(done, monkeypatch):
    ran, pieces = stages_of(monkeypatch), {p: p.read_bytes() for p in (done / "pieces").rglob("*.json")}
    assert run_experiment("small", SMALL, work_in(done)) == []
    assert {state for _, _, states in ran for state in states} == {"cached"}
    assert [(stage, len(units)) for stage, units, _ in ran] == [
        ("evaluate", 1),
        *[("train", 1), ("evaluate", 2)] * 2,
        *[("trials", 3)] * 2,
    ], "what is not trained, each training and what uses it, each model's trials"
    assert {p: p.read_bytes() for p in (done / "pieces").rglob("*.json")} == pieces


def test_every_model_and_seed_and_every_models_trials_leave_a_piece(done):
    kept = {piece.name: piece for piece in read_pieces(done / "pieces")}
    predictions = ["static", *(f"{m}@2.seed{s}" for m in ("piegraph", "piegraph-ng") for s in (3, 5))]
    assert set(kept) == {f"tblock/{n}.json" for n in predictions} | {
        "small/tblock/piegraph@2.json",
        "small/tblock/static.json",
    }
    ours, trials = kept["tblock/piegraph-ng@2.seed5.json"], kept["small/tblock/piegraph@2.json"]
    run = open_run(done / "tblock")
    assert ours.keys == {
        "dataset": run.key(STAGES["dataset"], None),
        "model": run.key(STAGES["train"], "piegraph@2.seed5"),
        "metrics": run.key(STAGES["evaluate"], "piegraph-ng@2.seed5"),
    }
    assert ours.versions == {name: STAGES[name].version for name in ("simulate", "dataset", "train", "evaluate")}
    metrics = run.read("metrics", "piegraph-ng@2.seed5")
    assert [row[0] for row in ours.rows] == sorted({n.decode() for n in metrics["sequence"]})
    assert ours.rows[0][1] == pytest.approx(metrics["pd"].mean(), rel=1e-5)
    assert ours.windows == {1: len(metrics["pd"])}
    assert ours.training is not None
    model = run.read("model", "piegraph@2.seed5")
    assert ours.training.steps == model["step"][-1]
    assert ours.training.loss == pytest.approx(np.nanmin(model["validation_loss"]), rel=1e-5)
    assert ours.training.static_loss == pytest.approx(float(model["static_loss"]), rel=1e-5)
    assert ours.training.parameters == sum(v.size for n, v in model.arrays.items() if n.startswith("weights/"))
    assert ours.training.made.cpu_s is not None
    assert "cores" in ours.made.machine or "core" in ours.made.machine
    assert ours.settings["simulate"]["seed"] == 0
    assert (trials.seed, [row[:2] for row in trials.rows]) == (None, [[0, 0], [0, 1], [0, 2]])
    assert len(trials.rows[0][2]) == 2, "before and after the stroke"
    assert trials.settings["plan"]["samples"] == 4
    assert trials.keys.keys() == {"dataset", "trials"}
    assert trials.keys["dataset"] == ours.keys["dataset"]
    assert kept["small/tblock/static.json"].keys.keys() == {"trials"}
    assert kept["small/tblock/static.json"].versions == {"trials": STAGES["trials"].version}
    assert "model" not in trials.settings["plan"]


def test_a_revised_model_is_trained_again_and_no_other(done, monkeypatch):
    units = [("train", "piegraph@2.seed3"), ("evaluate", "piegraph-ng@2.seed3"), ("evaluate", "static")]

    def fresh() -> list[bool]:
        run = open_run(done / "tblock")
        return [run.fresh(STAGES[stage], unit) for stage, unit in units]

    kept = open_run(done / "tblock").read("model", "piegraph@2.seed3")
    monkeypatch.setattr(PGNDParams, "revision", 2)
    assert fresh() == [True, True, True]
    assert read_model(kept).particles == kept["particles"]
    monkeypatch.setattr(EGNNParams, "revision", 2)
    assert fresh() == [False, False, True]
    assert open_run(done / "tblock").why_stale(STAGES["train"], "piegraph@2.seed3") == "settings changed: revision"
    with pytest.raises(DataError, match="piegraph of revision 1, this piegraph has revision 2"):
        read_model(kept)
    assert of_collect._revision("piegraph-ng@2") == {"piegraph": 2}
    assert of_collect._revision("static") == of_collect._revision("egnn-g@2") == {}


def test_time_that_is_up_leaves_pieces_for_the_next_time(done, tmp_path, monkeypatch, caplog):
    ran, work = stages_of(monkeypatch), work_in(tmp_path, until=0.0)
    assert run_experiment("small", SMALL, work) == []
    assert (ran, work.left) == ([], 5 + 2), "no environment is begun, and two models plan"
    times = iter([0.0, 0.0, 0.0])
    work = work_in(done, until=1.0)
    monkeypatch.setattr(of_run.Work, "do", lambda self, run, stage, units: ran.append((stage, *units)))
    monkeypatch.setattr(of_run, "time", SimpleNamespace(monotonic=lambda: next(times, 2.0)))
    run_experiment("small", SMALL, work)
    assert ran == [("evaluate", "static"), ("train", "piegraph@2.seed3"), ("evaluate", *of_seed(3))]
    assert work.left == 2 + 2, "two of the other seed, and the trials of two models"
    assert "the time is up: 4 pieces left; the same command goes on" in caplog.text


def of_seed(seed: int) -> tuple[str, str]:
    return f"piegraph-ng@2.seed{seed}", f"piegraph@2.seed{seed}"


def test_a_search_ends_with_its_trainings(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(of_run, "run_chain", lambda run, until, options: seen.append((run.folder, until)) or [])
    monkeypatch.setattr(of_run, "run_stage", lambda run, stage, options: seen.append((stage.name, options.only)) or [])
    assert run_experiment("search", SEARCH, work_in(tmp_path)) == []
    assert seen == [(tmp_path / "tblock", "dataset"), ("train", ("piegraph@2.seed3",))]


def test_recordings_are_rendered_first_and_have_runs_of_their_own(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(of_run, "run_chain", lambda run, until, options: seen.append(run) or [])
    monkeypatch.setattr(of_run, "run_stage", lambda run, stage, options: [])
    monkeypatch.setattr(of_run, "record_sequences", lambda *given, **more: seen.append((*given, more)) or [])
    params = SMALL.model_copy(update={"recordings": True, "trials": None})
    work = Work(tmp_path, Options(jobs=3), tmp_path / "pieces")
    assert run_experiment("small", params, work) == []
    (folder, settings, more), run = seen
    assert folder == tmp_path / "recordings" / "tblock"
    assert (settings.environment, settings.sequences, settings.strokes) == ("tblock", 4, 2)
    assert more == {"jobs": 3, "force": False}
    assert run.folder == tmp_path / "tblock-recorded"
    assert run.params("ingest").recording == ((tmp_path / "recordings" / "tblock").resolve(),)


def test_failures_of_runs_and_trials_are_told(tmp_path):
    params = SMALL.model_copy(update={"validation": 0, "training": 2, "test": 1, "horizons": (7,)})
    failed = run_experiment("small", params, work_in(tmp_path))
    assert len(failed) == 5, "no model has a window of seven strokes"
    assert all("strokes in a row" in str(error) for error in failed)
    predictions = [piece for piece in read_pieces(tmp_path / "pieces") if piece.kind == "model"]
    assert len(predictions) == 5
    assert all("strokes in a row" in str(piece.trouble) for piece in predictions)


def test_results_are_those_of_every_seed(done):
    found = put_together("small", SMALL, collect("small", SMALL, done, ""), shown_trials("small", SMALL, done))
    assert {m: len(seeds) for m, seeds in found.metrics["tblock"].items()} == {
        "static": 1,
        "piegraph-ng@2": 2,
        "piegraph@2": 2,
    }
    assert found.empty == []
    assert [(t.model, t.seed) for t in found.trials] == [(m, s) for m in ("piegraph@2", "static") for s in range(3)]
    shown = found.shown["tblock"]
    assert list(shown) == ["piegraph@2", "static"]
    middle = sorted((t for t in found.trials if t.model == "piegraph@2"), key=lambda t: t.pd[-1])[1]
    other = next(t for t in found.trials if (t.model, t.seed) == ("static", middle.seed))
    np.testing.assert_allclose(shown["piegraph@2"]["pd"], middle.pd, rtol=1e-5)
    np.testing.assert_allclose(shown["static"]["pd"], other.pd, rtol=1e-5)
    assert SMALL.trials is not None
    fewer = SMALL.model_copy(update={"trials": SMALL.trials.model_copy(update={"seeds": 2}), "seeds": (5,)})
    found = put_together("small", fewer, collect("small", fewer, done, ""))
    assert len(found.trials) == 4, "of the experiment as it is asked for, not as it was done"
    assert len(found.metrics["tblock"]["piegraph@2"]) == 1
    other_counts = put_together("small", fewer, read_pieces(done / "pieces"))
    assert [e.reason for e in other_counts.empty if e.trials] == [
        "made with other settings than those in force: trials.seeds was 3, is 2"
    ] * 2
    more = SMALL.model_copy(update={"seeds": (3, 5, 7)})
    found = put_together("small", more, collect("small", more, done, ""))
    assert {(e.model, e.reason) for e in found.empty} == {
        (f"{m}@2", "1 seed missing: 7") for m in ("piegraph", "piegraph-ng")
    }


def test_the_trial_to_look_at_is_the_median_of_the_first_model(monkeypatch):
    monkeypatch.setattr(of_collect, "read_artifact", lambda path, name: (path.name, name))
    run = open_run("nowhere")

    def trial(model, goal, seed, end):
        return Trial("toy", model, goal, seed, np.array([1.0, end]), np.array([2.0, 1.0]), np.zeros(1))

    ends = {(0, 0): 0.5, (0, 1): 0.1, (1, 0): 0.9, (1, 1): 0.2}
    trials = [trial("b", *task, end) for task, end in ends.items()] + [trial("a", *task, 0.0) for task in ends]
    names = {"b": "toy.b.goal00.seed00.h5", "a": "toy.a.goal00.seed00.h5"}
    assert of_collect._one_of_each(trials, run) == {m: (name, "trials") for m, name in names.items()}


def test_a_report_is_a_table_an_object_and_pictures(done, monkeypatch):
    class Figure:
        def savefig(self, path, dpi, format):
            path.write_text(f"{dpi} {format}")

    monkeypatch.setattr(of_run, "draw", lambda params, results: [("errors", Figure()), ("boxes", Figure())])
    value, lines, pictures = write_report("small", SMALL, work_in(done))
    report = done / "report"
    assert pictures == [report / "small_errors.png", report / "small_boxes.png"]
    assert pictures[0].read_text() == "110 png"
    assert (report / "small.txt").read_text() == "\n".join(lines) + "\n"
    kept = json.loads((report / "small.json").read_text())
    tables = {"predictions", "guidance", "trials", "cliffs_delta", "budget", "empty"}
    assert kept.keys() == value.keys() == {"title", "seeds", *tables}
    assert {(r["model"], r["seeds"]) for r in kept["predictions"]} == {
        ("static", 1),
        ("piegraph", 2),
        ("piegraph-ng", 2),
    }
    assert {r["model"] for r in kept["trials"]} == {"piegraph", "static"}


def test_a_report_needs_metrics_or_models(done, tmp_path, monkeypatch):
    with pytest.raises(DataError, match="no run of this experiment has results yet") as caught:
        write_report("small", SMALL, work_in(tmp_path))
    assert caught.value.hint == "piegraph reproduce small"
    monkeypatch.setattr(of_run, "draw", lambda params, results: [])
    search = SMALL.model_copy(update={"table": "search", "trials": None})
    value, lines, pictures = write_report("search", search, Work(done, Options(), tmp_path))
    assert ([row["model"] for row in value["search"]], pictures) == (["piegraph@2"], [])
    assert lines[0] == "small"


def test_experiments_of_untrained_models_train_what_a_run_needs():
    params = SMALL.model_copy(update={"models": ("static",)})
    recipe = recipe_of(params, "tblock", None)
    assert recipe.params(STAGES["train"]).models == ("piegraph",)
    assert recipe.params(STAGES["evaluate"]).models == ("static",)


@pytest.mark.parametrize(
    ("variant", "models", "left"),
    [
        ({"hidden": 7}, ("piegraph", "piegraph:other"), ["piegraph@2", "piegraph:other@2"]),
        ({}, ("piegraph", "piegraph:other"), ["piegraph@2"]),
        ({}, ("piegraph-ng", "piegraph-ng:other", "piegraph"), ["piegraph-ng@2", "piegraph@2"]),
        ({}, ("piegraph:other",), ["piegraph:other@2"]),
        ({}, ("static", "piegraph:other"), ["piegraph:other@2", "static"]),
    ],
)
def test_a_variant_is_left_out_where_it_is_its_model_again(variant, models, left):
    params = SMALL.model_copy(update={"models": models, "variants": {"piegraph:other": variant}})
    assert list(recipe_of(params, "tblock", None).params(STAGES["evaluate"]).models) == left
