"""The whole chain in this process, small: a simulation to its plan and trials, and a recording to its scores.

The commands are tested elsewhere; here it is what each stage is given, makes, tells and keeps.
"""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.params import LEARNED
from piegraph_cli.errors import DataError, InputError
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.evaluation.reliability import calibration_of
from piegraph_cli.stages import STAGES, dataset, evaluate, models, open_run, plan, sequences, trials
from piegraph_cli.stages.learning import read_model, read_sequence
from piegraph_cli.stages.models import load_model, save_model
from piegraph_cli.stages.points import read_points
from piegraph_cli.stages.train import RIGID
from piegraph_cli.text import plain
from piegraph_cli.workspace.artifact import read_artifact, write_artifact
from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.stages.chain import artifact, context

TINY = {"hidden": 4, "layers": 1, "steps": 3, "neighbors": 4}
SECTIONS = {
    "simulate": {"environment": "tblock", "sequences": 4, "strokes": 2, "particles": 16, "seed": 3},
    "dataset": {"train": 2, "validation": 1},
    "train": {"models": ["piegraph"], "model_seeds": {"piegraph": [4, 1]}, "piegraph": TINY},
    "evaluate": {"models": ["static", "piegraph-ng"], "horizons": [1, 2, 3]},
    "plan": {"env": "tblock", "samples": 6, "cem_iterations": 2, "strokes": 2, "episodes": 2, "max_length": 0.13},
}
GRID = {"envs": ["tblock"], "models": ["piegraph", "static"], "goals": 1, "seeds": 2, "strokes": 2}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a whole run in `tblock` and its outcomes: read it, never write to it."""
    folder = tmp_path_factory.mktemp("runs")
    run = Run(folder / "tblock", Recipe(STAGES, SECTIONS))
    run.save_recipe()
    outcomes = run_chain(run, None, Options(device="cpu"))
    assert [str(o.error) for o in outcomes if o.error] == []
    grid = Run(folder / "paper", Recipe(STAGES, {"trials": GRID}))
    grid.save_recipe()
    outcomes += run_stage(grid, STAGES["trials"], Options())
    assert [str(o.error) for o in outcomes if o.error] == []
    return folder, {(o.stage, o.unit): o for o in outcomes}


@pytest.fixture
def run(runs):
    return open_run(runs[0] / "tblock")


def test_stages_tell_what_they_made(runs, run):
    quality = {place: outcome.quality for place, outcome in runs[1].items()}
    one = run.read("tracks", "sequence_0001")
    assert sequences(run) == [f"sequence_000{k}" for k in range(4)]
    assert quality["simulate", "sequence_0001"] == f"{len(one['time'])} frames, 2 strokes, 16 particles"
    assert not one["residual"].any()
    assert (one["visibility"] == 1).all()
    data = run.read("dataset")
    pairs = len(data["pairs"])
    assert quality["dataset", None] == f"8 strokes, {pairs} pairs; sequences: 2 train, 1 validation, 1 test"
    model = run.read("model", "piegraph.seed4")
    last = f"loss {model['train_loss'][-1]:.4f} after 12 steps on "
    assert quality["train", "piegraph.seed4"].startswith(last)
    losses = f", {model['validation_loss'].min():.4f} on validation (nothing moves: {float(model['static_loss']):.4f})"
    assert quality["train", "piegraph.seed4"].endswith(losses + RIGID)
    static = run.read("metrics", "static")
    means = [static["pd"][static["horizon"] == h].mean() for h in (1, 2)]
    assert quality["evaluate", "static"] == f"PD [cm] H=1 {means[0]:.2f}, H=2 {means[1]:.2f} on 1 held-out sequence"
    warning = "no held-out sequence has 3 strokes in a row: that horizon is left out"
    assert runs[1]["evaluate", "static"].warnings == (warning,)
    assert set(runs[1]) > {("evaluate", f"piegraph-ng.seed{k}") for k in (1, 4)} | {("plan", None)}


def test_sequences_are_those_of_their_seed_and_number(run, tmp_path):
    """As many strokes as asked for, each sequence another; with another seed, others again."""
    starts = {s: run.read("tracks", s)["positions"][0] for s in sequences(run)}
    assert all((run.read("tracks", s)["mode"] == 0).all() for s in starts)
    other = Run(tmp_path / "run", Recipe(STAGES, {"simulate": SECTIONS["simulate"] | {"seed": 4, "sequences": 2}}))
    run_stage(other, STAGES["simulate"], Options())
    different = [*starts.values(), *(other.read("tracks", f"sequence_000{k}")["positions"][0] for k in (0, 1))]
    assert len({state.tobytes() for state in different}) == 6
    same = Run(tmp_path / "same", Recipe(STAGES, {"simulate": SECTIONS["simulate"] | {"sequences": 1}}))
    run_stage(same, STAGES["simulate"], Options())
    np.testing.assert_array_equal(same.read("tracks", "sequence_0000")["positions"][0], starts["sequence_0000"])


def test_what_each_unit_reads(run):
    def inputs(stage: str, unit: str | None) -> dict[str, object]:
        return dict(run.inputs(STAGES[stage], unit))

    assert inputs("dataset", None) == {"tracks": [f"sequence_000{k}" for k in range(4)]}
    assert inputs("train", "piegraph.seed1") == {"dataset": None}
    assert inputs("evaluate", "static") == {"dataset": None}
    assert inputs("evaluate", "piegraph-ng.seed4") == {"dataset": None, "model": "piegraph.seed4"}
    assert inputs("plan", None) == {"model": "piegraph.seed4"}
    assert inputs("trials", "tblock.static.goal00.seed00") == {}
    assert run.units(STAGES["train"]) == ["piegraph.seed4", "piegraph.seed1"]
    assert run.units(STAGES["evaluate"]) == ["static", "piegraph-ng.seed4", "piegraph-ng.seed1"]
    settings = run.settings(STAGES["train"], "piegraph.seed1")
    assert (settings.label, settings.seed, settings.settings.hidden) == ("piegraph", 1, 4)


def test_metrics_and_plans_are_described(runs, run):
    value, lines = evaluate.describe(run)
    assert value["metrics"] == str(run.folder / "metrics")
    assert {(row["model"], row["horizon"], row["seeds"]) for row in value["rows"]} == {
        (model, horizon, seeds) for model, seeds in (("static", 1), ("piegraph-ng", 2)) for horizon in (1, 2)
    }
    assert (value["scores"], len(plain(lines))) == ([], 5)
    made = run.read("plan")
    value, lines = plan.describe(run)
    assert value["plan"] == str(run.folder / "plan.h5")
    assert value["end_distance"] == made["end_distance"].tolist()
    assert lines[0] == value["quality"] == made.quality == runs[1]["plan", None].quality
    assert [row["episode"] for row in value["strokes"]] == made["episode"].tolist() == [0, 0, 1, 1]
    row = value["strokes"][2]
    assert (row["mode"], row["start"], row["end"]) == ("push", *made["stroke"][2].tolist())
    assert row["predicted_distance"] == made["cost"][2]
    assert (row["distance"], row["blocked"]) == (made["distance"][2], bool(made["blocked"][2]))
    assert f"reached {made['distance'][2] * 100:.1f} cm" in lines[3]
    assert f"predicted {made['cost'][2] * 100:.1f} cm from the goal" in lines[3]
    assert made["end_distance"].tolist() == made["distance"][[1, 3]].tolist()
    assert made["seed"].tolist() == [0, 0]
    assert made["goal"].shape == (2, 16, 3)
    assert not np.array_equal(made["goal"][0], made["goal"][1]), "each episode has its own"
    starts = [np.linalg.norm(made["before"][k] - made["goal"][k // 2], axis=-1).mean() for k in (0, 2)]
    np.testing.assert_allclose(made["start_distance"], starts, rtol=1e-5)


@pytest.mark.parametrize(
    ("ends", "success", "quality"),
    [
        ((0.01, 0.03, 0.02), 0.02, "1 of 3 goals below 2 cm of particle distance, 2.0 strokes each"),
        ((0.01, 0.03, 0.02), 0.025, "2 of 3 goals below 2.5 cm of particle distance, 1.5 strokes each"),
        ((0.01, 0.03, 0.02), 0.001, "0 of 3 goals below 0.1 cm of particle distance"),
    ],
)
@pytest.mark.parametrize("ending", ["reached", plan.HELPLESS])
def test_a_plans_quality_counts_goals_and_strokes(ends, success, quality, ending):
    arrays = {"end_distance": np.array(ends), "episode": np.array([0, 0, 1, 1, 1, 2]), "stroke": np.zeros((6, 2, 2))}
    arrays |= {"metric": np.array(["distance"] * 3), "ending": np.array(["reached", "strokes spent", ending])}
    more = "; 1 episode ended as no stroke is expected to help" if ending == plan.HELPLESS else ""
    assert plan._quality(arrays, plan.PlanParams(env="tblock", success=success)) == quality + more


def test_a_plan_from_a_state_tells_where_it_would_end(run, tmp_path):
    now = run.read("tracks", "sequence_0000")["positions"][0]
    np.savez(tmp_path / "now.npz", now)
    np.savez(tmp_path / "goal.npz", np.stack([now, now + np.float32([0.1, 0, 0])]))
    question = {"state": tmp_path / "now.npz", "samples": 8, "cem_iterations": 2, "horizon": 2, "model": "piegraph"}
    model = {"model": run.read("model", "piegraph.seed4")}

    def asked(**more: object):
        return plan.run(model, plan.PlanParams(**question | more), context())

    posed = asked(goal_pose=(0.1, 0, 0))
    assert posed.arrays["stroke"].shape == (2, 2, 2)
    assert posed.quality == f"2 strokes, predicted particle distance {posed.arrays['cost'][-1] * 100:.1f} cm"
    np.testing.assert_allclose(posed.arrays["goal"][0].mean(0), now.mean(0) + np.array([0.1, 0, 0]), atol=1e-6)
    assert np.isnan(posed.arrays["end_distance"]).all()
    assert (posed.warnings, float(posed.arrays["start_distance"][0])) == ([], pytest.approx(0.1, rel=1e-4))
    clouds = [asked(goal=f"{tmp_path}/goal.npz{frame}") for frame in ("", ":1", ":0")]
    np.testing.assert_array_equal(clouds[0].arrays["goal"], clouds[1].arrays["goal"])
    np.testing.assert_allclose(clouds[0].arrays["goal"][0], now + np.float32([0.1, 0, 0]))
    assert clouds[2].quality == "no stroke: 0.0 cm of particle distance from the goal already, success is 2 cm"
    assert float(clouds[1].arrays["start_distance"][0]) == pytest.approx(0.1, rel=1e-2), (
        "the shape is found in the cloud"
    )
    with pytest.raises(DataError) as caught:
        asked(goal_pose=(5, 0, 0))
    assert caught.value.where == f"{tmp_path}/now.npz, --goal-pose"
    with pytest.raises(DataError) as caught:
        np.savez(tmp_path / "far.npz", now + np.float32([5, 0, 0]))
        asked(goal=f"{tmp_path}/far.npz")
    assert caught.value.where == f"{tmp_path}/now.npz, --goal {tmp_path}/far.npz"


def test_a_given_goal_is_that_of_every_episode(run, tmp_path):
    np.savez(tmp_path / "goal.npz", np.random.default_rng(0).uniform(-0.05, 0.05, (30, 3)).astype(np.float32))
    question = {"env": "tblock", "model": "static", "samples": 6, "cem_iterations": 1, "strokes": 1, "episodes": 2}
    posed = plan.run({}, plan.PlanParams(**question, goal_pose=(0.02, 0, 0.5)), context()).arrays
    for k in (0, 1):
        own = posed["before"][k].mean(0)
        np.testing.assert_allclose(posed["goal"][k].mean(0) - own, [0.02, 0, 0], atol=1e-5)
    given = plan.run({}, plan.PlanParams(**question, goal=f"{tmp_path}/goal.npz"), context()).arrays
    np.testing.assert_array_equal(given["goal"][0], given["goal"][1])
    assert given["goal"].shape == (2, 30, 3)


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ({}, "either --env or --state"),
        ({"env": "tblock", "state": "a.npz"}, "either --env or --state"),
        ({"state": "a.npz"}, "--state needs a goal"),
        ({"env": "tblock", "goal": "a.npz", "goal_pose": "0,0,0"}, "one goal, not two"),
        ({"state": "a.npz", "goal": "a.npz", "goal_pose": "0,0,0"}, "one goal, not two"),
    ],
)
def test_questions_that_are_none_are_refused(question, message):
    with pytest.raises(Exception, match=message):
        plan.run({}, plan.PlanParams(**question), context())


def test_points_of_artifacts(run, tmp_path):
    tracks = run.path("tracks", "sequence_0000")
    positions = read_artifact(tracks)["positions"]
    np.testing.assert_array_equal(read_points(tracks, None), positions[-1])
    np.testing.assert_array_equal(read_points(tracks, 2), positions[2])
    with pytest.raises(DataError):
        read_points(run.path("dataset", None), None)


def test_a_model_is_that_of_its_label_and_seed(run, tmp_path):
    models = [load_model(run.folder, *label) for label in ((), ("piegraph",), ("piegraph-ng",), ("static",))]
    assert [model.label for model in models] == ["piegraph", "piegraph", "piegraph-ng", "static"]
    assert (models[3].trained, models[0].particles, models[3].particles) == (None, 16, 50)
    assert (models[0].settings.samples, models[0].settings.env, models[0].settings.max_length) == (6, None, 0.13)

    def weights(model) -> torch.Tensor:
        return torch.cat([value.flatten() for value in model.trained.network.state_dict().values()])

    one, four = (load_model(run.folder, "piegraph", seed=seed) for seed in (1, 4))
    assert torch.equal(weights(models[0]), weights(four))
    assert torch.equal(weights(models[2]), weights(four))
    assert not torch.equal(weights(one), weights(four))
    trained = read_model(run.read("model", "piegraph.seed4"))
    assert (trained.modes, trained.particles, trained.settings.hidden) == ((0,), 16, 4)
    assert trained.pace == float(run.read("model", "piegraph.seed4")["pace"]) > 0
    assert not trained.network.training
    with pytest.raises(InputError, match="model is missing"):
        load_model(run.folder, "gnn")


def test_a_saved_model_knows_what_errors_to_expect(run, tmp_path, monkeypatch):
    of_run, metrics = models._model_of_run, run.read("metrics", "piegraph-ng.seed1")
    monkeypatch.setattr(models, "_model_of_run", lambda *given: (of_run(*given)[0], metrics, of_run(*given)[2]))
    save_model(run.folder, tmp_path / "mine.h5", seed=1)
    known = load_model(tmp_path / "mine.h5").trained.calibration
    assert known == load_model(run.folder, "piegraph", seed=1).trained.calibration == calibration_of(metrics.arrays)
    assert known.of_motion > 0
    kept = read_artifact(tmp_path / "mine.h5", "model")
    for wrong in ({"constant": 0.0}, 3, dict.fromkeys(kept.params["calibration"], float("inf"))):
        about = {"stage": "train", "stage_version": 1, "key": "k", "inputs": {}}
        write_artifact(tmp_path / "odd.h5", "model", kept.arrays, params=kept.params | {"calibration": wrong}, **about)
        with pytest.raises(DataError, match="no numbers of the errors to expect"):
            load_model(tmp_path / "odd.h5")


def test_a_saved_model_has_the_settings_to_plan_with(run, tmp_path):
    save_model(run.folder, tmp_path / "mine.h5", seed=1)
    mine = load_model(tmp_path / "mine.h5")
    kept, original = read_artifact(tmp_path / "mine.h5", "model"), run.read("model", "piegraph.seed1")
    assert (kept.key, kept.inputs, kept.quality) == (original.key, original.inputs, original.quality)
    assert kept.params.keys() == original.params.keys() | {"plan"}
    assert mine.settings == load_model(run.folder, seed=1).settings
    assert load_model(tmp_path / "mine.h5", "kabsch").label == "kabsch"
    for other in ("gnn", "static"):
        with pytest.raises(DataError, match=f"holds piegraph, not {other}"):
            load_model(tmp_path / "mine.h5", other)
    with pytest.raises(DataError, match="static is not trained: there is nothing to save"):
        save_model(run.folder, tmp_path / "none.h5", "static")


def test_trials_read_the_networks_of_the_run_beside_them_and_are_described(runs, monkeypatch):
    folder = runs[0]
    grid = open_run(folder / "paper")
    names = grid.units(STAGES["trials"])
    assert names == [f"tblock.{model}.goal00.seed0{k}" for k in (0, 1) for model in ("piegraph", "static")]
    found = trials.read_trials(grid)
    assert [(t.environment, t.model, t.goal, t.seed) for t in found] == [
        ("tblock", model, 0, seed) for model in ("piegraph", "static") for seed in (0, 1)
    ]
    assert all(t.pd.shape == (3,) and t.cd.shape == (3,) and t.seconds.shape == (2,) for t in found)
    networks = [grid.settings(STAGES["trials"], f"tblock.piegraph.goal00.seed0{k}").network for k in range(4)]
    assert networks == [folder.resolve() / "tblock" / "model" / f"piegraph.seed{k}.h5" for k in (4, 1, 4, 1)]
    assert grid.settings(STAGES["trials"], names[1]).network is None
    settings = grid.settings(STAGES["trials"], names[0]).plan
    assert (settings.samples, settings.max_length, settings.strokes, settings.success) == (6, 0.13, 2, 0.02)
    value, lines = trials.describe(grid)
    assert value["trials"] == str(folder / "paper" / "trials")
    assert [(row["model"], row["trials"]) for row in value["results"]] == [("piegraph", 2), ("static", 2)]
    assert value["cliffs_delta"][0]["pairs"] == 2
    assert any("over" in line for line in lines)
    first = read_artifact(folder / "paper" / "trials" / f"{names[0]}.h5")
    end = f"{float(first['end_distance']) * 100:.1f} cm from the goal after 2 strokes, not below 2 cm"
    assert first.quality == runs[1]["trials", names[0]].quality == end
    fewer = Run(grid.folder, Recipe(STAGES, {"trials": GRID | {"models": ["static", "piegraph"], "seeds": 3}}))
    assert [t.model for t in trials.read_trials(fewer)] == ["static", "static", "piegraph", "piegraph"]
    assert grid.key(STAGES["trials"], names[0]) != grid.key(STAGES["trials"], names[2]), "of another network"


def test_a_trial_that_succeeds_does_not_say_so_twice(monkeypatch):
    settings = plan.PlanParams(env="tblock", success=0.03)
    assert trials._quality(0.0123, 4, settings, "reached") == "1.2 cm from the goal after 4 strokes"
    left = "3.0 cm from the goal after 4 strokes, not below 3 cm"
    assert trials._quality(0.03, 4, settings, "strokes spent") == left
    assert trials._quality(0.03, 4, settings, plan.HELPLESS) == f"{left}: no stroke is expected to help"


def test_a_network_that_is_not_there_is_named_with_what_makes_it(tmp_path):
    network = tmp_path / "runs" / "tblock" / "model" / "piegraph.seed0.h5"
    params = trials.TrialParams(goal=0, seed=0, network=network, plan=plan.PlanParams(env="tblock", model="piegraph"))
    with pytest.raises(DataError, match="piegraph is not trained for tblock") as caught:
        trials.run({}, params, context())
    assert caught.value.where == str(network)
    assert caught.value.hint.startswith(f"piegraph run tblock --run {tmp_path}/runs/tblock, or ")


def test_an_evaluation_without_any_window_is_refused(run):
    with pytest.raises(DataError, match="no held-out sequence has 5 strokes in a row"):
        evaluate.run({"dataset": run.read("dataset")}, ModelEvaluateParams(label="static", horizons=(7, 5)), context())


def test_sequences_of_a_dataset_are_read_each_by_its_own_frames(run):
    data = run.read("dataset")
    for index, name in enumerate(data.texts("sequence_name")):
        one, own = read_sequence(data, index), run.read("tracks", name)
        np.testing.assert_array_equal(one["rest"], own["positions"][0])
        np.testing.assert_array_equal(one["before"], own["positions"][one["frames"][:, 0]])
        np.testing.assert_array_equal(one["after"], own["positions"][one["frames"][:, 1]])
        np.testing.assert_array_equal(one["strokes"].start, own["end_effector"][one["frames"][:, 0], :2])
        np.testing.assert_array_equal(one["strokes"].end, own["end_effector"][one["frames"][:, 1], :2])


def test_a_sequence_without_strokes_is_told(run):
    tracks = {name: run.read("tracks", name) for name in sequences(run)}
    still = dict(tracks["sequence_0002"].arrays) | {"contact": np.zeros(len(tracks["sequence_0002"]["time"]), bool)}
    params = run.params("dataset").model_copy(update={"train": 1})
    output = dataset.run({"tracks": tracks | {"sequence_0002": artifact(still)}}, params, context())
    assert output.warnings == ["no stroke in sequence_0002: check the hand with `piegraph report`"]
    assert dataset.run({"tracks": tracks}, params, context()).warnings == []


class Notes(list):
    """In place of a checkpoint, and of TensorBoard."""

    state = None

    def load(self):
        return self.state

    def save(self, state):
        self.append(int(state["done"]) if "done" in state else len(self))
        self.state = {name: np.array(value) for name, value in state.items()}

    def add_scalar(self, *what):
        self.append(what)

    def close(self):
        self.append(("closed",))


def test_losses_are_noted_twenty_times_and_states_as_often_as_asked(run, monkeypatch):
    from piegraph_cli.stages import train

    settings = LEARNED["piegraph"](**TINY | {"steps": 45, "cycles": 1})
    events, saved = Notes(), Notes()
    monkeypatch.setattr(train, "_tensorboard", lambda context: events)
    given = context()
    given.checkpoint = saved
    data = {"dataset": run.read("dataset")}

    def trained(**more):
        return train.run(data, train.ModelParams(label="piegraph", seed=0, settings=settings, **more), given).arrays

    found = trained(checkpoint_every=15)
    assert found["step"].tolist() == [*range(2, 45, 2), 45]
    assert len(saved) == 2, "after 15 and 30 of 45; the last is the model itself"
    assert events == []
    saved.state = None
    again = trained(checkpoint_every=30, tensorboard=True)
    assert [e for e in events if e[0] == "loss/train"] == [
        ("loss/train", pytest.approx(loss), step) for loss, step in zip(found["train_loss"], found["step"], strict=True)
    ]
    assert [e[1] for e in events if e[0] == "loss/validation"] == pytest.approx(found["validation_loss"].tolist())
    assert events[-1] == ("closed",)
    assert saved.state is not None
    resumed = trained()
    for name in found:
        np.testing.assert_array_equal(resumed[name], found[name])
        np.testing.assert_array_equal(again[name], found[name])
