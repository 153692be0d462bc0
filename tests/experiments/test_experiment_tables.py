"""The tables that experiments end in, from known numbers: signs, winners, and the paper's figures beside the right row."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from piegraph_cli.dynamics.params import TrainParams
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments import tables
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import Training
from piegraph_cli.experiments.recipes import load_experiment, recipe_of, trial_recipe
from piegraph_cli.experiments.results import Empty, Results
from piegraph_cli.experiments.search import search_lines, search_rows
from piegraph_cli.experiments.tables import describe
from piegraph_cli.stages import STAGES

PAPER = {"tblock": {"1": (4.0, 1.0), "2": (9.0, 3.0)}, "toy": {"1": (12.0, 6.0)}}
LOSSES = {"piegraph:slow": [0.3], "piegraph:fast": [0.2, 0.3], "gnn": [0.7], "pgnd": [0.9]}


def metrics(*by_horizon: float) -> SimpleNamespace:
    """One seed's metrics of two sequences around a PD for each horizon from 1 on; CD is ten times PD, S a hundred times."""
    pd = np.concatenate([[value - 0.25, value + 0.25] for value in by_horizon])
    names = np.tile([b"sequence_0000", b"sequence_0001"], len(by_horizon))
    columns = {"pd": pd, "cd": 10 * pd, "s": 100 * pd, "pd_truth": np.full(len(pd), np.nan)}
    horizons = dict.fromkeys(range(1, len(by_horizon) + 1), 2)
    arrays = {"horizon": np.repeat(np.arange(len(by_horizon)) + 1, 2), "sequence": names, **columns}
    return SimpleNamespace(arrays=arrays, windows=horizons, training=None)


def experiment(table: str, **settings: Any) -> ExperimentParams:
    values: dict[str, Any] = {"interactions": {"tblock": (6,), "toy": (6,)}, "models": ("piegraph",), "training": 20}
    return ExperimentParams(title="known", table=table, **values | settings)


def results(metrics=None, models=None, trials=()) -> Results:
    return Results(metrics or {}, models or {}, list(trials), {})


@pytest.fixture(autouse=True)
def of_no_origin(monkeypatch):
    """Where figures come from is tested with pieces."""
    monkeypatch.setattr(tables, "origin_lines", lambda pieces: [])


def described(params: ExperimentParams, found: Results) -> tuple[dict[str, Any], list[list[str]]]:
    """The tables as an object, and the words of each line for people."""
    value, lines = describe(params, found)
    return value, [line.split() for line in lines]


FOUND = results(
    {
        "tblock": {
            "static@6": [metrics(5.0, 8.0)],
            "piegraph-ng@6": [metrics(3.0, 7.0), metrics(3.0, 7.0)],
            "piegraph@6": [metrics(2.0, 4.0), metrics(1.0, 2.0)],
            "pgnd@6": [metrics(1.25, 9.0), metrics(1.25, 9.0)],
        },
        "toy": {"piegraph@6": [metrics(6.0, 9.0)], "piegraph-ng@6": [metrics(4.5, 6.0)]},
        "cloth": {},
    }
)


def test_guidance_gains_what_the_unguided_network_is_worse_by():
    value, lines = described(experiment("guidance"), FOUND)
    gains = {(r["environment"], r["horizon"]): (r["model"], r["pd"][0], r["cd+s"][0]) for r in value["guidance"]}
    assert gains == {
        ("tblock", 1): ("piegraph", pytest.approx(1.5), pytest.approx(165)),
        ("tblock", 2): ("piegraph", pytest.approx(4.0), pytest.approx(440)),
        ("toy", 1): ("piegraph", pytest.approx(-1.5), pytest.approx(-165)),
        ("toy", 2): ("piegraph", pytest.approx(-3.0), pytest.approx(-330)),
    }
    begin = next(k for k, line in enumerate(lines) if line[:3] == ["What", "guidance", "gains:"])
    assert "above 0: guidance helps" in " ".join(lines[begin])
    assert [line[:4] for line in lines[begin + 2 :]] == [
        ["tblock", "1", "piegraph", "+1.50"],
        ["tblock", "2", "piegraph", "+4.00"],
        ["toy", "1", "piegraph", "-1.50"],
        ["toy", "2", "piegraph", "-3.00"],
    ]
    assert lines[begin + 2][4:] == ["[+1.00,", "+2.00]", "+165.00", "[+110.00,", "+220.00]"]


