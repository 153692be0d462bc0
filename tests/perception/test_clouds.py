"""Back-projection, fusion and contact, on ray-cast depth of a known box and on made-up paths."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piegraph_cli.errors import UsageError
from piegraph_cli.perception.clouds import (
    DEVIATIONS,
    NEIGHBOURS,
    back_project,
    contact,
    flying_pixels,
    fuse,
    voxel_means,
    without_outliers,
    world_map,
)
from tests.perception.scene import WORKSPACE, render, ring_camera

CAMERAS = [ring_camera(azimuth, f"c{n}") for n, azimuth in enumerate((0.4, 2.0, 3.5, 5.1))]
POSE = ((0.02, -0.01), 0.4)


@pytest.fixture(scope="module")
def views():
    return [render(camera, *POSE, None, seed=n) for n, camera in enumerate(CAMERAS)]


def to_surface(points: np.ndarray) -> np.ndarray:
    """Distance (m) of world points [P, 3] to the faces of the T that stand on the table."""
    (x, y), yaw = POSE
    c, s = np.cos(yaw), np.sin(yaw)
    local = (points - [x, y, 0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    distances = []
    for centre, half in (((0, 0.05), (0.1, 0.025)), ((0, -0.03), (0.025, 0.055))):
        q = np.abs(local - [*centre, 0.015]) - [*half, 0.015]
        distances.append(np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0))
    return np.abs(np.min(distances, axis=0))


@settings(max_examples=20, deadline=None)
@given(st.integers(300, 1500), st.integers(0, 211), st.integers(0, 158), st.floats(0, 6.28))
def test_the_world_map_agrees_with_the_camera(reading, column, row, azimuth):
    camera = ring_camera(azimuth)
    depth = np.zeros((159, 212), np.uint16)
    depth[row, column] = reading
    points = world_map(depth, camera)
    assert np.isfinite(points).all(axis=-1).sum() == 1
    expected = camera.unproject(np.array([[column, row]]), np.array([reading * 0.001]))[0]
    np.testing.assert_allclose(points[row, column], expected, atol=1e-5)
    np.testing.assert_allclose(camera.project(points[row, column][None].astype(float))[0][0], [column, row], atol=0.01)


def test_back_projected_pixels_lie_on_the_surface(views):
    points = back_project(views[0].object, views[0].depth, CAMERAS[0])
    assert len(points) > 0.5 * views[0].object.sum()
    assert np.median(to_surface(points)) < 0.002


def test_nothing_to_back_project(views):
    assert back_project(np.zeros((159, 212), bool), views[0].depth, CAMERAS[0]).shape == (0, 3)
    assert back_project(views[0].object, np.zeros((159, 212), np.uint16), CAMERAS[0]).shape == (0, 3)


def test_pixels_beside_a_step_are_flying_and_holes_are_no_step():
    depth = np.full((20, 20), 500, np.uint16)
    depth[:, 10:] = 600
    depth[5, 3] = 0
    flying = flying_pixels(depth, CAMERAS[0], 0.012)
    assert flying[:, 9:11].all()
    assert not flying[:, :9].any()
    assert not flying[:, 11:].any()


def test_pixels_beside_a_step_are_not_back_projected():
    camera = ring_camera(0.4)
    depth = np.full((159, 212), 500, np.uint16)
    depth[:, 100:] = 600
    assert len(back_project(np.ones((159, 212), bool), depth, camera)) == 159 * 210


def test_the_fused_cloud_lies_on_the_surface_and_covers_it(views):
    cloud = fuse([v.object for v in views], [v.depth for v in views], CAMERAS, WORKSPACE)
    assert cloud.dtype == np.float32
    assert np.median(to_surface(cloud)) < 0.002
    assert cloud[:, 2].max() > 0.028
    centre = cloud[:, :2].mean(axis=0) - POSE[0]
    assert np.linalg.norm(centre) < 0.03


def test_the_voxel_size_thins_the_cloud(views):
    fine, coarse = (
        fuse([v.object for v in views], [v.depth for v in views], CAMERAS, WORKSPACE, voxel_size=size)
        for size in (0.004, 0.016)
    )
    assert 5 * len(coarse) < len(fine)


def test_thinning_and_outliers_are_those_of_open3d(views):
    import open3d as o3d

    points = np.concatenate([back_project(v.object, v.depth, k) for v, k in zip(views, CAMERAS, strict=True)])
    points = np.concatenate([points, np.random.default_rng(0).uniform(-0.2, 0.2, (40, 3))]).astype(np.float64)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(0.004)
    thinned = voxel_means(points, 0.004)
    np.testing.assert_allclose(in_order(thinned), in_order(np.asarray(cloud.points)), atol=1e-9)
    cloud = cloud.remove_statistical_outlier(NEIGHBOURS, DEVIATIONS)[0]
    kept = without_outliers(thinned)
    assert len(kept) < len(thinned)
    np.testing.assert_allclose(in_order(kept), in_order(np.asarray(cloud.points)), atol=1e-9)


def in_order(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(points.round(7).T)]


def test_voxels_too_small_to_be_counted_are_refused(views):
    with pytest.raises(UsageError, match="voxels of 1e-09 m"):
        fuse([v.object for v in views], [v.depth for v in views], CAMERAS, WORKSPACE, voxel_size=1e-9)


def test_stray_points_are_removed(views):
    masks = [v.object.copy() for v in views]
    masks[0][140:143, 100:103] = True
    depths = [v.depth for v in views]
    stray = back_project(masks[0] & ~views[0].object, depths[0], CAMERAS[0])
    assert len(stray) > 0
    cloud = fuse(masks, depths, CAMERAS, WORKSPACE)
    assert np.linalg.norm(cloud[:, None] - stray[None], axis=-1).min() > 0.02


def test_the_workspace_crops(views):
    half = WORKSPACE.copy()
    half[0, 1] = 0.0
    cloud = fuse([v.object for v in views], [v.depth for v in views], CAMERAS, half)
    assert len(cloud) > 100
    assert cloud[:, 0].max() <= 0.001


def test_an_empty_cloud():
    nothing = [np.zeros((159, 212), bool)] * 4
    cloud = fuse(nothing, [np.full((159, 212), 700, np.uint16)] * 4, CAMERAS, WORKSPACE)
    assert cloud.shape == (0, 3)
    assert cloud.dtype == np.float32


BLOCK = np.stack(np.meshgrid(np.linspace(-0.1, 0, 21), np.linspace(-0.05, 0.05, 21), [0.03]), axis=-1).reshape(-1, 3)


def path(*xz: tuple[float, float]) -> np.ndarray:
    return np.array([[x, 0.0, z] for x, z in xz])


def test_contact_starts_at_rest_and_ends_with_the_lift():
    tip = path((0.2, 0.1), (0.05, 0.02), (0.018, 0.02), (0.012, 0.02), (0.01, 0.02), (0.01, 0.1), (0.1, 0.1))
    assert contact(tip, [BLOCK] * 7).tolist() == [False, True, True, True, True, False, False]


def test_a_hand_above_or_beside_the_object_does_not_touch():
    assert not contact(path((-0.05, 0.1), (-0.05, 0.09), (-0.05, 0.08)), [BLOCK] * 3).any()
    assert not contact(path((0.05, 0.02), (0.045, 0.02), (0.05, 0.02)), [BLOCK] * 3).any()


def test_an_unknown_frame_does_not_interrupt_and_a_single_frame_does_not_count():
    tip = path((0.015, 0.02), (0.01, 0.02), (0.01, 0.02), (0.01, 0.02))
    tip[1] = np.nan
    assert contact(tip, [BLOCK] * 4).all()
    assert contact(
        path(
            (0.01, 0.02),
        ).repeat(3, axis=0),
        [BLOCK, np.zeros((0, 3)), BLOCK],
    ).all()
    assert contact(path((0.01, 0.1), (0.01, 0.02), (0.01, 0.1)), [BLOCK] * 3).tolist() == [False] * 3


def test_a_lift_between_two_strokes_parts_them():
    tip = path((0.01, 0.02), (0.01, 0.02), (0.01, 0.1), (0.01, 0.02), (0.01, 0.02))
    assert contact(tip, [BLOCK] * 5).tolist() == [True, True, False, True, True]


def test_contact_without_any_hand_or_frame():
    assert not contact(np.full((3, 3), np.nan), [BLOCK] * 3).any()
    assert contact(np.zeros((0, 3)), []).shape == (0,)
    assert contact(path((0.01, 0.02)), [BLOCK]).tolist() == [False]


def test_one_wrong_height_is_no_lift_but_two_frames_are():
    low, high = (0.01, 0.02), (0.01, 0.06)
    assert contact(path(low, low, high, low, low), [BLOCK] * 5).all()
    found = contact(path(low, low, high, high, low, low), [BLOCK] * 6)
    assert found.tolist() == [True, True, False, False, True, True]
