"""The camera model: projection and its inverse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, check_lens

K = np.array([[390.0, 0, 210.3], [0, 385.0, 161.7], [0, 0, 1]])


def camera(distortion=(0.0,) * 5, rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    pose[:3, 3] = translation
    return Camera("front", 424, 318, K, np.array(distortion), pose)


small = st.floats(-0.05, 0.05)
vector = st.tuples(*[st.floats(-2, 2)] * 3)


@settings(max_examples=50, deadline=None)
@given(
    st.tuples(small, small, st.floats(-0.002, 0.002), st.floats(-0.002, 0.002), small),
    vector,
    vector,
    st.lists(st.tuples(st.floats(0, 423), st.floats(0, 317), st.floats(0.2, 3)), min_size=1, max_size=10),
)
def test_unprojected_pixels_project_back(distortion, rotation, translation, samples):
    view = camera(distortion, rotation, translation)
    pixels, depth = np.array(samples)[:, :2], np.array(samples)[:, 2]
    back, distance = view.project(view.unproject(pixels, depth))
    np.testing.assert_allclose(back, pixels, atol=1e-4)
    np.testing.assert_allclose(distance, depth, atol=1e-9)


KINECT = (0.51, -2.72, 0.0006, -0.0002, 1.57, 0.39, -2.53, 1.49)
"""Of a wide camera, as its maker gives them."""


@pytest.mark.parametrize(
    "distortion",
    [KINECT, (*KINECT, 0.002, -0.001, 0.001, 0.0005), (*KINECT, 0.002, -0.001, 0.001, 0.0005, 0.02, -0.03)],
    ids=["8", "12", "14"],
)
def test_as_many_coefficients_as_opencv_takes(distortion):
    view = camera(distortion, (0.3, -0.2, 0.1), (0.1, 0.2, 0.3))
    pixels = np.stack(np.meshgrid(np.arange(0, 424, 53), np.arange(0, 318, 53)), -1).reshape(-1, 2).astype(float)
    back, _ = view.project(view.unproject(pixels, np.full(len(pixels), 0.8)))
    np.testing.assert_allclose(back, pixels, atol=1e-4)


def test_pinhole_by_hand():
    pixels, depth = camera().project(np.array([[0.1, -0.2, 2.0]]))
    np.testing.assert_allclose(pixels, [[390 * 0.05 + 210.3, 385 * -0.1 + 161.7]])
    np.testing.assert_allclose(depth, [2.0])


def test_pose_maps_camera_to_world():
    view = camera(rotation=(0, 0, np.pi / 2), translation=(1, 2, 3))
    point = view.unproject(np.array([[K[0, 2] + 39.0, K[1, 2]]]), np.array([1.0]))
    np.testing.assert_allclose(point, [[1.0, 2.1, 4.0]], atol=1e-9)


def test_barrel_distortion_pulls_pixels_inwards():
    point = np.array([[0.4, 0.0, 1.0]])
    straight, bent = camera().project(point)[0], camera((-0.1, 0, 0, 0, 0)).project(point)[0]
    assert bent[0, 0] < straight[0, 0] - 1


def test_points_behind_the_camera_have_negative_depth():
    assert camera().project(np.array([[0.0, 0.0, -1.0]]))[1][0] == -1


def test_no_points():
    assert camera().project(np.zeros((0, 3)))[0].shape == (0, 2)
    assert camera().unproject(np.zeros((0, 2)), np.zeros(0)).shape == (0, 3)


LENSES = {
    "Kinect of 2020, colour": ([0.5, -2.6, 0.0003, -0.0004, 1.5, 0.38, -2.4, 1.46], 610, (1280, 720)),
    "Kinect of 2010": ([0.2624, -0.9531, -0.0054, 0.0026, 1.1633], 517, (640, 480)),
    "wide, its corners fold": ([-0.25, 0.07, 0, 0, -0.008], 870, (1920, 1080)),
    "no lens": ([0, 0, 0, 0, 0], 300, (424, 318)),
}


@pytest.mark.parametrize("lens", LENSES)
def test_lenses_as_they_are_sold_can_be_undone(lens):
    distortion, focal, (width, height) = LENSES[lens]
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], float)
    check_lens(matrix, np.array(distortion, float), (width, height), "distortion", "cameras.json")


@pytest.mark.parametrize("distortion", [[0.5, -2.6, 1.5, 0.38, -2.4, 1.46, 0.0003, -0.0004], [50, -2000, 0, 0, 0]])
def test_coefficients_in_another_order_fold_the_image_and_are_refused(distortion):
    matrix = np.array([[610.0, 0, 640], [0, 610, 360], [0, 0, 1]])
    with pytest.raises(DataError, match="distortion cannot be undone: around pixel 320, 180"):
        check_lens(matrix, np.array(distortion, float), (1280, 720), "distortion", "cameras.json, camera left")
