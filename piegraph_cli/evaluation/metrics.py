"""Distances between predicted and true particles."""

import numpy as np

from piegraph_cli.physics.particles import chamfer

CENTIMETRE = 100.0

SHAPE_RADIUS = 0.05
"""Metres: `shape_error` looks at pairs of particles that are nearer than this at rest, whatever the springs of a model."""


def particle_distance(predicted: np.ndarray, target: np.ndarray) -> float:
    """Mean Euclidean distance of corresponding particles [N, 3] (m), in cm. Source: paper, IV-A."""
    return float(np.linalg.norm(predicted - target, axis=-1).mean()) * CENTIMETRE


def nearest_distance(predicted: np.ndarray, copies: np.ndarray) -> float:
    """Particle distance, in cm, to the nearest of copies [K, N, 3] (m) of the target that no cloud can tell apart."""
    return min(particle_distance(predicted, copy) for copy in copies)


def chamfer_distance(predicted: np.ndarray, target: np.ndarray) -> float:
    """Sum of the two mean nearest-point distances of clouds [N, 3], [M, 3] (m), in cm. Source: paper, Table I."""
    return chamfer(predicted, target) * CENTIMETRE


def shape_error(predicted: np.ndarray, target: np.ndarray, edges: np.ndarray) -> float:
    """Mean squared error of the offsets along edges [E, 2], in cm^2. Source: paper, Eq. 7."""
    first, second = edges.T
    error = (predicted[first] - predicted[second]) - (target[first] - target[second])
    return float((error**2).sum(-1).mean()) * CENTIMETRE**2
