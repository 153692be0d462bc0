"""Outlines of garments and the triangles that fill them."""

import math

import numpy as np
import pytest

from piegraph_cli.environments.cloth_mesh import square_outline, triangulate, tshirt_outline


def turning(points):
    """Angle [K] (degrees) by which a closed polygon [K, 2] turns left at each point."""
    step = np.roll(points, -1, axis=0) - points
    heading = np.arctan2(step[:, 1], step[:, 0])
    return np.degrees((heading - np.roll(heading, 1) + math.pi) % (2 * math.pi) - math.pi)


@pytest.mark.parametrize(
    ("curves", "size", "corners", "bend"), [(tshirt_outline, 0.3, 8, 50), (square_outline, 0.3, 4, 1e-6)]
)
def test_the_outline_turns_at_its_corners_only(curves, size, corners, bend):
    mesh = triangulate(curves(), size, 0.0145)
    turns = turning(mesh.points[: mesh.rim])
    assert turns.sum() == pytest.approx(360)
    assert len(mesh.corners) == corners
    assert turns[list(mesh.corners)].min() > 70
    between = turns.copy()
    between[list(mesh.corners)] = 0
    assert np.abs(between).max() < bend
    # steps of stairs turn to and fro; a smooth curve turns one way for a while
    other_way = between[:-1] * between[1:] < 0
    assert np.minimum(np.abs(between[:-1]), np.abs(between[1:]))[other_way].max(initial=0) < 1


@pytest.mark.parametrize("curves", [tshirt_outline, square_outline])
def test_triangles_are_even_and_fill_the_outline(curves):
    mesh = triangulate(curves(), 0.3, 0.0145)
    x, y = mesh.points[: mesh.rim].T
    assert mesh.areas.sum() == pytest.approx((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)
    corners = mesh.points[mesh.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert lengths.min() / 0.0145 > 0.5
    assert lengths.max() / 0.0145 < 1.6
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all()
