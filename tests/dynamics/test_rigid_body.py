"""The rigid body: outlines, pushes whose answer is known, numbers found again, and what is told of what bends."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.models import Trained, make_foresee
from piegraph_cli.dynamics.outline import laid_on, outline_of
from piegraph_cli.dynamics.params import PredictionParams, RigidParams
from piegraph_cli.dynamics.rigid_body import RigidBody, body_frame, is_rigid
from piegraph_cli.dynamics.rigid_kernel import push
from piegraph_cli.errors import DataError
from piegraph_cli.physics.rigid import planar_fit

SQUARE = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
EDGES = torch.as_tensor(np.hstack([SQUARE, np.roll(SQUARE, -1, 0)]), dtype=torch.float32)
C = 0.04


def after(stroke: list[float], friction: float = 0.3, reach: float = 0.01, pose=(0.0, 0.0, 0.0), centre=(0.0, 0.0)):
    """The pose of the square after a stroke."""
    arrays = ([pose], [stroke], [[friction, C, reach, *centre]])
    return push(EDGES, *(torch.tensor(a, dtype=torch.float32) for a in arrays))[0].numpy()


def shape(count: int = 200, seed: int = 0) -> np.ndarray:
    """Particles [N, 3] of an L, well spread."""
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(12)), -1).reshape(-1, 2) * 0.012
    own = grid[(grid[:, 0] < 0.045) | (grid[:, 1] < 0.045)]
    chosen = own + np.random.default_rng(seed).uniform(-0.001, 0.001, own.shape)
    return np.column_stack([chosen[:count], np.full(min(count, len(own)), 0.01)]).astype(np.float32)


def turned(points: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    planar = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]]) + [x, y]
    return np.column_stack([planar, points[:, 2]])


def pushed(numbers: list[float], count: int, seed: int = 0) -> Sequences:
    """Strokes of two frames of an L that moves by these numbers, a sequence each."""
    rng, body = np.random.default_rng(seed), shape()
    middle = body[:, :2].mean(0)
    local = np.column_stack([body[:, :2] - middle, body[:, 2]])
    edges = torch.as_tensor(outline_of(local[:, :2], 1.8), dtype=torch.float32)
    poses = np.column_stack([rng.uniform(-0.1, 0.1, (count, 2)), rng.uniform(-3, 3, count)])
    states = np.array([turned(local, *pose) for pose in poses])
    heading = rng.uniform(-np.pi, np.pi, count)
    along = np.column_stack([np.cos(heading), np.sin(heading)])
    aim = states[np.arange(count), rng.integers(len(body), size=count), :2]
    start, end = aim - 0.15 * along, aim + 0.03 * along
    arrays = (poses, np.hstack([start, end]), np.tile(numbers, (count, 1)))
    moved = push(edges, *(torch.as_tensor(a, dtype=torch.float32) for a in arrays)).numpy()
    ends = np.array([turned(local, *pose) for pose in moved])
    positions = np.stack([states, ends], 1).reshape(2 * count, -1, 3).astype(np.float32)
    hand = np.stack([start, end], 1).reshape(-1, 2).astype(np.float32)
    strokes = np.arange(2 * count).reshape(-1, 2)
    none = np.zeros((0, 2), np.int64)
    return Sequences(
        positions, hand, strokes, np.zeros(count, np.uint8), np.arange(count), positions[::2], none, none[:, 0]
    )


def test_a_push_through_the_middle_moves_the_body_as_far_as_the_pusher_after_it_touches():
    np.testing.assert_allclose(after([-0.1, 0, 0.0, 0]), [0.06, 0, 0], atol=1e-5)  # touches at -0.06


def test_a_push_beside_the_body_or_away_from_it_moves_nothing():
    for stroke in ([-0.1, 0.07, 0.1, 0.07], [-0.07, 0, -0.2, 0], [-0.2, 0, -0.07, 0]):
        np.testing.assert_array_equal(after(stroke), np.zeros(3, np.float32))


@pytest.mark.parametrize("side", [1, -1])
def test_the_first_motion_is_that_of_the_limit_surface(side):
    """A pusher that sticks: the force is what makes the touched point move with it; turning follows from its moment."""
    y, depth = 0.02 * side, 1e-4
    found = after([-0.06, y, -0.06 + depth, y], friction=5.0)
    mobility = np.array([[1 + y * y / C**2, 0.05 * y / C**2], [0.05 * y / C**2, 1 + 0.05**2 / C**2]])
    force = np.linalg.solve(mobility, [depth, 0])
    turn = (-0.05 * force[1] - y * force[0]) / C**2
    np.testing.assert_allclose(found, [*force, turn], rtol=2e-2, atol=1e-7)


@pytest.mark.parametrize("side", [1, -1])
def test_a_pusher_without_friction_slides_and_its_force_is_along_the_normal(side):
    y, depth = 0.02 * side, 1e-4
    found = after([-0.06, y, -0.06 + depth, y], friction=1e-6)
    force = depth / (1 + y * y / C**2)
    np.testing.assert_allclose(found, [force, 0, -y * force / C**2], rtol=2e-2, atol=1e-7)


def test_the_body_turns_away_from_a_pusher_beside_its_middle_and_not_into_it():
    found = after([-0.1, 0.03, 0.02, 0.03])
    assert found[2] < -0.1
    local = turned(np.array([[0.02 - found[0], 0.03 - found[1], 0.0]]), 0, 0, -found[2])[0, :2]
    outside = np.maximum(np.abs(local) - 0.05, 0)
    assert np.linalg.norm(outside) > 0.0095  # a pusher's radius, but for a step


def test_pushing_turns_with_the_scene_and_mirrors():
    stroke, pose = np.array([-0.1, 0.02, 0.0, 0.03]), np.array([0.01, 0.0, 0.2])
    plain = after(stroke.tolist(), pose=pose.tolist())
    cosine, sine = math.cos(0.7), math.sin(0.7)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    motion = (stroke.reshape(2, 2) @ turn.T).ravel()
    other = after(motion.tolist(), pose=[*(turn @ pose[:2]), pose[2] + 0.7])
    np.testing.assert_allclose(other, [*(turn @ plain[:2]), plain[2] + 0.7], atol=2e-5)
    mirrored = after((stroke * [1, -1, 1, -1]).tolist(), pose=(pose * [1, -1, -1]).tolist())
    np.testing.assert_allclose(mirrored, plain * [1, -1, -1], atol=2e-5)


def test_a_pusher_that_begins_too_near_moves_nothing_by_that():
    np.testing.assert_allclose(after([-0.055, 0, -0.055 + 0.02, 0])[0], 0.02, atol=1e-5)


def test_an_outline_follows_what_goes_inwards():
    body = shape()[:, :2]
    edges = outline_of(body, 1.8)
    corners = edges.reshape(-1, 2)
    notch = np.linalg.norm(corners - [0.05, 0.05], axis=1).min()
    assert notch < 0.02
    assert np.linalg.norm(outline_of(body, 100.0).reshape(-1, 2) - [0.05, 0.05], axis=1).min() > 0.03


@pytest.mark.parametrize("points", [np.zeros((2, 2)), np.column_stack([np.arange(9.0), np.zeros(9)]), np.ones((5, 2))])
def test_points_without_an_area_have_no_outline(points):
    with pytest.raises(DataError, match="span no area"):
        outline_of(points, 1.8)


def test_the_frame_is_found_when_other_particles_were_chosen():
    first, second = shape(seed=0)[:, :2], shape(seed=1)[:, :2]
    order = np.random.default_rng(2).permutation(len(second))
    moved = turned(np.column_stack([second, second[:, 0]]), 0.1, -0.2, 2.5)[order, :2]
    found = body_frame(moved, first)
    assert found[:2] == pytest.approx([0.1, -0.2], abs=1e-3)
    assert math.remainder(found[2] - 2.5, 2 * math.pi) == pytest.approx(0, abs=0.02)
    assert planar_fit(first, turned(np.column_stack([first, first]), 0.1, -0.2, 2.5)[:, :2]) == pytest.approx(
        [0.1, -0.2, 2.5]
    )


def test_numbers_are_found_again_from_strokes():
    data = pushed([0.4, 0.035, 0.012, 0.0, 0.0], 40)
    body = RigidBody(RigidParams())
    error, bent = body.fit(data)
    assert error < 6e-4
    assert bent < 1e-6
    assert body.numbers.tolist() == pytest.approx([0.4, 0.035, 0.012, 0, 0], abs=0.006, rel=0.2)
    assert body.numbers[2].item() == pytest.approx(0.012, abs=1e-3)


def test_weights_come_back_and_predict_alike():
    data = pushed([0.4, 0.035, 0.012, 0.0, 0.0], 6)
    body, other = RigidBody(RigidParams()), RigidBody(RigidParams())
    body.fit(data)
    other.load_state_dict(body.state_dict())
    start, strokes = torch.as_tensor(data.rest[:1]), data.whole()[:1]
    frame = body_frame(data.rest[0], body.shape.numpy())
    results = [one.predict(start, strokes, start[0], frame) for one in (body, other)]
    assert torch.equal(*results)
    assert (results[0][..., 2] == start[..., 2]).all()


def test_picks_are_refused_and_what_bends_is_measured():
    data = pushed([0.4, 0.035, 0.012, 0.0, 0.0], 4)
    with pytest.raises(DataError, match="a rigid body is pushed"):
        RigidBody(RigidParams()).fit(replace(data, mode=np.ones(4, np.uint8)))
    bent = data.positions.copy()
    bent[1::2, :20, 0] += 0.04
    assert RigidBody(RigidParams()).fit(replace(data, positions=bent))[1] > 0.005


L = np.array([[-0.006, -0.006], [0.138, -0.006], [0.138, 0.042], [0.042, 0.042], [0.042, 0.138], [-0.006, 0.138]])
"""The outline of `shape`, whose particles are the middles of cells of 12 mm."""


def drawn(yaw: float = 0.7) -> np.ndarray:
    """The same in a frame of its own."""
    return turned(np.column_stack([L, L[:, 0]]), 0.5, -1.0, yaw)[:, :2]


@pytest.mark.parametrize("yaw", [0.0, 0.7, 3.0])
def test_an_outline_in_any_frame_is_laid_on_its_particles(yaw):
    """The L is its own mirror image about a diagonal, so the right turn shows in where the corners come to lie."""
    body = shape()[:, :2]
    np.testing.assert_allclose(laid_on(drawn(yaw), body), L, atol=3e-3)


@pytest.mark.parametrize(
    ("corners", "message", "hint"),
    [
        (L * 1000 / 25.4, "measures .* mm, the particles .* mm", "these are inches"),
        (L * 100, "measures", "these are centimetres"),
        (L * 1.4, "measures", "the outline of this body, in metres"),
        (np.array([[0, 0], [0.144, 0], [0.144, 0.144], [0, 0.144]]), "of its inside has none near", "of this body"),
        (np.array([[0, 0], [0.19, 0], [0.19, 0.025], [0, 0.025]]), "lie outside of it", "of this body"),
    ],
)
def test_an_outline_of_another_body_or_unit_is_refused(corners, message, hint):
    with pytest.raises(DataError, match=message) as fault:
        laid_on(corners, shape()[:, :2])
    assert hint in str(fault.value.hint)


def test_an_outline_seen_from_below_is_told():
    body = shape()[:, :2]
    body = body[body[:, 0] < 0.09]
    corners = np.minimum(L, [0.09, 1.0])
    laid_on(corners, body)
    with pytest.raises(DataError) as fault:
        laid_on(corners * [-1, 1], body)
    assert "turn its y over" in str(fault.value.hint)


def test_a_body_pushes_by_the_outline_it_is_given_and_keeps_it():
    """Of few particles an alpha shape is too small; the pusher's true reach is found with the true outline alone."""
    data = pushed([0.4, 0.035, 0.012, 0.0, 0.0], 12)
    body, other = RigidBody(RigidParams()), RigidBody(RigidParams())
    body.fit(data, drawn())
    assert len(body.edges) == 6
    assert body.numbers[2].item() == pytest.approx(0.006, abs=2e-3)  # the outline is 6 mm outside of the particles
    other.load_state_dict(body.state_dict())
    assert torch.equal(body.edges, other.edges)


