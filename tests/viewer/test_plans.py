"""Plans in the viewer: which stroke is drawn, what is said of it, and runs that have none."""

import numpy as np
import pytest

from piegraph_cli.viewer.layers import LAYERS
from piegraph_cli.viewer.plan_layer import PlanLayer
from piegraph_cli.viewer.plan_panel import PlanPanel
from piegraph_cli.viewer.server import start_server
from piegraph_cli.viewer.source import OpenRun
from piegraph_cli.viewer.viewer import Viewer
from piegraph_cli.workspace.artifact import write_artifact
from tests.viewer import made

STEPS, ITERATIONS, CANDIDATES = 3, 2, 5


def write_plan(run, executed: bool) -> None:
    """Two plans, of one and of two strokes; the best two candidates of each iteration are elites."""
    state = made.positions(STEPS)
    unknown = np.full(state.shape, np.nan)
    strokes = np.zeros((STEPS, ITERATIONS, CANDIDATES, 1, 2, 2), np.float32)
    strokes[..., 1, 0] = 0.1
    strokes[:, 1, 4] = np.nan
    weights = np.zeros((STEPS, ITERATIONS, CANDIDATES), np.float32)
    weights[..., :2] = 0.5
    arrays = {
        "goal": made.positions(2) + 0.05,
        "metric": np.array(["distance", "distance"]),
        "episode": np.array([0, 1, 1]),
        "stroke": strokes[:, 0, 0, 0],
        "mode": np.zeros(STEPS, np.uint8),
        "before": state,
        "predicted": state,
        "after": state if executed else unknown,
        "cost": np.full(STEPS, 0.02),
        "expected_error": np.full(STEPS, np.nan),
        "distance": np.full(STEPS, 0.01 if executed else np.nan),
        "blocked": np.zeros(STEPS, bool),
        "seconds": np.ones(STEPS),
        "candidate_stroke": strokes,
        "candidate_mode": np.zeros(strokes.shape[:4], np.uint8),
        "candidate_cost": np.zeros(weights.shape, np.float32),
        "candidate_weight": weights,
        "path": np.zeros((STEPS, 4, 3)),
        "path_time": np.tile(np.arange(4.0), (STEPS, 1)),
        "path_closed": np.zeros((STEPS, 4), bool),
        "seed": np.zeros(2, int),
        "start_distance": np.array([0.08, 0.09]),
        "end_distance": np.full(2, 0.006 if executed else np.nan),
        "ending": np.array(["reached", "strokes spent"]),
    }
    about = {"stage": "plan", "stage_version": 1, "key": "k", "params": {}, "inputs": {}}
    write_artifact(run / "plan.h5", "plan", arrays, **about)


@pytest.fixture
def opened(tmp_path):
    """A viewer of a run, and its panel of plans; a test may write the plan and open again."""
    server = start_server(0)
    run = OpenRun.of(made.make_run(tmp_path / "run", "frames", "tracks"))
    viewer = Viewer(server, [run], LAYERS)
    yield viewer, PlanPanel(viewer)
    viewer.close()
    server.stop()


def open_plan(viewer: Viewer, panel: PlanPanel, executed: bool = True) -> PlanLayer:
    write_plan(viewer.opened.folder, executed)
    viewer.open(viewer.opened, "first")
    panel.show.value = True
    panel._shown()
    return viewer.layer(PlanLayer)


def points(viewer: Viewer, name: str) -> np.ndarray:
    return viewer.server.scene._handle_from_node_name[f"/plan/{name}"].points


def test_a_run_without_a_plan_says_its_command(opened):
    viewer, panel = opened
    viewer.open(viewer.opened, "first")
    assert panel.note.content == "this run makes no plan"
    assert not panel.show.visible
    panel._looked()
    panel._episode_chosen()


def test_a_plan_hides_the_recording_unless_both_are_asked_for(opened):
    viewer, panel = opened
    layer = open_plan(viewer, panel)
    assert viewer.drawn == {layer}
    panel.recording.value = True
    panel._shown()
    assert len(viewer.drawn) > 1
    panel.show.value = False
    panel._shown()
    assert layer not in viewer.drawn


def test_the_chosen_stroke_is_drawn_with_what_was_searched(opened):
    viewer, panel = opened
    open_plan(viewer, panel)
    panel.episode.value = 2
    panel._episode_chosen()
    panel.step.value, panel.iteration.value = 2, 2
    panel._looked()
    np.testing.assert_allclose(points(viewer, "before/points"), made.positions(3)[2], atol=1e-6)
    np.testing.assert_allclose(points(viewer, "goal/points"), made.positions(2)[1] + 0.05, atol=1e-6)
    assert len(points(viewer, "elites")) == 2
    assert len(points(viewer, "candidates")) == 2
    panel.candidates.value = False
    panel._looked()
    assert len(points(viewer, "elites")) == len(points(viewer, "candidates")) == 0
    assert "9.0 cm from the goal at the start, 0.6 cm at the end" in panel.note.content
    assert "2.0 cm predicted, 1.0 cm after it" in panel.note.content


def test_a_plan_that_was_not_executed_has_nothing_after_it(opened):
    viewer, panel = opened
    open_plan(viewer, panel, executed=False)
    assert len(points(viewer, "after/points")) == 0
    assert "not executed" in panel.note.content


def test_a_plan_that_is_made_anew_is_the_one_that_is_shown(opened):
    viewer, panel = opened
    open_plan(viewer, panel, executed=False)
    open_plan(viewer, panel, executed=True)
    assert "0.6 cm at the end" in panel.note.content
