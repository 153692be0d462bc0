"""The experiments: every one is whole and small with --quick, runs end to end, goes on, and gives the same table twice."""

import json
import os

import numpy as np
import pytest

from piegraph_cli.dynamics.params import TrainParams
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.evaluation.statistics import bootstrap_grid
from piegraph_cli.evaluation.tables import difference, sequence_means, summarise
from piegraph_cli.experiments.measured import write_strokes
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.recipes import load_experiment, names, recipe_of, trial_recipe
from piegraph_cli.planning.params import TrialsParams
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.train import model_names, trained_name
from tests.cli import REPOSITORY, piegraph, piegraph_json


def test_every_experiment_is_a_make_target():
    makefile = (REPOSITORY / "Makefile").read_text()
    (targets,) = (line for line in makefile.splitlines() if line.startswith("EXPERIMENTS :="))
    assert sorted(targets.split()[2:]) == names()


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("name", names())
def test_recipes_train_what_they_evaluate_and_plan_with(name, quick, tmp_path):
    params = load_experiment(name, quick)
    for environment in params.interactions:
        recipe = recipe_of(params, environment, None)
        train, evaluate = (recipe.params(STAGES[stage]) for stage in ("train", "evaluate"))
        assert isinstance(train, TrainParams)
        trained = set(model_names(train.models, train))
        assert {own for unit in model_names(evaluate.models, train) if (own := trained_name(unit))} <= trained
        assert all(train.of(label) for label in train.models)
        if params.trials:
            trials = trial_recipe(params, environment, tmp_path).params(STAGES["trials"])
            assert isinstance(trials, TrialsParams)
            assert {own for label in trials.models if (own := trained_name(f"{label}.seed0"))} <= trained


def test_a_variant_that_changes_nothing_is_left_out():
    """A rope's recipe has the head and mirrors; in a search the variants are all there is, and stay."""
    train = recipe_of(load_experiment("ablations", False), "rope-bendy", None).params(STAGES["train"])
    assert isinstance(train, TrainParams)
    ours = [label for label in train.models if label.startswith("piegraph")]
    assert ours == ["piegraph@100", "piegraph:nopool@100", "piegraph:nomirror@100", "piegraph:nohead@100"]
    search = recipe_of(load_experiment("search", False), "rope-bendy", None).params(STAGES["train"])
    assert isinstance(search, TrainParams)
    assert len(search.models) == 24


def test_an_experiment_end_to_end(tmp_path):
    """Predictions, what fewer sequences cost, trials, pictures; a second time nothing is done and the table is equal."""
    command = ("reproduce", "data-fidelity", "--quick", "--set", "steps=0.002", "--runs", tmp_path / "a b", "--jobs", 2)
    first = piegraph_json(*command)["data-fidelity"]
    assert first["failed"] == []
    rows = {(r["model"], r["horizon"]): r for r in first["predictions"]}
    assert rows["piegraph@6", 1]["seeds"] == 2
    mean, low, high = rows["piegraph@6", 1]["pd"]
    assert low <= mean <= high
    assert {r["model"] for r in first["trials"]} == {"piegraph@3", "piegraph@6"}
    assert {(r["sequences"], r["of"]) for r in first["loss"]} == {(3, 6)}
    kinds = ("errors", "interactions", "boxes", "success", "distance", "overlays")
    report = tmp_path / "a b" / "report"
    assert all((report / f"data-fidelity_{kind}.png").stat().st_size > 5000 for kind in kinds)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "a b").rglob("*.h5")}
    again = piegraph_json(*command)["data-fidelity"]
    assert again == first
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "a b").rglob("*.h5")} == before
    assert json.loads((report / "data-fidelity.json").read_text())["predictions"] == first["predictions"]


def test_mistakes_name_the_experiment(tmp_path):
    done = piegraph("reproduce", "table2", "--runs", tmp_path, check=2)
    assert "no experiment table2" in done.stderr
    assert "table1" in done.stderr
    done = piegraph("reproduce", "table1", "--runs", tmp_path, "--show", check=3)
    assert "no run of this experiment has results yet" in done.stderr
    with pytest.raises(UsageError, match="no experiment"):
        load_experiment("../planning", False)
    with pytest.raises(ValueError, match="cannot be chosen of 5"):
        ExperimentParams(title="t", table="dynamics", interactions={"tblock": (6,)}, models=("piegraph",), training=5)


