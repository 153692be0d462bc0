"""Point clouds: back-projection of depth, fusion of the cameras, and when the hand touches the object."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from piegraph_cli.recording.camera import Camera

NEIGHBOURS, DEVIATIONS = 16, 2.0
"""Outlier removal: a point farther from its neighbours than the cloud's mean plus this many deviations is dropped."""

OPENS, OPENS_SHARE = 0.005, 0.1
"""Change of a gripper's opening (m; or as a share of the largest) below which it neither opens nor closes."""

SPIKE = 3
"""Clearances that one frame alone may lie high without being a lift."""


def world_map(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """World points [H, W, 3] float32 (m) of a depth image [H, W] in the camera's units; NaN where it reads 0."""
    metres = np.where(depth > 0, depth * np.float32(camera.depth_scale), np.float32(np.nan)).astype(np.float32)
    numbers = (np.asarray(a, np.float64).tobytes() for a in (camera.K, camera.distortion, camera.T_world_camera))
    rays = _world_rays(camera.width, camera.height, *numbers)
    return rays * metres[..., None] + camera.T_world_camera[:3, 3].astype(np.float32)


@lru_cache(maxsize=16)
def _world_rays(width: int, height: int, K: bytes, distortion: bytes, T_world_camera: bytes) -> np.ndarray:
    """Viewing rays [H, W, 3] in world directions, of length one along the optical axis."""
    intrinsics, pose = np.frombuffer(K).reshape(3, 3), np.frombuffer(T_world_camera).reshape(4, 4)
    camera = Camera("", width, height, intrinsics, np.frombuffer(distortion), pose)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    rays = camera.rays(pixels) @ camera.T_world_camera[:3, :3].T
    return rays.reshape(height, width, 3).astype(np.float32)


def flying_pixels(depth: np.ndarray, camera: Camera, edge: float) -> np.ndarray:
    """Pixels [H, W] bool beside a depth step larger than `edge` (m): their reading may hang between two surfaces."""
    import cv2

    metres = depth.astype(np.float32) * np.float32(camera.depth_scale)
    kernel = np.ones((3, 3), np.uint8)
    farthest = cv2.dilate(metres, kernel)
    nearest = cv2.erode(np.where(depth > 0, metres, np.float32(np.inf)), kernel)
    return farthest - nearest > edge


def back_project(mask: np.ndarray, depth: np.ndarray, camera: Camera, edge: float = 0.012) -> np.ndarray:
    """World points [P, 3] float32 (m) of the masked pixels [H, W] that have depth (units of the camera's depth scale).

    Pixels beside a depth step larger than `edge` (m) are left out: they may hang between two surfaces.
    """
    keep = mask & (depth > 0) & ~flying_pixels(depth, camera, edge)
    return world_map(depth, camera)[keep]


def fuse(
    masks: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    workspace: np.ndarray,
    voxel_size: float = 0.004,
) -> np.ndarray:
    """One cloud [P, 3] float32 (m) of one frame from all cameras' masks [H, W] and depths [H, W].

    Cropped to `workspace` [3, 2] (m), thinned to a voxel grid of `voxel_size` (m), outliers removed. May be empty.
    """
    import open3d as o3d

    parts = [back_project(m, d, camera) for m, d, camera in zip(masks, depths, cameras, strict=True)]
    points = np.concatenate(parts)
    low, high = np.asarray(workspace, float).T
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(points) == 0:
        return np.zeros((0, 3), np.float32)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud = cloud.voxel_down_sample(voxel_size)
    if len(cloud.points) > NEIGHBOURS:
        cloud, _ = cloud.remove_statistical_outlier(NEIGHBOURS, DEVIATIONS)
    return np.asarray(cloud.points, dtype=np.float32)


def contact(
    end_effector: np.ndarray, clouds: Sequence[np.ndarray], radius: float = 0.03, clearance: float = 0.015
) -> np.ndarray:
    """Frames [F] bool in which the hand handles the object, from its end-effector [F, 3] (m) and the clouds [P, 3].

    Handling begins and ends with frames within twice `radius` (m) of the cloud seen from above and lower than its top
    plus `clearance` (m), so that it holds the object at rest before it moves; it needs one frame within `radius`.
    A height that leaps up to three times the clearance in one frame alone is an error of measurement, not a lift.
    A frame with unknown end-effector (NaN) or empty cloud does not interrupt it; a single frame alone does not count.
    """
    from scipy.ndimage import label

    gap, above = _distances(end_effector, clouds)
    low = (above <= clearance) | ((_without_spikes(above) <= clearance) & (above <= SPIKE * clearance))
    unknown = ~np.isfinite(gap)
    close = low & (gap <= 2 * radius)
    between = np.zeros_like(close)
    between[1:-1] = unknown[1:-1] & close[:-2] & close[2:]
    runs, count = label(close | between)
    handled = np.zeros_like(close)
    for n in range(1, count + 1):
        run = runs == n
        if run.sum() > 1 and (gap[run & close] <= radius).any():
            handled |= run
    return handled


def opens(opening: np.ndarray) -> bool:
    """Whether a gripper opens or closes at all: `opening` [F] (m, or any unit)."""
    low, high = opening.min(), opening.max()
    return bool(high - low >= max(OPENS, OPENS_SHARE * max(abs(low), abs(high))))


def while_closed(touching: np.ndarray, opening: np.ndarray, closed: float | None = None) -> np.ndarray:
    """Frames [F] bool in which a gripper holds: of each time that it is closed, from the first touch to the last.

    `touching` [F] bool as `contact` finds it, `opening` [F] (m, NaN unknown: as at the frame before). `closed`: at and
    below this opening it is closed, by default halfway between the least and the largest; one that hardly opens is
    always closed, and then a touch is a touch.
    """
    from scipy.ndimage import label

    known = np.flatnonzero(np.isfinite(opening))
    if len(known) == 0:
        return touching
    filled = opening[known[(np.searchsorted(known, np.arange(len(opening)), "right") - 1).clip(0)]]
    low, high = filled.min(), filled.max()
    if closed is None and not opens(filled):
        return touching
    runs, count = label(filled <= ((low + high) / 2 if closed is None else closed))
    holds = np.zeros_like(touching)
    for n in range(1, count + 1):
        touched = np.flatnonzero(touching & (runs == n))
        if len(touched):
            holds[touched[0] : touched[-1] + 1] = True
    return holds


def _without_spikes(values: np.ndarray) -> np.ndarray:
    """The median of each value [F] and its neighbours; NaN stays NaN, the ends stay as they are."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    windows = np.stack([padded[:-2], values, padded[2:]])
    known = np.where(np.isfinite(windows), windows, values)
    return np.median(known, axis=0)


def _distances(end_effector: np.ndarray, clouds: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Per frame the distance (m) in the plane to the cloud and the height (m) above its top; NaN where unknown."""
    from scipy.spatial import cKDTree

    gap, above = np.full((2, len(end_effector)), np.nan)
    for f, (tip, cloud) in enumerate(zip(end_effector, clouds, strict=True)):
        if np.isfinite(tip).all() and len(cloud):
            gap[f] = cKDTree(cloud[:, :2]).query(tip[:2])[0]
            above[f] = tip[2] - np.percentile(cloud[:, 2], 95)
    return gap, above
