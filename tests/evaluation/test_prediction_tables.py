"""Tables of predictions from numbers small enough to be summed up by hand: which metric, model and horizon stands where."""

import json

import numpy as np
import pytest

from piegraph_cli.evaluation.statistics import bootstrap_grid, bootstrap_mean
from piegraph_cli.evaluation.tables import (
    METRICS,
    as_json,
    difference,
    interval,
    score_values,
    sequence_means,
    summarise,
    summarise_scores,
    table_lines,
)
from piegraph_cli.text import plain

NAN = float("nan")


def seed_of(*rows: tuple[int, str, float]) -> dict[str, np.ndarray]:
    """One seed's metrics of (horizon, sequence, PD): CD is ten times as much, S a hundred times, PD truth half."""
    horizon, sequence, pd = zip(*rows, strict=True)
    values = np.array(pd, float)
    names = np.array([name.encode() for name in sequence])
    metrics = {"pd": values, "cd": 10 * values, "s": 100 * values, "pd_truth": 0.5 * values}
    return {"horizon": np.array(horizon), "sequence": names, **metrics}


FIRST = seed_of((1, "a", 1.0), (1, "a", 3.0), (1, "b", 5.0), (2, "a", 7.0))
SECOND = seed_of((1, "a", 2.0), (1, "a", 2.0), (1, "b", 9.0), (2, "a", 8.0))
OTHER = seed_of((1, "a", 4.0), (1, "a", 4.0), (1, "b", 4.0), (2, "a", 1.0))


@pytest.mark.parametrize(("metric", "factor"), [("pd", 1), ("cd", 10), ("s", 100), ("cd+s", 110), ("pd_truth", 0.5)])
def test_a_sequence_counts_once_however_many_windows_it_has(metric, factor):
    np.testing.assert_allclose(sequence_means([FIRST, SECOND], metric, 1), np.array([[2, 5], [2, 9]]) * factor)
    np.testing.assert_allclose(sequence_means([FIRST, SECOND], metric, 2), np.array([[7], [8]]) * factor)


def test_windows_without_a_value_are_left_out_and_so_are_sequences_of_such_alone():
    holes = FIRST | {"pd": np.array([NAN, 3.0, NAN, 7.0])}
    np.testing.assert_allclose(sequence_means([holes], "pd", 1), [[3]])
    np.testing.assert_allclose(sequence_means([holes], "cd", 1), [[20, 50]])


def test_a_summary_has_a_row_for_each_horizon_and_model_with_each_metric_in_its_place():
    rows = summarise({"one": [FIRST, SECOND], "other": [OTHER]})
    assert [(r["horizon"], r["model"], r["windows"], r["seeds"]) for r in rows] == [
        (1, "one", 3, 2),
        (1, "other", 3, 1),
        (2, "one", 1, 2),
        (2, "other", 1, 1),
    ]
    factors = {"pd": 1, "cd": 10, "s": 100, "cd+s": 110, "pd_truth": 0.5}
    assert set(factors) == set(METRICS)
    for metric, factor in factors.items():
        assert [r[metric][0] for r in rows] == pytest.approx([4.5 * factor, 4 * factor, 7.5 * factor, factor])
        low, high = rows[0][metric][1:]
        assert low == pytest.approx(2 * factor)
        assert high == pytest.approx(9 * factor)
    assert np.isnan(rows[3]["pd"][1:]).all(), "one value has no interval"


def test_a_difference_is_the_second_less_the_first():
    of = {"one": [FIRST, SECOND], "other": [OTHER]}
    assert difference(of, "one", "other", "pd", 1)[0] == pytest.approx(((4 - 2) + (4 - 5) + (4 - 2) + (4 - 9)) / 4)
    assert difference(of, "other", "one", "pd", 1)[0] == pytest.approx(0.5)
    assert difference(of, "one", "other", "cd+s", 2)[0] == pytest.approx(110 * (1 - 7.5))


def test_intervals_hold_95_of_100_means():
    """Of a few equal throws of a coin the mean is binomial, and its quantiles are known."""
    coin = np.repeat([0.0, 1.0], 10)
    for mean, low, high in (bootstrap_mean(coin), bootstrap_grid(coin[None])):
        assert mean == 0.5
        assert (low, high) == (pytest.approx(0.3, abs=0.051), pytest.approx(0.7, abs=0.051))
        assert low < 0.35
        assert high > 0.65
    assert bootstrap_grid(coin[None], seed=1) != bootstrap_grid(coin[None], repeats=50)
    alone = bootstrap_grid(np.array([[3.0]]))
    assert alone[0] == 3
    assert np.isnan(alone[1:]).all()


def test_a_table_for_people_has_each_number_under_its_head():
    lines = plain(table_lines(summarise({"one": [FIRST], "other": [OTHER | {"pd_truth": np.full(4, NAN)}]}), []))
    assert " ".join(lines[0].split()) == "H model windows PD [cm] CD [cm] S [cm2] CD+S PD truth [cm]"
    assert lines[1].split() == ["1", "one", "3", "3.50", "[2.00,", "5.00]", "35.00", "350.00", "385.00", "1.75"]
    assert lines[2].split() == ["1", "other", "3", "4.00", "[4.00,", "4.00]", "40.00", "400.00", "440.00", "-"]
    assert lines[3].split() == ["2", "one", "1", "7.00", "70.00", "700.00", "770.00", "3.50"]
    assert len(lines) == 5


def test_scores_are_pooled_over_sequences_by_name():
    def score(names, values):
        return {"score_name": np.array([n.encode() for n in names]), "score_value": np.array(values)}

    scores = [score(["far", "near", "far"], [10.0, 1.0, NAN]), score(["near", "far"], [3.0, 20.0])]
    found = score_values(scores)
    assert {name: values.tolist() for name, values in found.items()} == {"far": [10, 20], "near": [1, 3]}
    assert score_values([]) == {}
    far, near = summarise_scores(scores)
    assert (far["score"], far["values"], far["mean"], far["median"], far["p90"]) == ("far", 2, 15, 15, 19)
    assert (near["score"], near["mean"], near["p90"]) == ("near", 2, pytest.approx(2.8))
    skewed = summarise_scores([score(["x"] * 4, [0.0, 0.0, 1.0, 7.0])])[0]
    assert (skewed["mean"], skewed["median"], skewed["p90"]) == (2, 0.5, pytest.approx(5.2))
    text = plain(table_lines(summarise({"one": [FIRST]}), [skewed]))
    assert text[-2].split() == ["against", "the", "truth", "values", "mean", "median", "p90"]
    assert text[-1].split() == ["x", "4", "2.000", "0.500", "5.200"]


def test_numbers_as_text():
    assert interval((1.2, 1.104, 1.306)) == "1.20 [1.10, 1.31]"
    assert interval((1.2, -0.5, 1.3), "+") == "+1.20 [-0.50, +1.30]"
    assert interval((1.2, NAN, NAN)) == "1.20"
    assert json.loads(as_json({"a": [1.5, NAN, (float("inf"), 2)], "b": "x"})) == {
        "a": [1.5, None, [None, 2]],
        "b": "x",
    }
