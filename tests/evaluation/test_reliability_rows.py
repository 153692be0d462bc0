"""Expected against real errors as rows: what is measured of whom, and what is said where a model does not know."""

import numpy as np
import pytest

from piegraph_cli.dynamics.reliability import GROWTH
from piegraph_cli.evaluation.reliability import calibration_of, reliability, reliability_lines
from piegraph_cli.text import plain

RNG = np.random.default_rng(0)
MOTION = RNG.uniform(1, 10, 60)


def metrics(errors: np.ndarray, motion: np.ndarray = MOTION, sequences: int = 6, horizon: int = 1):
    """Strokes in turn of some sequences, in cm."""
    names = np.array([f"sequence_{k % sequences:04d}" for k in range(len(errors))])
    return {
        "horizon": np.full(len(errors), horizon),
        "sequence": names,
        "motion": motion,
        "correction": np.zeros(len(errors)),
        "pd": errors,
    }


def test_a_model_that_knows_its_errors_is_on_the_line():
    (row,) = reliability({"one": [metrics(0.2 * MOTION)]})
    assert (row["model"], row["horizon"], row["predictions"], row["seeds"]) == ("one", 1, 60, 1)
    assert row["rank"] == pytest.approx(1)
    for part in row["bins"]:
        assert part["error"] == pytest.approx(part["expected"], rel=1e-6)
    assert [part["error"] for part in row["bins"]] == sorted(part["error"] for part in row["bins"])
    text = "\n".join(plain(reliability_lines([row])))
    assert f"{row['bins'][0]['expected'] * 100:.2f} > {row['bins'][0]['error'] * 100:.2f}" in text


def test_a_model_that_does_not_know_them_is_told():
    (row,) = reliability({"one": [metrics(RNG.permutation(0.2 * MOTION))]})
    assert row["rank"] < 0.2
    assert 0.7 < row["within"] < 1


def test_errors_of_several_strokes_are_held_against_those_of_one():
    one, two = metrics(0.2 * MOTION), metrics(0.5 * MOTION, horizon=2)
    both = {name: np.concatenate([one[name], two[name]]) for name in one}
    first, second = reliability({"one": [both]})
    assert (first["horizon"], second["horizon"]) == (1, 2)
    for part in second["bins"]:
        assert part["error"] == pytest.approx(2.5 / 2 ** (GROWTH - 1) * part["expected"], rel=1e-6)
    assert second["within"] == 0


def test_nothing_is_said_of_few_predictions_one_sequence_or_an_object_that_stays():
    still = metrics(0.2 * MOTION, np.zeros(60))
    few = metrics(0.2 * MOTION[:10], MOTION[:10])
    assert reliability({"few": [few], "static": [still], "one": [metrics(0.2 * MOTION, sequences=1)]}) in (
        [],
        reliability({"static": [still]}),
    )
    assert reliability_lines([]) == []


def test_one_stroke_ahead_says_what_to_expect():
    assert calibration_of(metrics(0.2 * MOTION)).of_motion == pytest.approx(0.2)
    assert calibration_of(metrics(0.2 * MOTION, horizon=2)) is None