def test_a_variant_is_compared_with_the_same_variant_unguided_whatever_its_name():
    of = {"piegraph:as-piegraph@6": [metrics(2.0)], "piegraph-ng:as-piegraph@6": [metrics(3.0)]}
    value, _ = described(experiment("guidance"), results({"tblock": of}))
    assert [(r["model"], r["pd"][0]) for r in value["guidance"]] == [("piegraph:as-piegraph", pytest.approx(1))]


def test_every_prediction_stands_in_the_row_of_its_environment_horizon_and_model():
    value, lines = described(experiment("guidance"), FOUND)
    rows = {(r["environment"], r["horizon"], r["model"]): r for r in value["predictions"]}
    assert len(rows) == 12
    assert rows["tblock", 2, "pgnd"]["pd"][0] == pytest.approx(9)
    assert rows["toy", 1, "piegraph"]["cd"][0] == pytest.approx(60)
    assert rows["tblock", 1, "piegraph"]["seeds"] == 2
    assert (value["title"], value["seeds"]) == ("known", [0, 1, 2])
    (line,) = (line for line in lines if line[:3] == ["tblock", "1", "piegraph"] and line[3] == "2")
    assert line[4:] == ["1.50", "[0.75,", "2.25]", "15.00", "150.00", "165.00"]
    assert "against" not in value
    assert "loss" not in value
    assert "paper" not in value


def test_the_truth_has_a_column_where_it_is_known():
    known = metrics(2.0)
    known.arrays["pd_truth"] = np.array([3.0, 3.5])
    _, lines = described(experiment("guidance"), results({"tblock": {"piegraph": [known], "static": [metrics(4.0)]}}))
    assert lines[2][-2:] == ["PD", "truth"]
    assert [line[-1] for line in lines[3:5]] == ["3.25", "nan"]


def test_other_models_are_compared_with_piegraph_at_the_longest_horizon():
    value, lines = described(experiment("dynamics"), FOUND)
    further = {(r["environment"], r["model"]): (r["horizon"], r["pd"][0]) for r in value["against"]}
    assert further == {
        ("tblock", "static"): (2, pytest.approx(5)),
        ("tblock", "piegraph-ng"): (2, pytest.approx(4)),
        ("tblock", "pgnd"): (2, pytest.approx(6)),
        ("toy", "piegraph-ng"): (2, pytest.approx(-3)),
    }
    assert ["tblock", "2", "pgnd", "+6.00"] in [line[:4] for line in lines]
    assert ["toy", "2", "piegraph-ng", "-3.00"] in [line[:4] for line in lines]
    assert any("above 0: piegraph is nearer" in " ".join(line) for line in lines)


def test_the_papers_figures_stand_beside_ours_of_the_same_row():
    value, lines = described(experiment("guidance", paper=PAPER), FOUND)
    rows = {(r["environment"], r["horizon"]): (r["ours"], r["paper"]) for r in value["paper"]}
    assert rows == {
        ("tblock", 1): (pytest.approx([330, 165]), [4.0, 1.0]),
        ("tblock", 2): (pytest.approx([770, 330]), [9.0, 3.0]),
        ("toy", 1): (pytest.approx([495, 660]), [12.0, 6.0]),
    }
    assert lines[-3:] == [
        ["tblock", "1", "(330.00,", "165.00)", "(4.0,", "1.0)", "2.00", "4.00"],
        ["tblock", "2", "(770.00,", "330.00)", "(9.0,", "3.0)", "2.33", "3.00"],
        ["toy", "1", "(495.00,", "660.00)", "(12.0,", "6.0)", "0.75", "2.00"],
    ]
    alone = results({"tblock": {"piegraph": FOUND.metrics["tblock"]["piegraph@6"]}})
    assert described(experiment("guidance", paper=PAPER), alone)[0]["paper"] == []


def test_the_shipped_figures_are_the_papers():
    """CD+S (without guidance, with it) of its Table I, kept here a second time: a figure that moves in the recipe is seen."""
    assert load_experiment("table1", quick=False).paper == {
        "tblock": {"1": (4.1, 1.3), "2": (9.9, 2.8), "4": (23.2, 5.7)},
        "rope-stiff": {"1": (5.1, 2.5), "2": (11.7, 6.0), "4": (27.1, 12.8)},
        "rope-bendy": {"1": (5.5, 2.4), "2": (13.3, 5.5), "4": (31.9, 13.8)},
        "toy": {"1": (10.9, 6.4), "2": (26.3, 14.5), "4": (63.9, 33.7)},
        "cloth": {"1": (7.2, 2.6), "2": (15.7, 5.4), "4": (34.6, 15.7)},
    }


