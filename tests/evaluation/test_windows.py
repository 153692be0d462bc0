"""Windows of held-out strokes: which stroke each begins with, what is predicted from what, and which metric is which."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.models import sure
from piegraph_cli.errors import DataError
from piegraph_cli.evaluation import windows
from piegraph_cli.evaluation.params import ModelEvaluateParams
from tests import strokes as of_strokes

GRID = np.array([[x, y, 0.0] for x in np.arange(4) * 0.04 for y in np.arange(3) * 0.04], np.float32)
"""Particles so far apart that the nearest one of a moved object is the particle itself."""
MOVES = np.array([[0.003, 0.004, 0.0], [0.0, 0.0, 0.01], [0.002, 0.0, 0.0]], np.float32)
"""What each stroke really does to the object: 5, 10 and 2 mm."""
KNOCK = np.array([0, 0.005, 0], np.float32)


def sequence(strokes: int = 3) -> dict[str, np.ndarray]:
    """Strokes along x, of 1, 2, 3 cm, that push the grid by `MOVES`; it is knocked between two strokes."""
    before, after, state = [], [], GRID
    for k in range(strokes):
        before.append(state)
        after.append(state + MOVES[k])
        state = after[-1] + KNOCK
    start = np.zeros((strokes, 2), np.float32)
    end = np.stack([0.01 * (np.arange(strokes) + 1), np.zeros(strokes)], 1).astype(np.float32)
    return {
        "rest": GRID,
        "before": np.array(before),
        "after": np.array(after),
        "strokes": of_strokes.make(start, end, 0),
        "follows": np.arange(strokes) > 0,
        "frames": np.array([[10 * k, 10 * k + 5] for k in range(strokes)]),
        "seen": np.ones((2, strokes, len(GRID)), bool),
    }


def rows(of: dict[str, np.ndarray], true: np.ndarray | None = None, **settings) -> dict[tuple[int, int], tuple]:
    """By horizon and first stroke: CD, S, PD, and PD to the truth."""
    params = ModelEvaluateParams(**{"label": "static", "horizons": (1, 2, 3)} | settings)
    found = list(windows.window_metrics(of, true, None, params))
    assert len({row[:2] for row in found}) == len(found)
    return {row[:2]: row[2:6] for row in found}


@pytest.fixture
def predicted(monkeypatch):
    """Gives the evaluation a model: a function from positions [B, N, 3] and strokes [B, 7]."""

    def put(model: Callable) -> list[tuple]:
        made = []
        monkeypatch.setattr(windows, "make_foresee", lambda *given: made.append(given) or sure(model))
        return made

    return put


def test_every_window_of_a_horizon_is_measured_once():
    assert set(rows(sequence())) == {(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (3, 0)}


def test_no_window_goes_on_over_what_was_not_seen():
    gap = sequence() | {"follows": np.array([False, True, False])}
    assert set(rows(gap)) == {(1, 0), (1, 1), (1, 2), (2, 0)}
    assert set(rows(sequence(), horizons=(2,))) == {(2, 0), (2, 1)}
    assert set(rows(sequence(), horizons=(3, 1))) == {(1, 0), (1, 1), (1, 2), (3, 0)}
    assert set(rows(sequence(2), horizons=(1, 4))) == {(1, 0), (1, 1)}


def test_a_window_begins_before_its_first_stroke_and_ends_after_its_last():
    """`static` predicts the state before the window: what it is off by is what the strokes and knocks did."""
    found = rows(sequence())
    moved = [MOVES[0], MOVES[1], MOVES[2]]
    expected = {
        (1, 0): moved[0],
        (1, 1): moved[1],
        (1, 2): moved[2],
        (2, 0): moved[0] + KNOCK + moved[1],
        (2, 1): moved[1] + KNOCK + moved[2],
        (3, 0): moved[0] + moved[1] + moved[2] + 2 * KNOCK,
    }
    for place, offset in expected.items():
        length = 100 * np.linalg.norm(offset)
        cd, shape, pd, truth = found[place]
        assert pd == pytest.approx(length, rel=1e-4), place
        assert cd == pytest.approx(2 * length, rel=1e-4), place
        assert shape == pytest.approx(0, abs=1e-6)
        assert np.isnan(truth)


def test_predictions_go_on_from_predictions_with_the_strokes_of_their_window(predicted):
    seen = []

    def model(positions, strokes):
        seen.append((positions.clone(), strokes))
        return positions + of_strokes.motion(strokes)[:, None]

    predicted(model)
    one = sequence()
    found = rows(one)
    lengths = [of_strokes.end(strokes)[:, 0].tolist() for _, strokes in seen]
    assert [pytest.approx(part) for part in lengths] == [[0.01, 0.02, 0.03], [0.02, 0.03], [0.03]]
    np.testing.assert_array_equal(seen[0][0], one["before"])
    np.testing.assert_allclose(seen[1][0], one["before"][:2] + np.array([[[0.01, 0, 0]], [[0.02, 0, 0]]]), atol=1e-6)
    np.testing.assert_allclose(seen[2][0], one["before"][:1] + np.array([0.03, 0, 0]), atol=1e-6)
    for (horizon, window), (_, _, pd, _) in found.items():
        last = window + horizon - 1
        far = sum(0.01 * (k + 1) for k in range(window, last + 1))
        expected = one["before"][window] + np.array([far, 0, 0]) - one["after"][last]
        assert pd == pytest.approx(100 * np.linalg.norm(expected, axis=-1).mean(), rel=1e-4)


def test_swapped_particles_are_far_for_pd_and_at_no_distance_for_cd(predicted):
    one = sequence(1)
    after = torch.as_tensor(one["after"])
    predicted(lambda positions, strokes: after.flip(1))
    cd, shape, pd, _ = rows(one)[1, 0]
    assert cd == pytest.approx(0, abs=1e-5)
    assert pd == pytest.approx(100 * np.linalg.norm(GRID - GRID[::-1], axis=-1).mean(), rel=1e-4)
    assert shape > 1


def test_the_shape_error_is_that_of_near_particles_at_rest(predicted):
    """Everything stretched along x by a tenth: only the edges along x (4 cm) change, and those across (6 cm) are none."""
    one = sequence(1)
    stretched = one["after"].copy()
    stretched[..., 0] *= 1.1
    predicted(lambda positions, strokes: torch.as_tensor(stretched))
    cd, shape, pd, _ = rows(one)[1, 0]
    along, across = 3 * 3, 4 * 2
    assert shape == pytest.approx(0.4**2 * along / (along + across), rel=1e-3)
    assert shape not in (pytest.approx(pd), pytest.approx(cd))


def test_the_truth_is_that_of_the_frame_in_which_the_windows_last_stroke_ends():
    one = sequence()
    true = np.stack([GRID + np.array([0, 0, 0.001 * frame]) for frame in range(26)])
    found = rows(one, true)
    for (horizon, window), (*_, truth) in found.items():
        end = one["frames"][window + horizon - 1, 1]
        expected = 100 * np.linalg.norm(one["before"][window] - true[end], axis=-1).mean()
        assert truth == pytest.approx(expected, rel=1e-4)


def test_the_model_is_made_from_the_object_at_rest_the_label_and_the_settings(predicted):
    one = sequence()
    one["rest"] = GRID * 2
    made = predicted(lambda positions, strokes: positions)
    rows(one, label="piegraph@6", gain=0.07)
    ((label, trained, rest, params),) = made
    assert (label, trained, params.gain) == ("piegraph@6", None, 0.07)
    np.testing.assert_array_equal(rest, GRID * 2)


def test_an_evaluation_without_windows_is_an_error():
    from tests.stages.chain import make_dataset, make_metrics

    with pytest.raises(DataError, match="no held-out sequence has 4 strokes in a row"):
        make_metrics(make_dataset(), None, "static", horizons=(4, 5))
    assert set(make_metrics(make_dataset(), None, "static", horizons=(2, 5))["horizon"].tolist()) == {2}


def test_particles_that_were_not_seen_do_not_count():
    whole, hidden = sequence(2), sequence(2)
    hidden["after"][1, 0] += 0.5
    hidden["before"][1, 1] += 0.5
    hidden["seen"][1, 1, 0] = False
    found = rows(hidden)
    assert found[1, 1][2] > 3, "the particle that was seen after, but not where it is said to have been before"
    hidden["seen"][0, 1, 1] = False
    found = rows(hidden)
    np.testing.assert_allclose(found[1, 0][:3], rows(whole)[1, 0][:3])
    np.testing.assert_allclose(found[1, 1][:3], rows(whole)[1, 1][:3], rtol=1e-5, atol=1e-6)
    hidden["seen"][1, 1] = False
    assert (1, 1) not in rows(hidden)
    assert (1, 0) in rows(hidden)
