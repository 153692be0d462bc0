"""Bending by hand: lengths stay, what is held is where it was put if it can be, and nothing else is invented."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.physics.bending import KEPT, bend, bent_by, stretched_by
from piegraph_cli.physics.springs import build_springs

LINE = np.column_stack([np.linspace(-0.2, 0.2, 50), np.zeros(50), np.full(50, 0.01)])
ROPE = build_springs(LINE, 0.018).pairs


def test_a_rope_bends_to_where_its_ends_are_put():
    places = np.array([[-0.2, 0.0], [-0.05, 0.1]])
    bent = bend(LINE, ROPE, np.array([0, 49]), places)
    assert np.linalg.norm(bent[[0, 49], :2] - places, axis=1).max() < 0.003
    assert stretched_by(LINE, ROPE, bent) <= KEPT
    assert (bent[:, 2] == np.float32(0.01)).all()
    assert bent_by(LINE, bent) > 0.03


def test_what_is_out_of_reach_is_not_reached_by_stretching():
    bent = bend(LINE, ROPE, np.array([0, 49]), np.array([[-0.5, 0.0], [0.5, 0.0]]))
    assert stretched_by(LINE, ROPE, bent) <= KEPT
    assert np.ptp(bent[:, 0]) == pytest.approx(0.4, abs=0.01)


def test_places_of_a_rigid_motion_move_it_rigidly():
    turn = Rotation.from_euler("z", 2.0).as_matrix()
    moved = LINE @ turn.T + [0.1, -0.05, 0]
    bent = bend(LINE, ROPE, np.array([3, 20, 45]), moved[[3, 20, 45], :2])
    assert np.abs(bent - moved).max() < 1e-5
    assert bent_by(LINE, bent) < 1e-5


def test_bending_does_not_depend_on_where_the_table_is_looked_at_from():
    turn = Rotation.from_euler("z", -0.7).as_matrix()
    held, places = np.array([0, 30]), np.array([[-0.2, 0.02], [-0.02, 0.08]])
    bent = bend(LINE, ROPE, held, places)
    other = bend(LINE @ turn.T, ROPE, held, places @ turn[:2, :2].T)
    assert np.abs(bent @ turn.T - other).max() < 1e-4


def test_one_held_particle_carries_the_thing_along():
    bent = bend(LINE, ROPE, np.array([10]), LINE[[10], :2] + [0.05, 0.03])
    assert np.abs(bent - LINE - [0.05, 0.03, 0]).max() < 1e-5