def test_settings_of_an_experiment_can_be_changed():
    params = load_experiment("planning", False, ["trials.seeds=3", "interactions.tblock=[7]", "steps=0.5"])
    full = load_experiment("planning", False)
    assert params.trials == full.trials.model_copy(update={"seeds": 3})
    assert params.interactions == full.interactions | {"tblock": (7,)}
    assert params.steps == 0.5
    for wrong in ("seeds", "trials.seed=3", "seeds=x"):
        with pytest.raises(UsageError):
            load_experiment("planning", False, [wrong])


def test_an_experiment_can_be_done_for_some_environments():
    assert list(load_experiment("planning", False, (), ["tshirt", "toy", "tblock"]).interactions) == [
        "tblock",
        "tshirt",
    ]
    few = load_experiment("recordings", False, ["training=8", "interactions.toy=[8]"], ["toy"])
    assert few.interactions == {"toy": (8,)}
    with pytest.raises(UsageError, match="interactions"):
        load_experiment("recordings", False, ["interactions=8"], ["toy"])
    with pytest.raises(UsageError, match="not done for toy"):
        load_experiment("planning", False, (), ["toy"])


def metrics(seeds: int, sequences: int, offset: float) -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(0)
    base = rng.uniform(1, 2, (seeds, sequences))
    return [
        {
            "horizon": np.repeat(1, 2 * sequences),
            "sequence": np.repeat([f"sequence_{k:04d}" for k in range(sequences)], 2),
            **{name: np.repeat(row, 2) + np.tile([-0.1, 0.1], sequences) + offset for name in ("cd", "s", "pd")},
            "pd_truth": np.full(2 * sequences, np.nan),
        }
        for row in base
    ]


def test_intervals_are_over_seeds_and_sequences():
    rng = np.random.default_rng(1)
    alike = np.tile(rng.normal(0, 1, 50), (3, 1))
    differing = alike + np.array([[-3.0], [0.0], [3.0]])
    narrow, wide = bootstrap_grid(alike), bootstrap_grid(differing)
    assert narrow[0] == pytest.approx(wide[0])
    assert narrow[2] - narrow[1] == pytest.approx(4 / np.sqrt(50), rel=0.25)
    assert wide[2] - wide[1] > 2 * (narrow[2] - narrow[1])
    assert np.isnan(bootstrap_grid(np.zeros((0, 3)))).all()


def test_differences_are_paired():
    """Sequences differ by a centimetre, the models by a hundredth: only a paired comparison can tell."""
    of = {"one": metrics(2, 20, 0.0), "other": metrics(2, 20, 0.01), "untrained": metrics(1, 20, 0.5)}
    np.testing.assert_allclose(sequence_means(of["one"], "pd", 1).shape, (2, 20))
    np.testing.assert_allclose(difference(of, "one", "other", "pd", 1), [0.01] * 3, atol=1e-9)
    np.testing.assert_allclose(difference(of, "one", "other", "cd+s", 1), [0.02] * 3, atol=1e-9)
    assert difference(of, "one", "untrained", "pd", 1)[0] > 0.3
    rows = {row["model"]: row for row in summarise(of)}
    assert rows["one"]["windows"] == 40
    assert np.isnan(rows["one"]["pd_truth"][0])


def measured(path, strokes: int = 12, **changes):
    """A file of pushes that carry a square along, in the plane."""
    rng = np.random.default_rng(0)
    square = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 6), np.linspace(-0.05, 0.05, 6)), -1).reshape(-1, 2)
    before = square + rng.uniform(-0.1, 0.1, (strokes, 1, 2))
    after = before + np.array([0.02, 0.0])
    start = before.mean(1) - [0.1, 0.0]
    end = after.mean(1) - [0.06, 0.0]
    np.savez(path, **({"before": before, "after": after, "start": start, "end": end} | changes))
    return path


def test_strokes_that_others_measured_end_in_a_table(tmp_path):
    given = ["training=6", "interactions.measured=[3,6]", 'models=["static","rigid"]', "seeds=[0]"]
    command = ("reproduce", "pushes", "--data", measured(tmp_path / "a b.npz"), "--runs", tmp_path)
    found = piegraph_json(*command, *(word for text in given for word in ("--set", text)))["pushes"]
    pd = {row["model"]: row["pd"][0] for row in found["predictions"]}
    assert pd["static"] == pytest.approx(2.0, abs=0.01)
    assert max(pd["rigid@3"], pd["rigid@6"]) < 0.1
    assert len(found["pictures"]) == 2
    assert not any("outline" in name for name in pd)


