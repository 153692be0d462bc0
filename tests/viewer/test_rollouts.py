"""What models predict for the strokes of a sequence: which window, how far off, and what a run without models gives."""

import numpy as np
import pytest

from piegraph_cli.stages import open_run
from piegraph_cli.viewer.rollouts import Rollouts, add_models, models_of, strokes_of
from piegraph_cli.workspace.artifact import write_artifact
from tests.viewer import made

STROKES = 3


def rolled() -> Rollouts:
    """Three strokes of which the last follows on nothing; a model that is 1 cm off after one stroke and 3 after two."""
    after = np.zeros((STROKES, 4, 3)) + np.arange(STROKES)[:, None, None]
    found = Rollouts(
        frames=np.array([[2, 4], [6, 8], [10, 14]]),
        follows=np.array([True, True, False]),
        after=after,
        seen=np.ones((2, STROKES, 4), bool),
    )
    off = np.array([0, 0, 0.01])
    found.predicted["m"] = [after + off, after[1:] + 3 * off, after[2:] + 9 * off]
    return found


@pytest.mark.parametrize(("frame", "stroke"), [(0, 0), (2, 0), (5, 0), (6, 1), (9, 1), (10, 2), (99, 2)])
def test_the_stroke_of_a_frame_is_the_one_that_goes_on_or_was_the_last(frame, stroke):
    assert rolled().stroke(frame) == stroke


def test_errors_are_those_of_the_window_that_ends_with_the_stroke():
    found = rolled()
    assert found.error("m", 0, 1) == pytest.approx(0.01)
    assert found.error("m", 1, 2) == pytest.approx(0.03)
    np.testing.assert_allclose(found.at("m", 1, 2)[0], [1, 1, 1.03])


def test_there_is_no_window_before_the_first_stroke_and_none_across_a_gap():
    found = rolled()
    assert [found.known(0, 1), found.known(0, 2), found.known(1, 2), found.known(2, 2)] == [True, False, True, False]
    assert np.isnan(found.error("m", 0, 2))
    assert np.isnan(found.error("m", 2, 2))


def test_particles_that_were_not_seen_do_not_count():
    found = rolled()
    found.predicted["m"][0][0, 0] += 5
    found.seen[1, 0, 0] = False
    assert found.error("m", 0, 1) == pytest.approx(0.01)
    found.seen[:] = False
    assert np.isnan(found.error("m", 0, 1))


@pytest.fixture
def run(tmp_path):
    """A run with a dataset of two strokes and models of which one is not trained yet."""
    folder = made.make_run(tmp_path / "run", "frames", "tracks")
    with (folder / "recipe.toml").open("a") as recipe:
        recipe.write('[evaluate]\nmodels = ["static", "piegraph"]\n')
    positions = made.positions()
    arrays = {
        "positions": positions,
        "seen": np.ones(positions.shape[:2], bool),
        "end_effector": np.column_stack([np.arange(6) * 0.01, np.zeros(6)]),
        "strokes": np.array([[0, 2], [3, 5]]),
        "stroke_sequence": np.zeros(2, int),
        "stroke_mode": np.zeros(2, np.uint8),
        "stroke_follows": np.array([False, True]),
        "pairs": np.array([[0, 1]]),
        "pair_stroke": np.zeros(1, int),
        "sequence_name": np.array(["first"]),
        "sequence_start": np.zeros(1, int),
        "sequence_split": np.full(1, 2, np.uint8),
    }
    about = {"stage": "dataset", "stage_version": 1, "key": "k", "params": {}, "inputs": {}}
    write_artifact(folder / "dataset.h5", "dataset", arrays, **about)
    return open_run(folder)


def test_every_model_that_there_is_predicts_and_the_others_say_why_not(run):
    assert models_of(run) == {"static": "static", "piegraph": "piegraph.seed0"}
    found, data = strokes_of(run, "first")
    done = []
    add_models(found, data, run, lambda: True, lambda: done.append(set(found.predicted)))
    assert done == [{"static"}, {"static"}]
    assert [len(windows) for windows in found.predicted["static"]] == [2, 1]
    assert found.error("static", 0, 1) == pytest.approx(0.02, rel=1e-3)
    assert found.error("static", 1, 2) == pytest.approx(0.05, rel=1e-3)
    assert "no such model artifact" in found.failed["piegraph"]


def test_models_stop_when_another_sequence_is_opened(run):
    found, data = strokes_of(run, "first")
    add_models(found, data, run, lambda: False, lambda: None)
    assert not found.predicted


def test_a_sequence_that_is_not_in_the_dataset_is_told(run):
    assert strokes_of(run, "second") == "second is not in the dataset"