def test_fewer_sequences_cost_what_the_error_grows_by():
    labels = {f"piegraph@{n}": [metrics(pd, 2 * pd)] for n, pd in ((6, 3.0), (20, 2.0), (3, 5.0))}
    found = results({"tblock": labels | {"static": [metrics(8.0, 9.0)], "gnn@20": [metrics(4.0, 4.0)]}})
    params = experiment("interactions", interactions={"tblock": (3, 6, 20)})
    value, lines = described(params, found)
    rows = {(r["model"], r["horizon"], r["sequences"]): (r["of"], r["loss"]) for r in value["loss"]}
    assert rows == {
        ("piegraph", 1, 3): (20, pytest.approx(1.5)),
        ("piegraph", 1, 6): (20, pytest.approx(0.5)),
        ("piegraph", 2, 3): (20, pytest.approx(1.5)),
        ("piegraph", 2, 6): (20, pytest.approx(0.5)),
    }
    assert ["tblock", "H=1", "piegraph", "3", "against", "20:", "+150", "%"] in lines
    assert {r["model"] for r in value["predictions"]} == {*labels, "static", "gnn@20"}, (
        "sizes stay where there are several"
    )


def trained(loss: float | None) -> SimpleNamespace:
    return SimpleNamespace(training=Training(steps=9, parameters=3, loss=loss))


def test_the_best_of_a_search_has_the_lowest_validation_loss():
    models = {label: [trained(loss) for loss in seeds] for label, seeds in LOSSES.items()}
    others = {"piegraph:slow@6": [trained(0.1)], "piegraph:fast@6": [trained(0.6)]}
    variants = {"piegraph:slow": {"learning_rate": 1e-3}, "piegraph:fast": {"learning_rate": 0.002, "mirror": False}}
    params = experiment("search", variants=variants)
    found = results(models={"tblock": models, "toy": others})
    rows = {(r["environment"], r["model"]): (r["loss"], r["best"]) for r in search_rows(found)}
    assert rows == {
        ("tblock", "piegraph:slow"): (pytest.approx(0.3), False),
        ("tblock", "piegraph:fast"): (pytest.approx(0.25), True),
        ("tblock", "gnn"): (pytest.approx(0.7), True),
        ("tblock", "pgnd"): (pytest.approx(0.9), True),
        ("toy", "piegraph:slow@6"): (pytest.approx(0.1), True),
        ("toy", "piegraph:fast@6"): (pytest.approx(0.6), False),
    }
    lines = search_lines(params, search_rows(found))
    assert [line.split()[:3] for line in lines if line.endswith("*")] == [
        ["tblock", "piegraph:fast", "0.25000"],
        ["tblock", "gnn", "0.70000"],
        ["tblock", "pgnd", "0.90000"],
        ["toy", "piegraph:slow@6", "0.10000"],
    ]
    assert (
        lines[-8:]
        == [
            "",
            "# pipelines/tblock.toml: the best of `piegraph reproduce search`",
            "[train.piegraph]",
            "learning_rate = 0.002",
            "mirror = false",
            "",
            "# pipelines/toy.toml: the best of `piegraph reproduce search`",
            "[train.piegraph]",
            "learning_rate = 0.001",
        ][-8:]
    )
    assert "predictions" not in describe(params, Results({}, {}, [], {}))[0]


def test_a_search_without_one_of_a_models_candidates_has_no_best_of_it():
    of = {"tblock": {"gnn:a@6": [trained(0.1)], "gnn:b@6": [trained(0.2)], "pgnd:a@6": [trained(0.4)]}}
    empty = [Empty("tblock", "gnn:c@6", "not measured"), Empty("tblock", "pgnd:b@6", "failed: diverged", tried=True)]
    found = Results({}, of, [], {}, empty)
    assert {r["model"]: r["best"] for r in search_rows(found)} == {"gnn:a@6": False, "gnn:b@6": False, "pgnd:a@6": True}


