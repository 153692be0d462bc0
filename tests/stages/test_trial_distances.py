"""A trial's distances: which is which, before the first stroke and after each, and how it is named and kept."""

import numpy as np
import pytest

from piegraph_cli.evaluation.metrics import chamfer_distance
from piegraph_cli.planning.params import PlanParams, TrialParams
from piegraph_cli.stages import STAGES, trials
from piegraph_cli.stages.train import model_name, split_model, trained_name
from piegraph_cli.stages.trials import split_name
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.planning.table import Rehearsal
from tests.stages.chain import context


def play(monkeypatch, **settings) -> tuple[dict[str, np.ndarray], Rehearsal]:
    rehearsal = Rehearsal(monkeypatch)
    plan = PlanParams(**{"env": "tblock", "model": "static", "samples": 10, "strokes": 3, "success": 1e-6} | settings)
    return trials.run({}, TrialParams(goal=2, seed=4, network=None, plan=plan), context()).arrays, rehearsal


def test_a_trial_keeps_both_distances_before_the_first_stroke_and_after_each(monkeypatch):
    found, _ = play(monkeypatch)
    states = [*found["before"], found["after"][-1]]
    assert len(states) == 4
    pd = [np.linalg.norm(state - found["goal"], axis=1).mean() for state in states]
    cd = [chamfer_distance(state, found["goal"]) / 100 for state in states]
    np.testing.assert_allclose(found["pd"], pd, rtol=1e-5)
    np.testing.assert_allclose(found["cd"], cd, rtol=1e-5)
    assert not np.allclose(pd, cd, rtol=0.05)
    assert found["pd"][0] == pytest.approx(float(found["start_distance"]), rel=1e-5)
    assert found["pd"][-1] == pytest.approx(float(found["end_distance"]), rel=1e-5)
    assert found["seconds"].shape == (3,)


def test_a_trial_that_begins_at_its_goal_has_one_distance(monkeypatch):
    found, _ = play(monkeypatch, success=1.0)
    assert found["pd"].shape == found["cd"].shape == (1,)
    assert found["stroke"].shape == (0, 2, 2)
    assert found["before"].shape == (0, 25, 3)


def test_the_seed_of_a_trial_numbers_its_start_and_the_goal_its_goal(monkeypatch):
    found, rehearsal = play(monkeypatch)
    episode, _ = rehearsal.play(start=4, goal=2, model="static", samples=10, strokes=3, success=1e-6)
    np.testing.assert_array_equal(found["before"][0], episode.start)
    np.testing.assert_array_equal(found["goal"], episode.goal)
    np.testing.assert_allclose(found["after"], [step.after for step in episode.steps])


def test_names_of_units_in_parts():
    assert [model_name("pgnd@20", 1), model_name("static", 1)] == ["pgnd@20.seed1", "static"]
    assert [split_model("pgnd@20.seed1"), split_model("static")] == [("pgnd@20", 1), ("static", 0)]
    assert [trained_name("kabsch@20.seed3"), trained_name("static")] == ["piegraph@20.seed3", None]
    assert split_name("tblock.piegraph:wide@20.goal03.seed12") == ("tblock", "piegraph:wide@20", 3, 12)


def test_every_setting_of_evaluation_reaches_each_models(tmp_path):
    given = {"models": "kabsch@20,static", "horizons": "1,3", "gain": 0.07, "spring_radius": 0.06, "tension_only": True}
    recipe = Recipe(STAGES, {"evaluate": given, "train": {"seeds": [0, 1], "models": ["piegraph@20"]}})
    run, stage = Run(tmp_path, recipe), STAGES["evaluate"]
    one = run.settings(stage, "kabsch@20.seed1")
    assert one.label == "kabsch@20"
    assert one.model_dump(exclude={"label"}) == recipe.params(stage).model_dump(exclude={"models"})
    assert run.units(stage) == ["kabsch@20.seed0", "kabsch@20.seed1", "static"]
