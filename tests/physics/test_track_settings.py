"""Every setting of tracking reaches it, and what a hand holds goes where the hand goes."""

import numpy as np
import pytest
import torch

from piegraph_cli.physics import follower
from piegraph_cli.physics.association import thin
from piegraph_cli.physics.follower import GRASP_RADIUS
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.physics.tracking import spring_radius, track
from piegraph_cli.stages.images import Views
from tests.physics.objects import surface, turned
from tests.stages.chain import from_above, make_tracks

SMALL = {"particles": 12, "tracked": 30, "points": 200, "rounds": 4, "iterations": 4}
CHANGES = {
    "association": "nearest",
    "particles": 9,
    "tracked": 25,
    "damping": 0.4,
    "stiffness": 0.02,
    "gain": 0.1,
    "rounds": 8,
    "iterations": 9,
    "scales": (0.015, 0.01),
    "points": 90,
}
OF_THE_STAGE = {"mode", "object"}


def clouds(frames: int = 3) -> list[np.ndarray]:
    """A T that moves and turns, both ends of its bar bent up a little more in every frame."""
    points = surface(500, np.random.default_rng(0))
    found = []
    for k in range(frames):
        bent = points.copy()
        bent[:, 2] += 0.6 * k * np.abs(points[:, 0])
        found.append(turned(bent, (0.012 * k, 0.005 * k, 0.1 * k)))
    return found


CLOUDS = clouds()


def tracked(**settings) -> np.ndarray:
    return track(CLOUDS, TrackParams(**SMALL | settings)).positions


@pytest.mark.parametrize("field", CHANGES)
def test_every_setting_changes_the_tracks(field):
    assert {*CHANGES, *OF_THE_STAGE} == set(TrackParams.model_fields)
    one, again, other = tracked(), tracked(), tracked(**{field: CHANGES[field]})
    np.testing.assert_array_equal(one, again)
    assert one.shape != other.shape or np.abs(one[1:] - other[1:]).max() > 1e-5
    if field not in ("particles", "tracked", "association"):
        np.testing.assert_array_equal(one[0], other[0])


def test_the_exported_particles_are_the_first_of_those_tracked():
    for association, chosen in (("soft", 30), ("nearest", 12)):
        found = track(CLOUDS, TrackParams(**SMALL | {"association": association}))
        assert found.positions.shape == (3, 12, 3)
        assert found.weight.shape == (3, 12)
        np.testing.assert_allclose(found.positions[0], choose_particles(CLOUDS[0], chosen)[:12], atol=1e-6)
        assert found.springs.particles == 12
        rest = found.springs.rest_length
        first, second = found.springs.pairs.T
        apart = np.linalg.norm(found.positions[0][first] - found.positions[0][second], axis=1)
        np.testing.assert_allclose(rest, apart, atol=1e-6)
        assert rest.max() <= spring_radius(found.positions[0]) + 1e-6


def test_particles_are_joined_over_twice_their_spacing_and_3_cm_at_least():
    grid = np.array([[x, y, 0.0] for x in range(4) for y in range(4)])
    assert spring_radius(grid * 0.02) == pytest.approx(0.044)
    assert spring_radius(grid * 0.01) == pytest.approx(0.03)
    assert spring_radius(grid[:1]) == pytest.approx(0.03)


def test_clouds_are_thinned_to_the_points_asked_for(monkeypatch):
    counts, real = [], follower.thin
    monkeypatch.setattr(follower, "thin", lambda cloud, count: counts.append(count) or real(cloud, count))
    tracked(points=70)
    assert counts == [70] * 3
    assert thin(CLOUDS[0], 70).shape == (70, 3)
    assert torch.equal(thin(CLOUDS[0], 70), thin(CLOUDS[0], 90)[:70])
    assert thin(CLOUDS[0], 10_000).shape == (500, 3)


def test_rounds_are_dealt_out_over_the_scales_in_turn():
    assert TrackParams(rounds=20, scales=(0.02, 0.01, 0.008)).turns == [7, 7, 6]
    assert TrackParams(rounds=4, scales=(0.02,)).turns == [4]


