"""An experiment in this process, small: its runs, what is read of them, and what is reported."""

import json

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments import results as of_results
from piegraph_cli.experiments import run as of_run
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.recipes import recipe_of
from piegraph_cli.experiments.results import read_results
from piegraph_cli.experiments.run import run_experiment, write_report
from piegraph_cli.stages import STAGES, open_run
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
SEARCH = SMALL.model_copy(update={"table": "search", "trials": None, "models": ("piegraph",), "seeds": (3,)})


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of the finished experiment: read it, never write to it."""
    folder = tmp_path_factory.mktemp("experiments")
    assert [str(error) for error in run_experiment("small", SMALL, folder, Options(device="cpu"))] == []
    return folder


def test_an_experiment_makes_its_runs_and_its_grid_and_keeps_their_recipes(done):
    assert sorted(path.name for path in done.iterdir()) == ["small", "tblock"]
    run, grid = open_run(done / "tblock"), open_run(done / "small" / "tblock")
    assert run.recipe == recipe_of(SMALL, "tblock", None)
    assert run.params("train").piegraph.steps == 10, "ten at least"
    fresh = [stage.name for stage in run.chain if all(run.fresh(stage, unit) for unit in run.units(stage))]
    assert fresh == ["simulate", "dataset", "train", "evaluate"], "all but the plan"
    assert [stage.name for stage in grid.chain] == ["trials"]
    assert len(list((done / "small" / "tblock" / "trials").iterdir())) == 6


def test_what_is_done_is_not_done_again(done, monkeypatch):
    ran = []

    def noting(name):
        real = getattr(of_run, name)

        def noted(*given):
            outcomes = real(*given)
            ran.append([o.state for o in outcomes])
            return outcomes

        monkeypatch.setattr(of_run, name, noted)

    noting("run_chain")
    noting("run_stage")
    assert run_experiment("small", SMALL, done, Options()) == []
    assert [set(states) for states in ran] == [{"cached"}, {"cached"}]
    assert len(ran[1]) == 6


def test_a_search_ends_with_its_trainings(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(of_run, "run_chain", lambda run, until, options: seen.append((run, until)) or [])
    assert run_experiment("search", SEARCH, tmp_path, Options()) == []
    assert [(run.folder, until) for run, until in seen] == [(tmp_path / "tblock", "train")]


def test_recordings_are_rendered_first_and_have_runs_of_their_own(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(of_run, "run_chain", lambda run, until, options: seen.append((run.folder, until)) or [])
    monkeypatch.setattr(of_run, "record_sequences", lambda *given, **more: seen.append((*given, more)) or [])
    params = SMALL.model_copy(update={"recordings": True, "trials": None})
    assert run_experiment("small", params, tmp_path, Options(jobs=3)) == []
    (folder, settings, more), chain = seen
    assert folder == tmp_path / "recordings" / "tblock"
    assert (settings.environment, settings.sequences, settings.strokes) == ("tblock", 4, 2)
    assert more == {"jobs": 3, "force": False}
    assert chain == (tmp_path / "tblock-recorded", "evaluate")
    monkeypatch.setattr(of_results, "read_metrics", lambda run: (seen.append(run) or {}, []))
    read_results("small", params, tmp_path)
    assert seen[-1].folder == tmp_path / "tblock-recorded"
    assert seen[-1].params("ingest").recording == ((tmp_path / "recordings" / "tblock").resolve(),)


def test_failures_of_runs_and_trials_are_told(tmp_path):
    params = SMALL.model_copy(update={"validation": 0, "training": 2, "test": 1, "horizons": (7,)})
    failed = run_experiment("small", params, tmp_path, Options())
    assert len(failed) == 5, "no model has a window of seven strokes"
    assert all("strokes in a row" in str(error) for error in failed)


def test_results_are_those_of_every_seed(done):
    found = read_results("small", SMALL, done)
    assert {m: len(seeds) for m, seeds in found.metrics["tblock"].items()} == {
        "static": 1,
        "piegraph-ng@2": 2,
        "piegraph@2": 2,
    }
    (models,) = found.models.values()
    assert {m: len(seeds) for m, seeds in models.items()} == {"piegraph@2": 2}
    assert {name: set(one.arrays) for name, (one, _) in models.items()} == {"piegraph@2": {"validation_loss", "step"}}
    assert [(t.model, t.seed) for t in found.trials] == [(m, s) for m in ("piegraph@2", "static") for s in range(3)]
    shown = found.shown["tblock"]
    assert list(shown) == ["piegraph@2", "static"]
    middle = sorted((t for t in found.trials if t.model == "piegraph@2"), key=lambda t: t.pd[-1])[1]
    other = next(t for t in found.trials if (t.model, t.seed) == ("static", middle.seed))
    np.testing.assert_array_equal(shown["piegraph@2"]["pd"], middle.pd)
    np.testing.assert_array_equal(shown["static"]["pd"], other.pd)
    assert SMALL.trials is not None
    fewer = SMALL.model_copy(update={"trials": SMALL.trials.model_copy(update={"seeds": 2}), "seeds": (5,)})
    found = read_results("small", fewer, done)
    assert len(found.trials) == 4, "of the experiment as it is asked for, not as it was done"
    assert len(found.metrics["tblock"]["piegraph@2"]) == len(found.models["tblock"]["piegraph@2"]) == 1
    without = read_results("small", SMALL.model_copy(update={"trials": None}), done)
    assert (without.trials, without.shown) == ([], {})


def test_the_trial_to_look_at_is_the_median_of_the_first_model(monkeypatch):
    monkeypatch.setattr(of_results, "read_artifact", lambda path, name: (path.name, name))
    run = open_run("nowhere")

    def trial(model, goal, seed, end):
        return Trial("toy", model, goal, seed, np.array([1.0, end]), np.array([2.0, 1.0]), np.zeros(1))

    ends = {(0, 0): 0.5, (0, 1): 0.1, (1, 0): 0.9, (1, 1): 0.2}
    trials = [trial("b", *task, end) for task, end in ends.items()] + [trial("a", *task, 0.0) for task in ends]
    names = {"b": "toy.b.goal00.seed00.h5", "a": "toy.a.goal00.seed00.h5"}
    assert of_results._one_of_each(trials, run) == {m: (name, "trials") for m, name in names.items()}
    assert of_results._one_of_each([], run) == {}


def test_a_report_is_a_table_an_object_and_pictures(done, monkeypatch):
    class Figure:
        def savefig(self, path, dpi, format):
            path.write_text(f"{dpi} {format}")

    monkeypatch.setattr(of_run, "draw", lambda params, results: [("errors", Figure()), ("boxes", Figure())])
    value, lines, pictures = write_report("small", SMALL, done)
    report = done / "report"
    assert pictures == [report / "small_errors.png", report / "small_boxes.png"]
    assert pictures[0].read_text() == "110 png"
    assert (report / "small.txt").read_text() == "\n".join(lines) + "\n"
    kept = json.loads((report / "small.json").read_text())
    assert kept.keys() == value.keys() == {"title", "seeds", "predictions", "guidance", "trials", "cliffs_delta"}
    assert {(r["model"], r["seeds"]) for r in kept["predictions"]} == {
        ("static", 1),
        ("piegraph", 2),
        ("piegraph-ng", 2),
    }
    assert {r["model"] for r in kept["trials"]} == {"piegraph", "static"}


def test_a_report_needs_metrics_or_models(done, tmp_path, monkeypatch):
    with pytest.raises(DataError, match="no run of this experiment has results yet") as caught:
        write_report("small", SMALL, tmp_path)
    assert caught.value.hint == "piegraph reproduce small"
    monkeypatch.setattr(of_run, "draw", lambda params, results: [])
    monkeypatch.setattr(of_results, "read_metrics", lambda run: ({}, []))
    value, lines, pictures = write_report("small", SMALL.model_copy(update={"table": "search"}), done)
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
