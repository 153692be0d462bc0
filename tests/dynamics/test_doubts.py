"""What is told of fits: numbers at a bound, laws that leave the motion, too few strokes, and strokes from one side."""

from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli.dynamics import own_block as own_block_module
from piegraph_cli.dynamics.doubts import at_bounds, little_told
from piegraph_cli.dynamics.own_block import own_block
from piegraph_cli.dynamics.params import RigidParams
from piegraph_cli.dynamics.rigid_body import RigidBody
from piegraph_cli.dynamics.sides import Recorded
from piegraph_cli.errors import DataError
from piegraph_cli.stages.fitted import fit_body
from tests.dynamics.test_prior import NUMBERS
from tests.dynamics.test_rigid_body import pushed


@pytest.fixture(autouse=True)
def _few_simulated(monkeypatch):
    monkeypatch.setattr(own_block_module, "SIMULATED", 40)


def some(data, chosen):
    chosen = np.asarray(chosen)
    return replace(data, strokes=data.strokes[chosen], mode=data.mode[chosen], owner=data.owner[chosen])


def one_sided(data):
    """Strokes that begin where x < 0 as the object lay in the first sequence."""
    return some(data, Recorded.of(data).seen[:, 0] < -0.3)


def aside(data):
    """The hand 20 cm beside where it was: pushes that it cannot have done."""
    return replace(data, hand=data.hand + np.float32([0, 0.2]))


def test_good_strokes_of_a_block_are_told_nothing():
    data = pushed(NUMBERS, 12)
    assert fit_body(RigidBody(RigidParams()), data).warnings == []
    assert own_block(data, 6, 0).doubts == []


def test_two_strokes_are_told_to_say_little():
    made = fit_body(RigidBody(RigidParams()), some(pushed(NUMBERS, 12), [0, 1]))
    assert made.warnings == ["2 strokes to learn from: friction and pusher are hardly told by them; record 5 or more"]
    assert np.isfinite(made.arrays["weights/numbers"]).all()


def test_strokes_from_one_side_are_told_with_what_is_open():
    data = pushed(NUMBERS, 24)
    assert little_told(data) == []
    (word,) = fit_body(RigidBody(RigidParams()), one_sided(data)).warnings
    assert "begin on one side of the object" in word
    assert "how it moves when it is pushed from there is not determined" in word
    toward = float(word.split("faced ")[1].split(" degrees")[0])
    assert abs(np.degrees(np.angle(np.exp(1j * np.radians(toward))))) < 45, "x > 0 was never touched"


def test_a_law_that_leaves_the_motion_is_no_fit():
    data = aside(pushed(NUMBERS, 8))
    warnings = fit_body(RigidBody(RigidParams()), data).warnings
    assert "cm that particles move: no block that was pushed fits" in warnings[0]
    with pytest.raises(DataError, match="no block that was pushed fits") as fault:
        own_block(data, 6, 0)
    assert "--from" in str(fault.value.hint)
    assert fit_body(RigidBody(RigidParams(fit=False)), data).warnings == [], "nothing was fitted"


def test_numbers_at_a_bound_are_named_once():
    made = fit_body(RigidBody(RigidParams(friction=3.0)), pushed(NUMBERS, 8))
    assert any("the fit of this block ends at a bound: friction with the pusher" in word for word in made.warnings)
    assert at_bounds([("a", 0.99), ("a", 1.0), ("b", 0.5)], "rope") == [
        "the fit of this rope ends at a bound: a; more strokes, or another pusher"
    ]
