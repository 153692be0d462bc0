"""What strokes tell of what an analytic model of a rigid body leaves."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.params import RigidParams
from piegraph_cli.dynamics.rigid_body import RigidBody, body_frame
from piegraph_cli.dynamics.rigid_residual import RigidResidual
from tests.dynamics.test_rigid_body import pushed

NUMBERS = [0.4, 0.035, 0.012, 0.0, 0.0]


def strange(data: Sequences) -> Sequences:
    """Strokes that end as no friction would have it: the body goes and turns as ever, then back by a quarter of its way."""
    positions = data.positions.copy()
    went = (positions[1::2, :, :2] - positions[::2, :, :2]).mean(1, keepdims=True)
    positions[1::2, :, :2] -= went / 4
    return replace(data, positions=positions)


def errors(body: RigidBody, data: Sequences) -> np.ndarray:
    """Of strokes [S], metres."""
    shape, found = body.shape.numpy(), []
    for k, (first, last) in enumerate(data.strokes):
        rest = torch.as_tensor(data.rest[data.owner[k]])
        at = torch.as_tensor(data.positions[first : first + 1])
        predicted = body.predict(at, data.whole()[k : k + 1].to(torch.float32), rest, body_frame(rest.numpy(), shape))
        found.append(float((predicted[0] - torch.as_tensor(data.positions[last])).norm(dim=-1).mean()))
    return np.array(found)


def test_what_is_strange_is_learned_from_strokes_and_told_by_leaving_each_out():
    data, other = strange(pushed(NUMBERS, 60)), strange(pushed(NUMBERS, 40, seed=1))
    plain, body = RigidBody(RigidParams()), RigidResidual(RigidParams())
    plain.fit(data)
    expected, _ = body.fit(data)
    left = errors(body, other).mean()
    assert left < 0.75 * errors(plain, other).mean()
    assert expected == pytest.approx(left, rel=0.35)


def test_what_obeys_the_law_is_hardly_changed():
    data, other = pushed(NUMBERS, 12), pushed(NUMBERS, 30, seed=1)
    plain, body = RigidBody(RigidParams()), RigidResidual(RigidParams())
    plain.fit(data)
    body.fit(data)
    assert errors(body, other).mean() < errors(plain, other).mean() + 2e-4


def test_three_strokes_teach_nothing_more():
    data = strange(pushed(NUMBERS, 3))
    plain, body = RigidBody(RigidParams()), RigidResidual(RigidParams())
    assert plain.fit(data) == body.fit(data)
    np.testing.assert_array_equal(errors(plain, data), errors(body, data))


def test_what_is_not_touched_stays_and_weights_come_back():
    data = strange(pushed(NUMBERS, 30))
    body, other = RigidResidual(RigidParams()), RigidResidual(RigidParams())
    body.fit(data)
    assert len(body.known) == 30
    poses = torch.zeros(2, 3)
    ends = torch.tensor([[0.5, 0.5, 0.6, 0.5], [-0.2, 0.0, -0.15, 0.0]])
    assert torch.equal(body.moved(poses, ends), poses)
    other.load_state_dict(body.state_dict())
    np.testing.assert_array_equal(errors(body, data), errors(other, data))