def test_numbers_that_are_not_fitted_stay_as_given():
    data = pushed([0.4, 0.035, 0.012, 0.0, 0.0], 4)
    body = RigidBody(RigidParams(fit=False, friction=0.3, reach=0.02))
    body.fit(data)
    gyration = np.sqrt(np.square(data.rest[0][:, :2] - data.rest[0][:, :2].mean(0)).sum(1).mean())
    np.testing.assert_allclose(body.numbers, [0.3, 0.8 * gyration, 0.02, 0, 0], rtol=1e-5)


def test_what_is_rigid_is_told_and_nothing_else_is():
    data = pushed([0.4, 0.035, 0.012, 0.0, 0.0], 8)
    assert is_rigid(data)
    assert not is_rigid(replace(data, mode=np.ones(8, np.uint8)))
    noise = np.random.default_rng(0).normal(0, 0.004, data.positions.shape).astype(np.float32)
    assert not is_rigid(replace(data, positions=data.positions + noise))
    still = np.repeat(data.positions[::2], 2, axis=0)
    assert not is_rigid(replace(data, positions=still)), "strokes that miss say nothing"
    line = data.positions * np.array([1, 0.02, 1], np.float32)
    assert not is_rigid(replace(data, positions=line, rest=line[::2])), "a rope that stays straight"


