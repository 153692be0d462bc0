"""Cliff's delta: bounds, symmetry, values worked out by hand, its interval; and trials summed up by hand."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piegraph_cli.evaluation.statistics import cliffs_delta, cliffs_delta_paired
from piegraph_cli.evaluation.trial_figures import box_figure, distance_figure, success_figure
from piegraph_cli.evaluation.trials import Trial, compare_trials, summarise_trials, trial_lines

VALUES = st.lists(st.one_of(st.floats(0, 10), st.just(float("inf"))), min_size=1, max_size=12)
PAIRS = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=12)


@pytest.mark.parametrize(
    ("first", "second", "delta"),
    [
        ([1, 2, 3], [4, 5], 1),
        ([4, 5], [1, 2, 3], -1),
        ([1, 1], [1, 1, 1], 0),
        ([1, 3], [2, 4], 0.5),
        ([1, 2, 5], [2, 3], 3 / 6 - 2 / 6 + 0 / 6),
        ([2, np.inf], [3, np.inf], 2 / 4 - 1 / 4),
        ([np.inf], [np.inf], 0),
    ],
)
def test_known_values_of_cliffs_delta(first, second, delta):
    assert cliffs_delta(np.array(first), np.array(second)) == pytest.approx(delta)


@given(VALUES, VALUES)
def test_cliffs_delta_is_bounded_and_changes_sign_with_its_sides(first, second):
    delta = cliffs_delta(np.array(first), np.array(second))
    assert -1 <= delta <= 1
    assert delta == pytest.approx(-cliffs_delta(np.array(second), np.array(first)))


@given(PAIRS)
def test_the_paired_interval_holds_delta_and_changes_sign_with_its_sides(pairs):
    first, second = np.array(pairs, float).T
    delta, low, high = cliffs_delta_paired(first, second, repeats=200)
    assert delta == pytest.approx(cliffs_delta(first, second))
    assert -1 <= low <= high <= 1
    other, other_low, other_high = cliffs_delta_paired(second, first, repeats=200)
    np.testing.assert_allclose([other, other_low, other_high], [-delta, -high, -low], atol=1e-12)


def test_the_interval_covers_the_true_delta_about_as_often_as_it_says():
    """Two models of equal quality: delta 0; tasks of different difficulty, shared by the two."""
    rng, covered = np.random.default_rng(0), 0
    for trial in range(200):
        difficulty = rng.normal(0, 1, 40)
        first, second = difficulty + rng.normal(0, 1, (2, 40))
        _, low, high = cliffs_delta_paired(first, second, repeats=300, seed=trial)
        covered += low <= 0 <= high
    assert 0.9 <= covered / 200 <= 0.99


def test_pairs_narrow_the_interval():
    rng = np.random.default_rng(1)
    difficulty = rng.normal(0, 3, 60)
    first, second = difficulty + rng.normal(0, 0.5, (2, 60))
    _, low, high = cliffs_delta_paired(first, second)
    _, apart_low, apart_high = cliffs_delta_paired(first, rng.permutation(second))
    assert high - low < 0.5 * (apart_high - apart_low)


def test_no_values_and_no_pairs():
    assert np.isnan(cliffs_delta(np.array([]), np.array([1.0])))
    assert np.isnan(cliffs_delta_paired(np.array([]), np.array([]))).all()
    with pytest.raises(ValueError, match="not pairs"):
        cliffs_delta_paired(np.array([1.0]), np.array([1.0, 2.0]))


def trial(model, goal, *pd, environment="tblock"):
    return Trial(environment, model, goal, 0, np.array(pd), 2 * np.array(pd), np.full(len(pd) - 1, 0.5))


TRIALS = [
    trial("good", 0, 0.2, 0.04, 0.01),
    trial("good", 1, 0.2, 0.1, 0.025, 0.03),
    trial("good", 2, 0.015),
    trial("bad", 0, 0.2, 0.2, 0.2, 0.2),
    trial("bad", 1, 0.2, 0.19, 0.18, 0.3),
    trial("bad", 3, 0.2, 0.1, 0.01),
]
LIMITS = (0.02, 0.03, 0.05)


def test_trials_are_summed_up():
    good, bad = summarise_trials(TRIALS, LIMITS)
    assert (good["model"], good["trials"]) == ("good", 3)
    assert good["pd"]["mean"] == pytest.approx((0.01 + 0.03 + 0.015) / 3)
    assert good["pd"]["low"] <= good["pd"]["mean"] <= good["pd"]["high"]
    assert good["cd"]["median"] == pytest.approx(0.03)
    assert good["seconds_per_plan"] == pytest.approx(0.5)
    assert [s["rate"] for s in good["success"]] == pytest.approx([2 / 3, 1, 1])
    assert [s["strokes"] for s in good["success"]] == [2, 2, 1], "the median, and the unsolved one as more than any"
    assert [s["strokes"] for s in bad["success"]] == [None, None, None]
    assert [s["unsolved"] for s in bad["success"]] == [2, 2, 2]
    json.dumps([good, bad], allow_nan=False)


def test_models_are_compared_on_the_tasks_that_both_have():
    (row,) = compare_trials(TRIALS, LIMITS)
    assert (row["first"], row["second"], row["pairs"]) == ("good", "bad", 2)
    assert row["pd"][0] == 1
    assert row["strokes"][0]["delta"][0] == pytest.approx(0.5), "goal 1 is unsolved by both: half a tie"
    assert row["strokes"][1]["delta"][0] == 1
    (apart,) = compare_trials([TRIALS[0], TRIALS[5]], LIMITS)
    assert apart["pairs"] == 0
    assert "pd" not in apart


def test_the_table_names_what_it_shows():
    text = "\n".join(trial_lines(summarise_trials(TRIALS, LIMITS), compare_trials(TRIALS, LIMITS), 3))
    assert "67/100/100" in text
    assert ">3/>3/>3" in text
    assert "good over bad" in text
    assert trial_lines([], [], 3) == []


def test_models_without_a_common_task_are_not_compared_in_the_table():
    alone = trial("other", 7, 0.2, 0.1)
    rows, compared = summarise_trials([*TRIALS, alone], LIMITS), compare_trials([*TRIALS, alone], LIMITS)
    assert ["pd" in row for row in compared] == [True, False, False]
    lines = trial_lines(rows, compared, 3)
    (head,) = (k for k, line in enumerate(lines) if line.startswith("Cliffs delta"))
    assert " ".join(lines[head].split()) == "Cliffs delta pairs final PD strokes to 2 cm"
    assert [line.split()[1:5] for line in lines[head + 1 :]] == [["good", "over", "bad", "2"]]
    assert not any("Cliffs" in line for line in trial_lines(rows, [], 3))
    assert not any("Cliffs" in line for line in trial_lines(rows, compared[1:], 3))


def test_figures_show_every_environment_and_model(tmp_path):
    trials = [*TRIALS, trial("bad", 0, 0.2, 0.3, environment="rope-stiff")]
    boxes = box_figure(trials, compare_trials(trials, LIMITS), 0.02, 3)
    error, steps = boxes.axes[0], boxes.axes[2]
    assert "tblock" in error.get_title()
    assert "+1.00" in error.get_title()
    assert [label.get_text() for label in steps.get_xticklabels()] == ["good", "bad"]
    assert boxes.axes[1].get_title() == "rope-stiff"
    curve = success_figure(trials, LIMITS, 3).axes[0].get_lines()[0]
    assert np.interp(2.2, *curve.get_data()) >= 66
    line = distance_figure(trials, 3).axes[0].get_lines()[0].get_ydata()
    np.testing.assert_allclose(line, [20, 4, 1.5, 1.5])
    boxes.savefig(tmp_path / "boxes.png")