CORNERS = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])


def test_an_outline_beside_strokes_that_others_measured_is_a_row_of_its_own(tmp_path):
    given = ["training=6", "interactions.measured=[3]", 'models=["static","rigid"]', "seeds=[0]"]
    settings = [word for text in given for word in ("--set", text)]
    command = ("reproduce", "pushes", "--runs", tmp_path, *settings)
    file = measured(tmp_path / "a.npz", outline=CORNERS * 0.8 + 0.3)
    wrong = piegraph(*command, "--data", measured(tmp_path / "b.npz", outline=CORNERS[[0, 2, 1, 3]]), check=3).stderr
    assert "b.npz: the outline crosses itself" in wrong
    wrong = piegraph(*command, "--data", measured(tmp_path / "c.npz", outline=CORNERS * 2), check=3).stderr
    assert "the outline measures 200 x 200 mm, the particles 100 x 100 mm" in wrong
    found = piegraph_json(*command, "--data", measured(file, outline=CORNERS + 0.3))["pushes"]
    pd = {row["model"]: row["pd"][0] for row in found["predictions"]}
    assert pd["rigid:outline"] < 0.1
    run = open_run(tmp_path / "measured")
    assert run.fresh(STAGES["train"], "rigid:outline@3.seed0")
    (outline,) = (tmp_path / "recordings").glob("*outline.npz")
    np.savez(outline, outline=CORNERS * 1.01)
    assert not open_run(tmp_path / "measured").fresh(STAGES["train"], "rigid:outline@3.seed0"), "its content counts"


def test_what_is_no_file_of_strokes_is_refused(tmp_path):
    assert "--data FILE.npz" in piegraph("reproduce", "pushes", "--runs", tmp_path, check=2).stderr
    for name, wrong in (("before", np.zeros((12, 3))), ("after", np.zeros((11, 36, 2))), ("end", np.array("x"))):
        file = measured(tmp_path / f"{name}.npz", **{name: wrong})
        done = piegraph("reproduce", "pushes", "--data", file, "--runs", tmp_path, check=3)
        assert str(file) in done.stderr
    np.savez(tmp_path / "other.npz", before=np.zeros((2, 3, 2)))
    done = piegraph("reproduce", "pushes", "--data", tmp_path / "other.npz", "--runs", tmp_path, check=3)
    assert "no array after" in done.stderr


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("start", "end"), "do not move the way they are pushed"),
        (("before", "after"), "do not move the way"),
        ((), "0.5"),
    ],
)
def test_strokes_with_arrays_exchanged_or_of_another_frame_are_refused(tmp_path, names, said):
    with np.load(measured(tmp_path / "one.npz")) as arrays:
        data = dict(arrays)
    changes = {name: data[other] for name, other in zip(names, reversed(names), strict=True)}
    changes |= {} if names else {name: data[name] + [0.0, 0.6] for name in ("start", "end")}
    with pytest.raises(DataError, match=said):
        write_strokes(measured(tmp_path / "two.npz", **changes), tmp_path / "out")


ORDER = np.random.default_rng(1).permutation(36)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda after, before: after[:, ORDER], "stroke 0: particles leave those beside them in 12 of 12 strokes"),
        (lambda after, before: np.roll(after, 1, axis=1), "stroke 0: particles leave"),
        (
            lambda after, before: np.concatenate([after[:7], after[7:8, ORDER], after[8:]]),
            "stroke 7: particles leave those beside them in 1 of 12",
        ),
        (lambda after, before: after[:, ::-1], "turn what they push by 180 deg"),
        (lambda after, before: 1.1 * after - 0.1 * after.mean(1, keepdims=True), "1.1 times as large after"),
        (lambda after, before: before, "none of 12 strokes moves the object"),
    ],
)
def test_particles_that_are_not_those_before_are_refused(tmp_path, change, said):
    with np.load(measured(tmp_path / "one.npz")) as arrays:
        before, after = arrays["before"], arrays["after"]
    with pytest.raises(DataError, match=said):
        write_strokes(measured(tmp_path / "two.npz", after=change(after, before)), tmp_path / "out")


def test_strokes_that_end_beside_the_object_are_said(tmp_path, caplog):
    with np.load(measured(tmp_path / "one.npz")) as arrays:
        away = {name: arrays[name] - [0.06, 0.0] for name in ("start", "end")}
    write_strokes(tmp_path / "one.npz", tmp_path / "out")
    assert not caplog.records
    write_strokes(measured(tmp_path / "two.npz", **away), tmp_path / "out")
    assert "12 of 12 strokes end" in caplog.text