def test_trials_are_in_the_table_with_the_verdict_of_cliffs_delta():
    def trial(model: str, goal: int, end: float, seed: int = 0) -> Trial:
        pd = np.array([0.3, end])
        return Trial("tblock", model, goal, seed, pd, 3 * pd, np.array([0.5]))

    near, far = [0.01, 0.02, 0.03], [0.1, 0.02, 0.2]
    trials = [trial("piegraph@6", k, near[k]) for k in range(3)] + [trial("pgnd@6", k, far[k]) for k in range(3)]
    plays = {"models": ("piegraph", "pgnd"), "goals": 3, "seeds": 1, "strokes": 1, "thresholds": (0.05, 0.015)}
    value, lines = described(experiment("dynamics", trials=plays), results(FOUND.metrics, trials=trials))
    (verdict,) = value["cliffs_delta"]
    assert (verdict["first"], verdict["second"], verdict["pairs"]) == ("piegraph", "pgnd", 3)
    assert verdict["pd"][0] == pytest.approx((3 + (2 - 0) + (2 - 1)) / 9), "0.02 ties once, 0.03 loses once"
    assert [(s["below"], s["delta"][0]) for s in verdict["strokes"]] == [
        (0.05, pytest.approx(2 / 3)),
        (0.015, pytest.approx(1 / 3)),
    ]
    assert "trials" not in described(experiment("dynamics", trials=plays), FOUND)[0], "none have been played yet"
    ours, other = value["trials"]
    assert (ours["model"], ours["pd"]["mean"], ours["cd"]["mean"]) == (
        "piegraph",
        pytest.approx(0.02),
        pytest.approx(0.06),
    )
    assert [s["rate"] for s in other["success"]] == pytest.approx([1 / 3, 0])
    row = next(line for line in lines if line[:3] == ["tblock", "piegraph", "3"])
    assert row[3] == "2.00"
    assert row[5] == "2.00", "median of PD"
    assert row[6] == "6.00"
    assert row[-3:] == ["100/33", "1/>1", "0.50"]
    last = lines[-1]
    assert last[:5] == ["tblock", "piegraph", "over", "pgnd", "3"]
    assert (last[5], last[7]) == ("+0.67", "+0.33"), "final PD, then strokes to the least threshold"


def test_labels_say_which_models_learn_from_how_many_sequences():
    params = experiment(
        "interactions",
        interactions={"tblock": (3, 6)},
        models=("static", "piegraph", "kabsch"),
        trials={"models": ("piegraph", "greedy"), "goals": 1, "seeds": 2, "strokes": 4, "thresholds": (0.1, 0.2)},
    )
    assert params.labels("tblock") == ["piegraph@3", "kabsch@3", "piegraph@6", "kabsch@6", "static"]
    assert params.trial_labels("tblock") == ["piegraph@3", "greedy", "piegraph@6"]


def test_every_setting_of_an_experiment_reaches_the_recipes_of_its_runs(tmp_path):
    params = experiment(
        "interactions",
        interactions={"tblock": (3, 6)},
        models=("static", "piegraph"),
        seeds=(4, 5),
        training=7,
        validation=2,
        test=3,
        strokes=5,
        horizons=(1, 3),
        steps=0.5,
        variants={"piegraph:wide": {"hidden": 64}},
        trials={
            "models": ("piegraph", "static"),
            "goals": 2,
            "seeds": 3,
            "strokes": 6,
            "thresholds": (0.1,),
            "plan": {"samples": 9},
        },
    )
    recipe = recipe_of(params, "tblock", None)
    found = {name: recipe.params(STAGES[name]) for name in ("simulate", "dataset", "train", "evaluate")}
    assert (found["simulate"].sequences, found["simulate"].strokes) == (12, 5)
    assert (found["dataset"].train, found["dataset"].validation) == (7, 2)
    assert (found["evaluate"].models, found["evaluate"].horizons) == (("piegraph@3", "piegraph@6", "static"), (1, 3))
    train, shipped = found["train"], recipe_of(params.model_copy(update={"steps": 1.0}), "tblock", None)
    assert isinstance(train, TrainParams)
    assert (train.models, train.seeds) == (("piegraph@3", "piegraph@6"), (4, 5))
    assert train.variants == {"piegraph:wide": {"hidden": 64}}
    assert train.piegraph.steps == shipped.params(STAGES["train"]).piegraph.steps // 2
    trials = trial_recipe(params, "tblock", tmp_path).params(STAGES["trials"])
    assert (trials.envs, trials.models) == (("tblock",), ("piegraph@3", "static", "piegraph@6"))
    assert (trials.goals, trials.seeds, trials.strokes, trials.thresholds) == (2, 3, 6, (0.1,))
    assert (trials.plan, trials.trained) == ({"samples": 9}, tmp_path.resolve())


@pytest.mark.parametrize("environment", ["tblock", "tshirt", "toy"])
def test_recordings_are_ingested_and_tracked_as_the_hand_moves_the_object(environment, tmp_path):
    recipe = recipe_of(experiment("guidance", interactions={environment: (6,)}), environment, tmp_path)
    assert "simulate" not in recipe.sections
    assert recipe.params(STAGES["ingest"]).recording == (tmp_path.resolve(),)
    assert recipe.params(STAGES["track"]).mode == "auto"
