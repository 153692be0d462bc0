"""Spots clicked by hand: where they are, where particles carry them, and what is said of clicks that cannot be right."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.scores import SPOTS, SPOTS_SURE, spot_scores, told_spots
from piegraph_cli.evaluation.spots import Seen, Sighting, carry, distances, locate
from piegraph_cli.recording.camera import Camera

POINT = np.array([0.03, -0.02, 0.02])


def camera(name: str, angle: float, distance: float = 0.8) -> Camera:
    """Looks at the origin from a side, 45 degrees above the table."""
    away = np.array([np.cos(angle), np.sin(angle), 1.0]) / np.sqrt(2)
    right = np.array([-np.sin(angle), np.cos(angle), 0.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([right, np.cross(-away, right), -away])
    T[:3, 3] = distance * away
    K = np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])
    return Camera(name, 320, 240, K, np.zeros(5), T)


def seen(of: Camera, point: np.ndarray, depth: float | None = None, shift: tuple[float, float] = (0.0, 0.0)) -> Seen:
    """A click on a point, beside a depth image that is everywhere as deep as the point, or `depth` (m), is."""
    pixels, z = of.project(point[None])
    image = np.full((of.height, of.width), round(1000 * (z[0] if depth is None else depth)), np.uint16)
    return Seen(of, tuple(pixels[0] + shift), image)


def without_depth(one: Seen) -> Seen:
    return Seen(one.camera, one.pixel, np.zeros_like(one.depth))


def test_one_camera_places_a_spot_by_depth():
    found = locate([seen(camera("a", 0.3), POINT)])
    assert np.linalg.norm(found.point - POINT) < 0.001
    assert 0.003 < found.deviation < 0.008  # two millimetres a pixel, and three of depth


def test_two_cameras_place_it_without_depth():
    found = locate([without_depth(seen(camera("a", 0.0), POINT)), without_depth(seen(camera("b", 1.6), POINT))])
    assert np.linalg.norm(found.point - POINT) < 1e-6


def test_depth_of_something_else_does_not_move_a_spot_that_two_cameras_show():
    one, other = seen(camera("a", 0.0), POINT, depth=0.5), seen(camera("b", 1.6), POINT)
    assert np.linalg.norm(locate([one, other]).point - POINT) < 1e-6


def test_one_ray_alone_tells_nothing():
    assert locate([without_depth(seen(camera("a", 0.0), POINT))]) is None


def test_rays_that_hardly_cross_tell_nothing():
    pair = [without_depth(seen(camera("a", 0.0), POINT)), without_depth(seen(camera("b", 0.01), POINT))]
    assert locate(pair) is None


def test_clicks_on_two_spots_are_refused():
    pair = [seen(camera("a", 0.0), POINT), seen(camera("b", 1.6), POINT, shift=(0.0, 20.0))]
    with pytest.raises(DataError, match="on no one spot"):
        locate([without_depth(one) for one in pair])


def test_readings_beside_the_object_are_not_its_depth():
    of = camera("a", 0.0)
    pixel, z = of.project(POINT[None])
    column, row = np.round(pixel[0]).astype(int)
    depth = np.full((of.height, of.width), round(1000 * z[0] + 100), np.uint16)
    mask = np.zeros_like(depth, bool)
    mask[row - 6 : row + 7, column - 9 : column + 2] = True
    depth[mask] = round(1000 * z[0])
    beside = (float(column + 2), float(row))
    assert np.linalg.norm(locate([Seen(of, beside, depth, mask)]).point - POINT) < 0.006
    assert locate([Seen(of, (float(column + 9), float(row)), depth, mask)]) is None


def block(count: int = 60) -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.1, -0.06, 0], [0.1, 0.06, 0.03], (count, 3))


def test_a_spot_goes_with_a_rigid_thing_wherever_it_goes():
    rest, spot = block(), np.array([0.05, 0.01, 0.03])
    turn = Rotation.from_euler("zyx", [2.4, 0.3, -0.2]).as_matrix()
    shift = np.array([0.1, 0, 0])
    positions = np.stack([rest, rest + shift, rest @ turn.T + [0.2, -0.1, 0.05]])
    carried = carry(positions, 0, spot)
    assert np.abs(carried - [spot, spot + shift, spot @ turn.T + [0.2, -0.1, 0.05]]).max() < 0.002
    back = carry(positions, 2, spot @ turn.T + [0.2, -0.1, 0.05])
    assert np.linalg.norm(back[0] - spot) < 0.002


def test_a_spot_on_a_thin_thing_does_not_roll_off_it():
    line = np.column_stack([np.linspace(-0.2, 0.2, 40), np.zeros(40), np.full(40, 0.01)])
    turned = line @ Rotation.from_euler("z", 1.9).as_matrix().T
    carried = carry(np.stack([line, turned]), 0, np.array([0.05, 0.0, 0.02]))
    expected = np.array([0.05 * np.cos(1.9), 0.05 * np.sin(1.9), 0.02])
    assert np.linalg.norm(carried[1] - expected) < 0.001


def test_a_spot_beside_the_object_is_refused_by_name():
    spots = {"table": {0: Sighting(np.array([0.3, 0.3, 0.0]), 0.001), 1: Sighting(np.array([0.3, 0.3, 0.0]), 0.001)}}
    with pytest.raises(DataError, match=r"spot table is .* cm from the nearest particle"):
        distances(np.stack([block()] * 2), spots)


def test_distances_are_those_of_what_tracking_got_wrong():
    positions = np.stack([block()] * 3)
    positions[2] += [0.012, 0, 0]  # tracking says it moved, the spots stay
    at = np.array([0.02, 0.0, 0.03])
    spots = {
        "a": {0: Sighting(at, 0.003), 1: Sighting(at, 0.004), 2: Sighting(at, 0.004)},
        "b": {1: Sighting(at, 0.003)},
    }
    found = distances(positions, spots)
    assert [(one.spot, one.first, one.frame) for one in found] == [("a", 0, 1), ("a", 0, 2)]
    assert [one.metres for one in found] == pytest.approx([0.0, 0.012], abs=1e-6)
    assert found[0].deviation == pytest.approx(0.005)
    told = told_spots(found, 1)
    assert "median 6.0 mm off, worst 12.0 mm (spot a, frame 2), clicks good to 5.0 mm" in told
    assert "2 distances of 1 spot in 3 frames, 1 camera" in told
    assert [name for name, _ in spot_scores(found)] == [SPOTS, SPOTS, SPOTS_SURE, SPOTS_SURE]
    assert "none in two frames" in told_spots([], 1)
