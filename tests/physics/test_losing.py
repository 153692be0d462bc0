"""What tracking makes of an object that is half hidden, out of sight for a while, or replaced by another thing."""

import cv2
import numpy as np
import pytest

from piegraph_cli.physics.tracking import track
from piegraph_cli.physics.trust import LEAST, SLIDE, UNKNOWN, expected_error
from piegraph_cli.physics.visibility import View, look
from piegraph_cli.recording.camera import Camera
from tests.physics.objects import HEIGHT, surface, turned

POSE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
CAMERA = Camera("top", 240, 240, np.array([[250.0, 0, 120], [0, 250, 120], [0, 0, 1]]), np.zeros(5), POSE)
BOX = 0.2
"""Height of a box that hides what is under it, metres."""
TOP = surface(6000, np.random.default_rng(0))
TOP = TOP[TOP[:, 2] == HEIGHT]


def seen_from_above(pose, hidden_to: float | None = None) -> tuple[np.ndarray, list[View]]:
    """Cloud and view of the T's top at a pose; what has x below `hidden_to` is under a box."""
    rng = np.random.default_rng(round(1000 * abs(pose[2])))
    points = turned(TOP, pose) + rng.normal(0, 0.001, TOP.shape)
    column, row = CAMERA.project(points)[0].round().astype(int).T
    mask = np.zeros((240, 240), np.uint8)
    inside = (column >= 0) & (column < 240) & (row >= 0) & (row < 240)
    mask[row[inside], column[inside]] = 1
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)).astype(bool)
    depth = np.where(mask, 1 - HEIGHT, 1.0)
    if hidden_to is not None:
        under = np.arange(240) < 120 + 250 * hidden_to / (1 - HEIGHT)
        mask[:, under], depth[:, under] = False, 1 - BOX
        inside &= points[:, 0] >= hidden_to
    cloud = points[inside]
    cloud = cloud[rng.permutation(len(cloud))[: 1200 * len(cloud) // len(TOP)]]
    return cloud, [View(CAMERA, (depth * 1000).astype(np.uint16), mask)]


def errors(found, poses) -> np.ndarray:
    first = turned(found.positions[0] - [poses[0][0], poses[0][1], 0], (0, 0, -poses[0][2]))
    truth = np.array([turned(first, pose) for pose in poses])
    return np.linalg.norm(found.positions - truth, axis=2).mean(axis=1)


def test_what_is_seen_hidden_and_empty():
    _, views = seen_from_above((0, 0, 0), hidden_to=-0.02)
    points = np.array([[0.05, 0.05, HEIGHT], [-0.05, 0.05, HEIGHT], [0.08, -0.1, HEIGHT], [0.9, 0, HEIGHT]])
    sight = look(points, views)
    assert sight.seen.tolist() == [True, False, False, False]
    assert sight.empty.tolist() == [False, False, True, False]
    assert sight.hidden.tolist() == [False, True, False, True]
    assert look(points, ()).seen.all()


@pytest.fixture(scope="module")
def half_hidden():
    poses = [(0.012 * k, 0.004 * k, 0.05 * k) for k in range(9)]
    shown = [seen_from_above(pose, 0.03 if 2 <= k < 7 else None) for k, pose in enumerate(poses)]
    return poses, [cloud for cloud, _ in shown], [views for _, views in shown]


def test_what_is_hidden_does_not_pull(half_hidden):
    poses, clouds, views = half_hidden
    found = track(clouds, views=views)
    assert errors(found, poses).max() < 0.006
    assert errors(found, poses)[7:].max() < 0.003
    assert not found.lost.any()
    share = (found.weight > 0).mean(1)
    assert share[[1, 8]].min() > 0.95
    assert share[3:6].max() < 0.9
    blind = track(clouds)
    assert errors(blind, poses).max() > 0.015, "without the views it is drawn to what can be seen"
    assert found.doubt[3:6].mean() > 2 * found.doubt[1]


def test_an_object_that_comes_back_elsewhere_is_found_again():
    poses = [(0, 0, 0)] * 2 + [(0.08, 0.12, 2.0)] * 4
    shown = [seen_from_above(pose) for pose in poses]
    clouds, views = [cloud for cloud, _ in shown], [view for _, view in shown]
    clouds[2] = clouds[3] = np.zeros((0, 3))
    found = track(clouds, views=views)
    assert errors(found, poses)[4:].max() < 0.004
    np.testing.assert_array_equal(found.held, [False, False, True, True, False, False])
    assert not found.lost.any()
    np.testing.assert_allclose(found.doubt[2:4], UNKNOWN)


def test_another_thing_in_its_place_is_not_taken_for_it():
    cloud, views = seen_from_above((0, 0, 0))
    rng = np.random.default_rng(1)
    other = np.c_[rng.uniform([-0.02, -0.3], [0.02, 0.3], (900, 2)), np.full(900, 0.1)]
    blank = View(CAMERA, np.full((240, 240), 900, np.uint16), np.ones((240, 240), bool))
    found = track([cloud, other, other, cloud], views=[views, [blank], [blank], views])
    np.testing.assert_array_equal(found.lost, [False, True, True, False])
    assert not found.weight[1:3].any()
    np.testing.assert_array_equal(found.positions[2], found.positions[0])
    np.testing.assert_allclose(found.doubt[1:3], UNKNOWN)
    assert found.doubt[3] < 0.005


def test_a_sheet_may_slide_within_its_surface_and_a_block_may_not():
    side = np.linspace(-0.1, 0.1, 6)
    sheet = np.column_stack([np.stack(np.meshgrid(side, side), -1).reshape(-1, 2), np.full(36, 0.002)])
    block = np.concatenate([sheet, sheet + np.array([0, 0, 0.05])])
    moved = 0.02 * np.arange(6)[:, None, None] * np.array([1, 0, 0])
    expected = [
        expected_error(shape + moved, np.ones((6, len(shape))), np.full(6, 0.004), np.zeros(6, bool))
        for shape in (sheet, block)
    ]
    np.testing.assert_allclose(expected[0], LEAST + SLIDE * 0.02 * np.arange(6), rtol=1e-4)
    np.testing.assert_allclose(expected[1], LEAST, rtol=1e-4)


def test_doubt_grows_where_hidden_particles_move_and_the_cloud_is_missed():
    positions = np.zeros((6, 4, 3)) + 0.01 * np.arange(6)[:, None, None] * [1, 0, 0]
    weight, usual, known = np.ones((6, 4)), np.full(6, 0.004), np.zeros(6, bool)
    np.testing.assert_allclose(expected_error(positions, weight, usual, known), LEAST)
    missed = expected_error(positions, weight, np.add(usual, [0, 0, 0.004, 0, 0, 0]), known)
    assert missed[2] > 0.004
    np.testing.assert_allclose(missed[[1, 3]], LEAST)
    weight[2:4, :2] = 0
    hidden = expected_error(positions, weight, usual, known)
    assert (np.diff(hidden[:4]) >= 0).all()
    assert hidden[3] > hidden[4] > hidden[5] > LEAST
    still = expected_error(np.zeros((6, 4, 3)), weight, usual, known)
    np.testing.assert_allclose(still, LEAST)
    assert expected_error(positions, weight, usual, np.arange(6) == 4)[4] == pytest.approx(UNKNOWN)


def strip(bend: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Cloud [P, 3] of a strip, 40 cm by 16 mm: its last quarter is bent aside by an angle, the whole rolled by another."""
    rng = np.random.default_rng(3)
    along, aside = rng.uniform(0, 0.4, 1500), rng.uniform(-0.008, 0.008, 1500)
    over = np.maximum(along - 0.3, 0)
    turn = bend * over / 0.1
    middle = np.column_stack([along - over, np.zeros(1500)])
    if bend:
        middle += 0.1 / bend * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    else:
        middle[:, 0] += over
    beside = aside[:, None] * np.column_stack([-np.sin(turn), np.cos(turn)]) * np.cos(roll)
    points = np.column_stack([middle + beside, 0.016 + aside * np.sin(roll)])
    return points + rng.normal(0, 0.0005, points.shape)


def test_an_end_that_has_bent_stays_bent():
    bends = [0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 2.1, 2.1]
    found = track([strip(bend) for bend in bends])
    assert not found.lost.any()
    end = found.positions[0, :, 0].argmax()
    np.testing.assert_allclose(found.positions[-1, end], strip(2.1)[strip()[:, 0].argmax()], atol=0.02)


def test_a_rope_that_has_rolled_where_it_lies_is_not_lost():
    found = track([strip(), strip(), strip(roll=1.2), strip(roll=1.5), strip(roll=1.5)])
    assert found.misfit[3] > 2 * found.misfit[1]
    assert not found.lost.any()
    gone = track([strip(), strip(), strip()[:400] + np.array([0.3, 0.6, 0.0])])
    np.testing.assert_array_equal(gone.lost, [False, False, True])
