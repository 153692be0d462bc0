"""Tracking against material points whose motion is known."""

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.association import SoftAssignment, align, soft_means, thin
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.physics.tracking import TrackParams, track
from tests.physics.objects import block_recording, rope, surface, turned


@pytest.fixture(scope="module")
def block():
    return block_recording()


@pytest.fixture(scope="module")
def tracked(block):
    return track(block[0])


def error(result, poses) -> np.ndarray:
    """Mean distance per frame (m) to the material points chosen in the first frame."""
    first = turned(result.positions[0] - [poses[0][0], poses[0][1], 0], (0, 0, -poses[0][2]))
    truth = np.array([turned(first, pose) for pose in poses])
    return np.linalg.norm(result.positions - truth, axis=2).mean(axis=1)


def test_particles_stay_on_their_material_points(block, tracked):
    found = error(tracked, block[1])
    assert found[-1] < 0.004
    assert found.max() < 0.005
    assert tracked.positions.shape == (14, 50, 3)
    assert tracked.positions.dtype == np.float32
    assert not tracked.held.any()
    assert tracked.springs.particles == 50


def test_nearest_points_let_them_slide(block, tracked):
    nearest = track(block[0], TrackParams(association="nearest"))
    assert error(nearest, block[1])[-1] > 3 * error(tracked, block[1])[-1]
    assert error(nearest, block[1])[-1] > 3 * nearest.residual[-1]  # which the residual does not show


def test_hidden_particles_lose_weight(tracked):
    assert tracked.weight[1:].min() < 0.2
    assert np.median(tracked.weight) > 0.8
    assert tracked.weight.max() <= 1


def test_the_same_clouds_give_the_same_tracks(block, tracked):
    again = track(block[0][:5])
    np.testing.assert_array_equal(again.positions, tracked.positions[:5])


def test_golden_positions(tracked):
    golden = np.load(__file__.replace("test_tracking.py", "golden_tracking.npy"))
    np.testing.assert_allclose(tracked.positions[[0, 6, 13], :10], golden, atol=2e-4)


def test_one_frame(block):
    result = track(block[0][:1])
    assert result.positions.shape == (1, 50, 3)
    assert result.residual[0] < 1e-3


@pytest.mark.parametrize("association", ["soft", "nearest"])
def test_an_unseen_frame_is_held_and_flagged(block, association):
    clouds = list(block[0][:6])
    clouds[2], clouds[3] = np.zeros((0, 3)), clouds[3][:10]
    result = track(clouds, TrackParams(association=association))
    np.testing.assert_array_equal(result.held, [False, False, True, True, False, False])
    np.testing.assert_array_equal(result.positions[2], result.positions[1])
    np.testing.assert_array_equal(result.positions[3], result.positions[1])
    assert (result.weight[2:4] == 0).all()
    assert np.isfinite(result.residual).all()
    assert (result.positions[4] != result.positions[1]).any()


def test_bad_clouds_are_named(block):
    clouds = list(block[0][:4])
    with pytest.raises(DataError, match="no frames"):
        track([])
    with pytest.raises(DataError, match=r"frame 0: .*points"):
        track([np.zeros((0, 3)), *clouds])
    with pytest.raises(DataError, match=r"frame 0: .*150 particles") as refusal:
        track([clouds[0][:100]])
    assert "fewer particles" in refusal.value.hint
    clouds[2] = clouds[2].copy()
    clouds[2][5, 1] = np.nan
    with pytest.raises(DataError, match="frame 2"):
        track(clouds)
    with pytest.raises(DataError, match="frame 1"):
        track([clouds[0], np.zeros((30, 2))])


def test_bad_parameters_are_refused(block):
    with pytest.raises(ValidationError, match="60 particles"):
        TrackParams(particles=60, tracked=50)
    with pytest.raises(ValidationError, match="scales"):
        TrackParams(scales=(0.01, 0.0))
    with pytest.raises(UsageError, match="missing"):
        track(block[0][:1], grasp=np.ones(1, bool))


def test_progress_sees_every_frame(block):
    seen = []

    def progress(clouds):
        for cloud in clouds:
            seen.append(len(cloud))
            yield cloud

    track(block[0][:3], progress=progress)
    assert seen == [len(cloud) for cloud in block[0][:3]]


