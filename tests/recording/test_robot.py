"""The robot's base from made-up poses and points with noise, and what contradictory ones are told."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.errors import DataError
from piegraph_cli.recording.robot import hand_eye, touched


def pose(vector, shift) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), shift
    return T


BASE = pose([0.1, -0.2, 2.0], [0.5, -0.3, 0.02])
MOUNT = pose([0.3, 0.2, -1.0], [0.02, 0.01, 0.12])


def moves(count: int, seed: int = 0, noise=(0.0, 0.0), spread=(0.6, 0.6, 0.6)) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the gripper, pointing down, and of the board; noise in metres and radians."""
    rng = np.random.default_rng(seed)
    down = Rotation.from_rotvec([3.0, 0, 0])
    gripper = []
    for _ in range(count):
        turn = (Rotation.from_rotvec(rng.normal(0, spread, 3)) * down).as_rotvec()
        gripper.append(pose(turn, rng.uniform([0.3, -0.2, 0.1], [0.7, 0.2, 0.5])))
    board = [BASE @ T @ MOUNT @ pose(rng.normal(0, noise[1], 3), rng.normal(0, noise[0], 3)) for T in gripper]
    return np.array(gripper), np.array(board)


def off(T: np.ndarray, truth: np.ndarray = BASE) -> tuple[float, float]:
    """Millimetres and degrees."""
    turn = Rotation.from_matrix(T[:3, :3].T @ truth[:3, :3])
    return 1000 * float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(np.degrees(turn.magnitude()))


@pytest.mark.parametrize("seed", range(3))
def test_every_method_finds_the_base_of_exact_poses(seed):
    found = hand_eye(*moves(6, seed))
    assert list(found) == ["tsai", "park", "daniilidis", "shah", "refined"]
    for base in found.values():
        assert off(base.T_world_robot) == pytest.approx((0, 0), abs=1e-5)
        assert off(base.T_gripper_board, MOUNT) == pytest.approx((0, 0), abs=1e-5)
        assert base.residual.metres < 1e-7


def test_noise_stays_small_and_the_refined_fit_has_the_least_residual():
    errors = []
    for seed in range(5):
        found = hand_eye(*moves(15, seed, (0.001, np.radians(0.2))))
        assert all(off(base.T_world_robot)[0] < 8 for base in found.values())
        errors.append(off(found["refined"].T_world_robot))
        assert found["refined"].residual.metres < 0.0025
        assert found["refined"].residual.metres <= min(b.residual.metres for b in found.values()) + 1e-4
    assert np.mean(errors, 0)[0] < 2.5
    assert np.mean(errors, 0)[1] < 0.25


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (moves(2), "2 poses in which the board is seen, 3 are needed"),
        (moves(12, spread=(0, 0, 0.6)), "turns about one axis only"),
        (moves(12, spread=(0.01, 0.01, 0.01)), "hardly turns"),
        (moves(3, 2, (0.004, 0.02), (0.3, 0.3, 0.3)), "leave the base open by|contradict"),
    ],
)
def test_poses_that_do_not_tell_are_refused(given, message):
    with pytest.raises(DataError, match=message):
        hand_eye(*given)


def w_first(T: np.ndarray) -> np.ndarray:
    """As read by one who takes w for x."""
    wrong = T.copy()
    wrong[:, :3, :3] = Rotation.from_quat(np.roll(Rotation.from_matrix(T[:, :3, :3]).as_quat(), 1, 1)).as_matrix()
    return wrong


@pytest.mark.parametrize(
    ("spoil", "hint"),
    [(np.linalg.inv, "write their inverses"), (w_first, "w first"), (lambda T: T[::-1], "that of its image")],
)
def test_poses_that_contradict_each_other_are_refused_with_the_slip_that_was_tried(spoil, hint):
    gripper, board = moves(12, 0, (0.001, 0.003))
    with pytest.raises(DataError, match=r"contradict each other: \d+ mm") as refused:
        hand_eye(spoil(gripper), board)
    assert hint in refused.value.hint


POINTS = np.array([[0.4, -0.2, 0.0], [0.6, -0.2, 0.01], [0.6, 0.2, 0.0], [0.4, 0.2, 0.05], [0.5, 0.0, 0.0]])
NAMES = [f"line {n}" for n in range(2, 7)]


def in_world(points: np.ndarray) -> np.ndarray:
    return points @ BASE[:3, :3].T + BASE[:3, 3]


def test_touched_points_give_the_base():
    rng = np.random.default_rng(0)
    T, apart = touched(POINTS, in_world(POINTS) + rng.normal(0, 0.0005, POINTS.shape), NAMES)
    assert off(T)[0] < 2
    assert off(T)[1] < 0.2
    assert 0 < apart.max() < 0.002
    flat = POINTS[:3] * [1, 1, 0]
    assert off(touched(flat, in_world(flat), NAMES)[0]) == pytest.approx((0, 0), abs=1e-5)


@pytest.mark.parametrize(
    ("robot", "world", "message"),
    [
        (POINTS[:2], in_world(POINTS[:2]), "2 points, 3 are needed"),
        (POINTS * 1000, in_world(POINTS), "give metres"),
        (np.linspace(0.3, 0.5, 4)[:, None] * [[1, 1, 0]], np.linspace(0.3, 0.5, 4)[:, None] * [[1, 1, 0]], "in a line"),
        (POINTS[:4], np.tile(in_world(POINTS[:1]), (4, 1)), "in a line, or in one place, for the world"),
        (POINTS * [1, 1, -1] + [[0, 0, 0.1 * k] for k in range(5)], None, "two axes are exchanged"),
        (POINTS * 1.3, in_world(POINTS), "0.769 times as far apart"),
        (POINTS[[1, 0, 2, 3, 4]], in_world(POINTS), "is [0-9]+ mm off"),
    ],
)
def test_points_that_do_not_tell_or_do_not_fit_are_refused(robot, world, message):
    if world is None:
        world = in_world((robot * [1, 1, -1])[:, [0, 1, 2]])
    with pytest.raises(DataError) as refused:
        touched(robot, world, NAMES)
    assert re.search(message, str(refused.value))