def test_strokes_are_those_of_the_file_that_is_given_now(tmp_path):
    """Even if that file is older than what was made of another one, or has fewer."""
    write_strokes(measured(tmp_path / "one.npz", strokes=4), tmp_path / "out")
    kept = (tmp_path / "out" / "00000.npz").stat().st_mtime_ns
    write_strokes(tmp_path / "one.npz", tmp_path / "out")
    assert (tmp_path / "out" / "00000.npz").stat().st_mtime_ns == kept
    other = measured(tmp_path / "two.npz", strokes=2, after=np.ones((2, 36, 2)))
    os.utime(other, (1, 1))
    write_strokes(other, tmp_path / "out")
    files = sorted((tmp_path / "out").iterdir())
    assert [file.name for file in files] == ["00000.npz", "00001.npz"]
    with np.load(files[0]) as stroke:
        assert (stroke["particles"][1, :, :2] == 1).all()
    with pytest.raises(DataError, match="holds no stroke"):
        write_strokes(measured(tmp_path / "none.npz", strokes=0), tmp_path / "out")


def test_troubles_show_what_was_made_and_make_nothing(tmp_path):
    show = ("reproduce", "troubles", "--show", "--runs", tmp_path)
    assert "no results yet" in piegraph(*show, check=3).stderr
    assert not list(tmp_path.iterdir())
    report = tmp_path / "troubles" / "report"
    report.mkdir(parents=True)
    (report / "troubles.txt").write_text("kind  right\n")
    assert "no results yet" in piegraph(*show, check=3).stderr, "half of what was made"
    row = {"trouble": "tilted", "strength": "5 deg", "bad": 1, "doubtful": 0, "good": 0, "right": 1, "recordings": 1}
    made = {"rows": [row], "wrong": 1, "missed": 0, "false_alarms": 0}
    (report / "troubles.json").write_text(json.dumps(made))
    assert piegraph(*show).stdout == "kind  right\n"
    assert piegraph_json(*show) == {"troubles": made}


def test_a_search_gives_every_learned_model_as_many_candidates_on_sequences_of_its_own():
    params = load_experiment("search", False)
    models = [label.partition(":")[0] for label in params.models]
    learned = {"piegraph", "egnn-g", "gnn", "gnn-aug", "pgnd", "gbnd"}
    assert {name: models.count(name) for name in learned} == dict.fromkeys(learned, 4)
    assert set(models) == learned
    names_of = {
        model: {key for label, of in params.variants.items() if label.startswith(f"{model}:") for key in of}
        for model in learned
    }
    assert all(set(of) == names_of[label.partition(":")[0]] for label, of in params.variants.items()), (
        "all that is searched"
    )
    for environment in params.interactions:
        recipe = recipe_of(params, environment, None)
        seeds = {load_experiment(name, False).simulation for name in names() if name != "search"}
        assert recipe.params(STAGES["simulate"]).seed not in seeds


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ('variants={"pgnd:fast"={learning_rat=1e-3}}', 'variants."pgnd:fast".learning_rat: unknown setting'),
        ('variants={"pgnd:fast"={learning_rate=-1.0}}', 'variants."pgnd:fast".learning_rate: Input should be greater'),
        ('variants={"pngd:fast"={}}', 'variants."pngd:fast" is no variant of a model that learns'),
        ('variants={"static:fast"={}}', 'variants."static:fast" is no variant of a model that learns'),
        ('variants={"pgnd"={}}', 'variants."pgnd" is no variant of a model that learns'),
        ('models=["pgnd:fast"]', 'no variants."pgnd:fast", which pgnd:fast@10 is'),
        ('models=["pgdn"]', "no model pgdn"),
        ('trials.models=["piegraph:fast"]', 'no variants."piegraph:fast"'),
        ('trials.models=["gnn"]', "gnn@10 plans with gnn@10, which is not trained"),
        ("trials.plan.sampels=7", "trials.plan.sampels: unknown setting"),
        ("simulation=100", "trials and recordings are of simulation 0"),
    ],
)
def test_a_name_that_nothing_knows_is_refused_before_an_hour_is_spent(change, reason):
    with pytest.raises(UsageError) as caught:
        load_experiment("planning", False, [change])
    assert reason in caught.value.message
    assert caught.value.where.endswith("planning.toml")
    assert caught.value.hint
