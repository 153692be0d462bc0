"""Expected errors: what a calibration learns from signs and errors, and what it is not told."""

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.reliability import BOUND, ENOUGH, GROWTH, Calibration, calibrated_apart, signs_of

RNG = np.random.default_rng(0)
SIGNS = RNG.uniform(0, 0.1, (400, 2))


def test_a_calibration_is_the_one_that_errors_were_made_with():
    errors = 0.002 + SIGNS @ [0.1, 0.5]
    found = Calibration.fit(SIGNS, errors)
    assert (found.constant, found.of_motion, found.of_correction) == pytest.approx((0.002, 0.1, 0.5))
    assert found.bound == pytest.approx(1)
    np.testing.assert_allclose(found.expected(SIGNS), errors)
    np.testing.assert_allclose(found.expected(torch.as_tensor(3 * SIGNS), 3), errors * 3**GROWTH)


def test_no_sign_makes_a_prediction_surer():
    found = Calibration.fit(SIGNS, 0.02 - 0.1 * SIGNS[:, 0])
    assert min(found.constant, found.of_motion, found.of_correction) >= 0
    assert found.of_motion == 0


def test_nine_in_ten_errors_lie_below_the_bound():
    errors = SIGNS[:, 0] * RNG.exponential(0.2, 400)
    found = Calibration.fit(SIGNS, errors)
    assert (errors <= found.bound * found.expected(SIGNS)).mean() == pytest.approx(BOUND, abs=0.01)


def test_few_strokes_tell_a_share_of_the_motion_alone():
    few = SIGNS[: ENOUGH - 1]
    found = Calibration.fit(few, 0.003 + 0.2 * few[:, 0])
    assert (found.constant, found.of_correction) == (0, 0)
    assert found.of_motion > 0.2


def test_errors_of_a_sequence_do_not_tell_what_to_expect_of_it():
    groups, errors = np.repeat(["a", "b"], 200), 0.1 * SIGNS[:, 0]
    errors[200:] *= 3
    known = calibrated_apart(SIGNS, errors, groups)
    assert known["a"].of_motion == pytest.approx(0.3, abs=1e-6)
    assert known["b"].of_motion == pytest.approx(0.1, abs=1e-6)
    assert calibrated_apart(SIGNS, errors, np.repeat("a", 400)) == {}


def test_what_never_errs_is_expected_not_to():
    found = Calibration.fit(SIGNS, np.zeros(400))
    assert (found.expected(SIGNS) == 0).all()


def test_signs_are_how_far_particles_move_and_how_far_they_are_corrected():
    before = torch.zeros(2, 4, 3)
    setpoint, after = before + torch.tensor([0.03, 0.0, 0.0]), before + torch.tensor([0.03, 0.04, 0.0])
    assert signs_of(before, setpoint, after).tolist() == [[pytest.approx(0.05), pytest.approx(0.04)]] * 2