def test_each_round_assigns_at_its_scale_and_then_moves_by_its_iterations(monkeypatch):
    scales, iterations = [], []
    drive, setpoint = follower.drive, follower.SoftAssignment.setpoint

    def count(positions, velocity, target, graph, params, weights):
        iterations.append(params.iterations)
        return drive(positions, velocity, target, graph, params, weights)

    monkeypatch.setattr(follower, "drive", count)
    monkeypatch.setattr(
        follower.SoftAssignment,
        "setpoint",
        lambda self, x, cloud, scale, r: scales.append(scale) or setpoint(self, x, cloud, scale, r),
    )
    monkeypatch.setattr(follower, "SETTLED", 0.0)
    tracked(rounds=5, scales=(0.02, 0.01), iterations=6)
    assert scales == [0.02, 0.02, 0.02, 0.01, 0.01] * 2
    assert iterations == [6] * 10


def test_gains_and_springs_are_those_of_the_settings(monkeypatch):
    seen, real = [], follower.drive

    def note(positions, velocity, target, graph, params, weights):
        seen.append(params)
        return real(positions, velocity, target, graph, params, weights)

    monkeypatch.setattr(follower, "drive", note)
    tracked(stiffness=0.01, gain=0.04, damping=0.7)
    assert {(p.stiffness, p.gain, p.damping) for p in seen} == {(0.01, 0.04, 0.7)}
    seen.clear()
    tracked(stiffness=50.0)
    assert 0.01 < seen[0].stiffness < 1, "lowered to what the springs bear"


def hand_of(frames: int, lift: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """A hand that closes around a particle in frame 1 and goes 3 cm in x and up until it lets go in the last frame."""
    start = choose_particles(CLOUDS[0], 1)[0]
    hand = np.tile(start, (frames, 1))
    hand[2:] += [0.03, 0, lift]
    return hand.astype(np.float32), np.array([False, *[True] * (frames - 2), False])


def test_what_a_hand_holds_goes_with_it_and_is_let_go():
    hand, grasp = hand_of(4)
    still = [CLOUDS[0], CLOUDS[0], np.zeros((0, 3)), np.zeros((0, 3))]
    found = track(still, TrackParams(**SMALL), hand=hand, grasp=grasp)
    held = np.linalg.norm(found.positions[1] - hand[1], axis=1) < GRASP_RADIUS - 1e-3
    moved = found.positions[2] - found.positions[1]
    assert held.any()
    np.testing.assert_allclose(moved[held].mean(0), [0.03, 0, 0.03], atol=0.012)
    assert np.linalg.norm(moved[held], axis=1).min() > np.linalg.norm(moved[~held], axis=1).mean()
    np.testing.assert_array_equal(found.positions[3], found.positions[2])
    without = track(still, TrackParams(**SMALL)).positions
    np.testing.assert_array_equal(without[2], without[1])


@pytest.mark.parametrize("mode", ["push", "pick"])
def test_a_hand_carries_the_object_in_recordings_of_picks_alone(mode):
    hand, _ = hand_of(3)
    clouds = [CLOUDS[0], CLOUDS[0], np.zeros((0, 3))]
    found = make_tracks(clouds, hand, np.array([False, True, True]), mode=mode, **SMALL)
    by_hand = {"hand": hand, "grasp": np.array([False, True, True])} if mode == "pick" else {}
    views = Views(*from_above(3).values())
    given = TrackParams(**SMALL, mode=mode)
    np.testing.assert_array_equal(found["positions"], track(clouds, given, views=views, **by_hand).positions)
    assert (np.abs(found["positions"][2] - found["positions"][1]).max() > 0.01) == (mode == "pick")
    assert np.asarray(found["mode"]).astype(int).tolist() == [int(mode == "pick")] * 3
    np.testing.assert_array_equal(found["contact"], [False, True, True])
    np.testing.assert_array_equal(found["end_effector"], hand)
