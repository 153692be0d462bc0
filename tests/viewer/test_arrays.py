"""What is drawn, as arrays."""

import numpy as np
import pytest

from piegraph_cli.recording.camera import Camera
from piegraph_cli.viewer.arrays import (
    LONG,
    MOST_POINTS,
    REST,
    SHORT,
    UNKNOWN,
    cloud_colors,
    rgb,
    segments,
    spring_graph,
    strain_colors,
    strain_of,
    thinned,
    view_on,
)
from piegraph_cli.viewer.curves import shortened, with_line
from piegraph_cli.viewer.pictures import Picture
from piegraph_cli.viewer.plan_layer import candidate_lines, cost_colors


def picture(height: float, color: tuple[int, int, int], mask: np.ndarray | None, reduced: int = 1) -> Picture:
    """A camera that looks down from a height (m); its left half sees black."""
    pose = np.diag([1.0, -1, -1, 1])
    pose[2, 3] = height
    K = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])
    image = np.full((100 // reduced, 100 // reduced, 3), color, np.uint8)
    image[:, : 50 // reduced] = 0
    return Picture(Camera("c", 100, 100, K, np.zeros(5), pose), image, mask, reduced)


@pytest.mark.parametrize("reduced", [1, 2])
def test_points_have_the_colour_that_a_camera_sees_at_their_place(reduced):
    points = np.array([[0.2, 0, 0], [-0.2, 0, 0]])
    colors = cloud_colors(points, [picture(1.0, (200, 10, 30), None, reduced)])
    np.testing.assert_array_equal(colors, [[200, 10, 30], [0, 0, 0]])


def test_what_a_mask_leaves_out_is_another_cameras_or_the_median():
    mask = np.ones((100, 100), bool)
    mask[:, 60:] = False
    points = np.array([[0.05, 0, 0], [0.2, 0, 0], [0.05, 0.1, 0]])
    near, far = picture(1.0, (200, 0, 0), mask), picture(2.0, (0, 200, 0), np.ones((100, 100), bool))
    np.testing.assert_array_equal(cloud_colors(points, [far, near]), [[200, 0, 0], [0, 200, 0], [200, 0, 0]])
    np.testing.assert_array_equal(cloud_colors(points, [near])[1], [200, 0, 0])


def test_points_behind_and_beside_every_camera_are_grey():
    points = np.array([[0, 0, 2.0], [9, 0, 0]])
    np.testing.assert_array_equal(cloud_colors(points, [picture(1.0, (200, 0, 0), None)]), [UNKNOWN] * 2)
    assert cloud_colors(np.zeros((0, 3)), [picture(1.0, (200, 0, 0), None)]).shape == (0, 3)
    np.testing.assert_array_equal(cloud_colors(points, []), [UNKNOWN] * 2)


def test_large_clouds_are_thinned_evenly_and_small_ones_are_not():
    points = np.arange(150_000.0).reshape(-1, 3)
    kept = thinned(points)
    assert MOST_POINTS / 2 < len(kept) <= MOST_POINTS
    np.testing.assert_array_equal(np.diff(kept[:, 0]), 9.0)
    assert thinned(points[:MOST_POINTS]) is not points
    assert len(thinned(points[:MOST_POINTS])) == MOST_POINTS


def test_strain_is_the_share_of_the_rest_length_and_has_its_colour():
    pairs, rest = np.array([[0, 1], [1, 2], [0, 2]]), np.array([0.01, 0.01, 0.02])
    moved = np.array([[0, 0, 0], [0.012, 0, 0], [0.02, 0, 0]])
    strain = strain_of(moved, pairs, rest)
    np.testing.assert_allclose(strain, [0.2, -0.2, 0], atol=1e-9)
    np.testing.assert_array_equal(strain_colors(strain), np.array([LONG, SHORT, REST], np.uint8))
    assert np.isfinite(strain_of(moved, pairs, np.zeros(3))).all()


@pytest.mark.parametrize("count", [1, 2, 2000])
def test_dense_particles_have_springs_to_neighbours_alone(count):
    particles = np.random.default_rng(0).uniform(0, 0.1, (count, 3))
    graph = spring_graph(particles)
    assert count - 1 <= len(graph.pairs) <= 30 * count


def test_segments_leave_out_ends_that_are_not_known():
    joints = np.array([[0, 0, 0], [1, 1, 1], [np.nan, 0, 0]])
    np.testing.assert_array_equal(segments(joints, [(0, 1), (1, 2)]), [[[0, 0, 0], [1, 1, 1]]])
    assert segments(joints, np.zeros((0, 2), int)).shape == (0, 2, 3)


def test_the_first_look_is_at_the_middle_and_farther_from_what_is_larger():
    small = np.array([[0, 0, 0], [0.2, 0.1, 0], [np.nan, 0, 0]])
    position, middle = view_on(small)
    np.testing.assert_allclose(middle, [0.1, 0.05, 0])
    assert position[2] > 0
    near, far = (np.linalg.norm(np.subtract(*view_on(small * scale))) for scale in (1, 3))
    assert far == pytest.approx(3 * near)
    assert np.isfinite(view_on(np.full((2, 3), np.nan))).all()


def test_the_line_of_the_time_line_leaves_curves_as_they_are():
    time, curve = np.array([0.0, 1, 2]), np.array([5.0, 7, 6])
    x, with_now, line = with_line(time, [curve], 0.5, 9.0)
    np.testing.assert_array_equal(x, [0, 0.5, 0.5, 1, 2])
    np.testing.assert_array_equal(with_now, [5, 6, 6, 7, 6])
    np.testing.assert_array_equal(line, [np.nan, 0, 9, np.nan, np.nan])
    np.testing.assert_array_equal(with_line(time, [curve], 0.5, 9.0, dots=True)[1], [5, np.nan, np.nan, 7, 6])


def test_long_curves_keep_their_peaks():
    values = np.zeros(6000)
    values[4321] = 3.0
    values[:6] = np.nan
    short = shortened(values)
    assert len(short) == 1000
    assert np.nanmax(short) == 3.0
    assert np.isnan(short[0])
    assert shortened(values[:1000]).shape == (1000,)


def test_candidates_are_drawn_by_their_first_stroke_cheap_ones_dark():
    strokes = np.zeros((3, 2, 2, 2), np.float32)
    strokes[:, 0, 1] = [[0.1, 0], [0.2, 0], [np.nan, 0]]
    lines = candidate_lines(strokes, 0.03)
    np.testing.assert_allclose(lines[1], [[0, 0, 0.03], [0.2, 0, 0.03]], atol=1e-7)
    cheap, dear, none = cost_colors(np.array([0.01, 0.5, np.nan])).sum(1)
    assert cheap < dear == none


def test_colours_as_numbers():
    assert rgb("#2b74d8") == (43, 116, 216)
