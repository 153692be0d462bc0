"""What stages make of episodes through cameras: an end with exit code 3 that keeps the strokes, keys, rows, folders of runs."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.commands.stages import _report
from piegraph_cli.environments.sight import Sight
from piegraph_cli.planning.params import SEES, PlanParams, TrialsParams
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.seen import refused
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_stage
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run

SETTINGS = {"env": "tblock", "model": "sms-no", "look": "cameras", "samples": 20, "cem_iterations": 2, "success": 1e-3}


def planned(folder: Path, **settings):
    run = Run(folder, Recipe(STAGES, {"plan": SETTINGS | settings}))
    outcomes = run_stage(run, STAGES["plan"], Options())
    return Run(folder, run.recipe), outcomes


def test_an_episode_that_cannot_go_on_keeps_its_strokes_and_ends_with_exit_code_3(tmp_path, monkeypatch, caplog):
    shoot = Sight.shoot

    def gone(self, shape=None, tip=None):
        return shoot(self, np.array([3.0, 0, 0]) if self.shots > 2 else shape, tip)

    monkeypatch.setattr(Sight, "shoot", gone)
    for _ in range(2):  # made, then fresh: what went wrong is said again
        run, outcomes = planned(tmp_path / "run", strokes=3)
        assert not any(o.error for o in outcomes)
        with caplog.at_level(logging.ERROR, "piegraph"):
            report = _report(STAGES["plan"], run, outcomes, 1.0)
        assert report.exit_code == 3
        assert "episode 0 ended after 2 strokes: the look is bad: " in str(report.error)
        assert "no object found" in str(report.error)
        assert report.value["ending"] == ["the look is bad"]
        assert len(report.value["strokes"]) == 2
        assert report.value["strokes"][0]["true_distance"] > 0
        assert "distance" not in report.value["strokes"][1]
    assert "the look is bad" in caplog.text
    kept = read_artifact(tmp_path / "run" / "plan.h5", "plan")
    assert np.isnan(kept["after"][1]).all()


def test_a_plan_that_reached_its_end_is_no_error(tmp_path):
    run, _ = planned(tmp_path / "run", strokes=1)
    assert refused(run) is None
    assert _report(STAGES["plan"], run, [], 1.0).exit_code == 0


def test_how_cameras_see_is_in_keys_where_they_are_looked_through_alone():
    usual = PlanParams(env="tblock").content()
    assert PlanParams(env="tblock", keep="track", sight="cameras=1,noise=2").content() == usual
    seen = PlanParams(env="tblock", look="cameras").content()
    assert seen == usual | {"look": "cameras", "sees": SEES}
    few = PlanParams(env="tblock", look="cameras", sight="cameras=1", keep="track").content()
    assert few["sight"]["cameras"] == 1
    assert few["keep"] == "track"


@pytest.mark.parametrize(
    ("trained", "found"),
    [(None, "beside/toy"), ("runs", "runs/toy"), ("runs/ENV", "runs/toy"), ("runs/ENV-recorded", "runs/toy-recorded")],
)
def test_trained_runs_lie_by_their_environments_name_or_where_it_stands_in_a_path(trained, found):
    assert TrialsParams(trained=trained).trained_run("toy", Path("beside")) == Path(found)


def test_trials_through_cameras_have_true_distances(tmp_path):
    shutil.rmtree(tmp_path / "runs", ignore_errors=True)
    settings = {"envs": ["tblock"], "models": ["sms-no"], "goals": 1, "seeds": 1, "strokes": 1, "look": "cameras"}
    run = Run(tmp_path / "runs" / "grid", Recipe(STAGES, {"trials": settings}))
    [outcome] = run_stage(run, STAGES["trials"], Options())
    assert outcome.error is None
    trial = read_artifact(run.path("trials", outcome.unit), "trials")
    assert trial["pd"].shape == trial["cd"].shape == (2,)
    assert trial["goal"].shape == (2000, 3)
    assert abs(trial["pd"][0] - trial["start_distance"]) < 0.05
    assert trial["pd"][0] != trial["start_distance"]
