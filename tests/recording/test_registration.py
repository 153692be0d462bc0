"""Depth of another camera: a sloping plane with a block before it, seen where the colour camera would see it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.recording.camera import Camera, DepthView, straight_rays
from piegraph_cli.recording.registration import register_depth

BENT = np.array([0.05, -0.03, 0.001, -0.001, 0.01])
NORMAL, BEHIND, BEFORE = np.array([0.1, -0.15, -1.0]), 0.9, 0.6


def pair(turn=(0.0, 0.0, 0.0), shift=(0.03, 0.002, -0.004), scale: float = 0.5) -> Camera:
    """A colour camera whose depth was seen from beside it, at `scale` times its resolution."""
    K = np.array([[200.0, 0, 105], [0, 202, 78], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    depth_K = K * [[scale], [scale], [1]]
    view = DepthView(round(212 * scale), round(160 * scale), depth_K, BENT, T)
    return Camera("c", 212, 160, K, -BENT, np.eye(4), 0.001, view)


def distances(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """How far along rays [N, 3] from `origin`, in the colour camera's frame, the block or the plane is."""
    plane = ((NORMAL * [0, 0, BEHIND]).sum() - NORMAL @ origin) / (rays @ NORMAL)
    block = (BEFORE - origin[2]) / rays[:, 2]
    hit = origin + rays * block[:, None]
    return np.where((np.abs(hit[:, 0]) < 0.08) & (np.abs(hit[:, 1]) < 0.05), block, plane)


def seen(width: int, height: int, K, distortion, T) -> np.ndarray:
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)
    rays = straight_rays(pixels, K, distortion) @ T[:3, :3].T
    return (distances(T[:3, 3], rays) * 1000).reshape(height, width)


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.7])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.02, -0.03, 0.01)])
def test_depth_lands_where_colour_sees_it(scale, turn):
    camera = pair(turn, scale=scale)
    view = camera.depth_view
    depth = seen(view.width, view.height, view.K, view.distortion, view.T_color_depth).round().astype(np.uint16)
    found = register_depth(depth, camera).astype(float)
    true = seen(camera.width, camera.height, camera.K, camera.distortion, np.eye(4))
    middle = (slice(20, 140), slice(40, 180))
    known = found[middle] > 0
    assert known.mean() > 0.93, "but for the block's shadow"
    assert (np.abs(found - true)[middle][known] < 6).mean() > 0.97
    assert np.abs(found - true)[middle][known].mean() < 3.0 + 3.0 / scale


def test_nothing_read_gives_nothing():
    camera = pair()
    assert not register_depth(np.zeros((80, 106), np.uint16), camera).any()


def test_the_nearest_of_what_meets_in_a_pixel_counts():
    camera = pair(shift=(0, 0, 0), scale=1.0)
    camera = Camera("c", 212, 160, camera.K, np.zeros(5), np.eye(4), 0.001, camera.depth_view)
    depth = np.full((160, 212), 900, np.uint16)
    depth[::2] = 500
    found = register_depth(depth, camera)
    assert (found[30:130, 40:170] == 500).mean() > 0.45