def test_a_rope_is_followed_into_its_bend():
    rng = np.random.default_rng(2)
    clouds = [rope(bend) + rng.normal(0, 0.0015, (1500, 3)) for bend in np.linspace(0.1, 2.0, 12)]
    result = track(clouds)
    start = [np.linalg.norm(clouds[0] - p, axis=1).argmin() for p in result.positions[0]]
    truth = rope(2.0)[start]
    assert np.linalg.norm(result.positions[-1] - truth, axis=1).mean() < 0.008
    assert np.linalg.norm(result.positions[0] - truth, axis=1).mean() > 0.015


def test_the_hand_carries_what_it_holds_unseen(block):
    cloud = block[0][0]
    hand = np.tile(choose_particles(cloud, 1)[0], (5, 1))
    hand[2:] += [0.03, 0.02, 0.05]
    clouds = [cloud, cloud] + [np.zeros((0, 3))] * 3
    result = track(clouds, hand=hand, grasp=np.array([False, True, True, True, False]))
    near = np.linalg.norm(result.positions[1] - hand[1], axis=1) < 0.019
    moved = result.positions[3] - result.positions[1]
    assert near.any()
    np.testing.assert_allclose(moved[near].mean(0), [0.03, 0.02, 0.05], atol=0.01)
    np.testing.assert_array_equal(result.positions[4], result.positions[3])


def test_stray_points_are_not_chosen():
    rng = np.random.default_rng(0)
    cloud = surface(2500, rng)
    stray = rng.uniform([-0.3, -0.3, 0.2], [0.3, 0.3, 0.8], (8, 3))
    chosen = choose_particles(np.concatenate([cloud, stray]), 50)
    assert chosen[:, 2].max() < 0.04


def test_alignment_finds_a_rigid_motion():
    rng = np.random.default_rng(0)
    particles = torch.as_tensor(choose_particles(surface(2500, rng), 150), dtype=torch.float32)
    cloud = thin(turned(surface(2500, rng), (0.012, -0.008, 0.15)), 800)
    truth = turned(particles.numpy(), (0.012, -0.008, 0.15))
    assert np.linalg.norm(align(particles, cloud).numpy() - truth, axis=1).mean() < 0.004


def test_soft_means_are_what_they_say():
    rng = np.random.default_rng(0)
    x, y = rng.random((5, 3)) * 0.05, rng.random((40, 3)) * 0.05
    kernel = np.exp(-((x[:, None] - y[None]) ** 2).sum(2) / (2 * 0.02**2))
    share = kernel / (kernel.sum(0) + 0.1 * np.exp(-3.125))
    means, total = soft_means(torch.as_tensor(x), torch.as_tensor(y), 0.02)
    np.testing.assert_allclose(total, share.sum(1), rtol=1e-6)
    np.testing.assert_allclose(means, share @ y / share.sum(1)[:, None], rtol=1e-6)


def test_calibrated_setpoint_of_an_unmoved_and_a_turned_object():
    cloud = surface(800, np.random.default_rng(0))
    first = torch.as_tensor(choose_particles(cloud, 150), dtype=torch.float32)
    soft = SoftAssignment(first, thin(cloud, 800), (0.012,))
    pose = (0.1, 0.05, 1.2)
    now = torch.as_tensor(turned(first.numpy(), pose), dtype=torch.float32)
    setpoint, seen = soft.setpoint(now, thin(turned(cloud, pose), 800), 0.012, soft.rotations(now))
    torch.testing.assert_close(setpoint, now, atol=1e-4, rtol=0)
    torch.testing.assert_close(seen, torch.ones(150), atol=1e-3, rtol=0)


def test_a_hidden_side_does_not_fold_a_rigid_object(block):
    """A hand hides one side for many frames; with springs alone the hidden side creeps over the rest and stays there."""
    cloud = block[0][0]
    hidden = cloud[cloud[:, 0] > np.quantile(cloud[:, 0], 0.12)]
    result = track([cloud, *[hidden] * 8, cloud])
    moved = np.linalg.norm(result.positions - result.positions[0], axis=-1)
    assert moved.mean(axis=1).max() < 0.002
    assert moved.max() < 0.006
