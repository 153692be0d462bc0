"""Point clouds: back-projection of depth, fusion of the cameras, and when the hand touches the object."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from piegraph_cli.errors import UsageError
from piegraph_cli.perception.windows import WHOLE, Window, window_around
from piegraph_cli.recording.camera import Camera, straight_rays

NEIGHBOURS, DEVIATIONS = 16, 2.0
"""Outlier removal: a point farther from its neighbours than the cloud's mean plus this many deviations is dropped."""

OPENS, OPENS_SHARE = 0.005, 0.1
"""Change of a gripper's opening (m; or as a share of the largest) below which it neither opens nor closes."""

BAND = 12
"""Rows of an image whose rays are worked out together."""
STRAIGHT = 1e-8
"""Error of a ray that float32 does not show."""
SPIKE = 3
"""Clearances that one frame alone may lie high without being a lift."""


def world_map(depth: np.ndarray, camera: Camera, window: Window = WHOLE) -> np.ndarray:
    """World points [H, W, 3] float32 (m) of a depth image [H, W] in the camera's units; NaN where it reads 0.

    `window` says which part of the camera's image `depth` is.
    """
    metres = np.where(depth > 0, depth * np.float32(camera.depth_scale), np.float32(np.nan)).astype(np.float32)
    points = world_rays(camera)[(slice(None), *window)] * metres
    points += camera.T_world_camera[:3, 3].astype(np.float32)[:, None, None]
    return np.moveaxis(points, 0, -1)


def kept_per_camera(make: Callable[[Camera], np.ndarray]) -> Callable[[Camera], np.ndarray]:
    """A function of a camera that is worked out once for each of the last cameras asked for."""

    @lru_cache(maxsize=16)
    def kept(width: int, height: int, *numbers: bytes) -> np.ndarray:
        K, distortion, pose = (np.frombuffer(number) for number in numbers)
        return make(Camera("", width, height, K.reshape(3, 3), distortion, pose.reshape(4, 4)))

    def of_camera(camera: Camera) -> np.ndarray:
        numbers = (camera.K, camera.distortion, camera.T_world_camera)
        return kept(camera.width, camera.height, *(np.asarray(a, np.float64).tobytes() for a in numbers))

    return of_camera


@kept_per_camera
def world_rays(camera: Camera) -> np.ndarray:
    """Viewing rays [3, H, W] float32 of all pixels in world directions, of length one along the optical axis."""
    rays = np.empty((3, camera.height, camera.width), np.float32)
    for top in range(0, camera.height, BAND):  # few rows at a time stay in the processor's cache
        rows = np.arange(top, min(top + BAND, camera.height))
        pixels = np.stack(np.meshgrid(np.arange(camera.width), rows), axis=-1).reshape(-1, 2).astype(np.float64)
        straight = straight_rays(pixels, camera.K, camera.distortion, STRAIGHT)
        rays[:, rows] = (camera.T_world_camera[:3, :3] @ straight.T).reshape(3, len(rows), -1)
    return rays


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
    window = window_around(mask, 1)
    mask, depth = mask[window], depth[window]
    keep = mask & (depth > 0) & ~flying_pixels(depth, camera, edge)
    return world_map(depth, camera, window)[keep]


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
    parts = [back_project(m, d, camera) for m, d, camera in zip(masks, depths, cameras, strict=True)]
    points = np.concatenate(parts).astype(np.float64)
    low, high = np.asarray(workspace, float).T
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(points) == 0:
        return np.zeros((0, 3), np.float32)
    return without_outliers(voxel_means(points, voxel_size)).astype(np.float32)


def voxel_means(points: np.ndarray, size: float) -> np.ndarray:
    """The mean [V, 3] of the points [P, 3] (m; P > 0) in each cell of a grid of `size` (m), cells in order."""
    cells = np.floor((points - points.min(axis=0)) / size + 0.5).astype(np.int64)
    x, y, z = (int(count) for count in cells.max(axis=0) + 1)
    if x * y * z >= 2**63:
        raise UsageError(f"voxels of {size:g} m are too small for this cloud", "fuse.voxel_size", "0.004 is usual")
    _, voxel, count = np.unique(
        (cells[:, 0] * y + cells[:, 1]) * z + cells[:, 2], return_inverse=True, return_counts=True
    )
    return np.stack([np.bincount(voxel, along) for along in points.T], axis=1) / count[:, None]


def without_outliers(points: np.ndarray) -> np.ndarray:
    """The points [P, 3] (m) whose mean distance to their neighbours is usual."""
    from scipy.spatial import cKDTree

    if len(points) <= NEIGHBOURS:
        return points
    distance = cKDTree(points).query(points, NEIGHBOURS)[0].mean(axis=1)
    return points[distance < distance.mean() + DEVIATIONS * distance.std(ddof=1)]


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

    shut = _shut(opening, closed)
    if shut is None:
        return touching
    runs, count = label(shut)
    holds = np.zeros_like(touching)
    for n in range(1, count + 1):
        touched = np.flatnonzero(touching & (runs == n))
        if len(touched):
            holds[touched[0] : touched[-1] + 1] = True
    return holds


def grasped(holds: np.ndarray, opening: np.ndarray, closed: float | None = None) -> np.ndarray:
    """Frames [F] bool of `while_closed` in which the gripper closed on the object.

    One that was closed before it touched pushes.
    """
    from scipy.ndimage import label

    shut = _shut(opening, closed)
    if shut is None:
        return np.zeros_like(holds)
    runs, count = label(holds)
    firsts = np.array([np.flatnonzero(runs == n)[0] for n in range(1, count + 1)], int)
    grasps = [n for n, first in enumerate(firsts, 1) if first == 0 or not shut[first - 1]]
    return np.isin(runs, grasps) & holds


def _shut(opening: np.ndarray, closed: float | None) -> np.ndarray | None:
    """Frames [F] bool in which a gripper is closed, as `while_closed` says; None where that is not known."""
    known = np.flatnonzero(np.isfinite(opening))
    if len(known) == 0:
        return None
    filled = opening[known[(np.searchsorted(known, np.arange(len(opening)), "right") - 1).clip(0)]]
    if closed is None and not opens(filled):
        return None
    return filled <= ((filled.min() + filled.max()) / 2 if closed is None else closed)


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