def test_ends_lie_apart_where_strokes_do_not_tell_and_models_of_before_say_nothing():
    data, test = pushed([0.3, 0.045, 0.008, 0.0, 0.0], 6), pushed([0.3, 0.045, 0.008, 0.0, 0.0], 60, seed=1)
    noise = np.random.default_rng(0).normal(0, 0.002, (len(data.strokes), 1, 3)).astype(np.float32)
    ends = data.positions.copy()
    ends[1::2] += noise  # each stroke ends a little off: other draws give other numbers
    body = RigidBody(RigidParams())
    body.fit(replace(data, positions=ends))
    rest = torch.as_tensor(test.rest[0])
    at = torch.as_tensor(np.repeat(test.rest[:1], 60, 0))
    trained = Trained(body, body.params, 0.01, (0,), 60)
    foresee = make_foresee("rigid", trained, rest, PredictionParams())
    motion = test.whole().moved(torch.eye(2))
    found, signs = foresee(at, motion)
    moved = (found - at).norm(dim=-1).mean(1)
    torch.testing.assert_close(signs[:, 0], moved)
    assert (signs[moved < 1e-6, 1] == 0).all(), "what is missed is sure"
    assert signs[moved > 0.01, 1].median() > 1e-4
    weights = {name: value for name, value in body.state_dict().items() if name != "others"}
    before = RigidBody(RigidParams())
    before.load_state_dict(weights)
    _, signs = make_foresee("rigid", replace(trained, network=before), rest, PredictionParams())(at, motion)
    assert (signs[:, 1] == 0).all()
    torch.testing.assert_close(signs[:, 0], moved)
    with pytest.raises(RuntimeError, match="numbers"):
        before.load_state_dict({name: value for name, value in weights.items() if name != "numbers"})
