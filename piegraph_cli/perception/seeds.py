"""Finding the object: what stands above the table or differs from it in colour, is no hand, and several cameras see."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.clouds import flying_pixels, world_map
from piegraph_cli.perception.hand_region import hand_region
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.recording.camera import Camera

CELL = 0.005
"""Cell size (m) of the table grid on which the cameras vote."""
CLEAR = 0.05
"""Distance (m) between hand and object from which the object counts as clear of the hand."""
MAX_TRIED = 24
"""Frames looked at before the best so far is taken."""
EDGE = 0.012
"""Depth steps (m) above this one are edges."""


@dataclass(frozen=True)
class ObjectSeed:
    """Where the object is in one frame, agreed on by the cameras."""

    frame: int
    masks: Sequence[np.ndarray]
    """[H, W] bool of each camera; one that does not see the object there has an empty mask."""


def find_object(
    images: Sequence[Sequence[np.ndarray]],
    depths: Sequence[Sequence[np.ndarray]],
    cameras: Sequence[Camera],
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
) -> ObjectSeed:
    """Find the object in the first frame in which it is clear of the hand, else in the one where it is clearest.

    `images[camera][frame]` RGB uint8 [H, W, 3], `depths[camera][frame]` [H, W] in units of the camera's depth scale
    (0 = no reading), both read lazily; `hand_px` [F, C, 21, 2] (NaN where no hand is); `workspace` [3, 2] bounds (m).
    Of several objects the largest away from the workspace's edge is taken. Cameras may differ in image size.
    Raises DataError when nothing in the workspace stands out from the table in any frame tried.
    """
    frames = np.unique(np.linspace(0, len(hand_px) - 1, min(len(hand_px), MAX_TRIED)).astype(int))
    best, best_clearance = None, -1.0
    for f in frames:
        views = [
            _candidates(images[c][f], depths[c][f], camera, hand_px[f, c], workspace, params)
            for c, camera in enumerate(cameras)
        ]
        masks, clearance = _vote(views, workspace, params)
        if masks is not None and clearance > best_clearance:
            best, best_clearance = ObjectSeed(int(f), masks), clearance
        if best_clearance >= CLEAR:
            break
    if best is None:
        names = ", ".join(camera.name for camera in cameras)
        raise DataError(
            f"no object found: nothing inside the workspace stands out from the table in {len(frames)} frames tried",
            f"cameras {names}",
            "check --workspace and the table plane (z = 0), or lower --min-height or --min-contrast",
        )
    return best


def table_points(camera: Camera, shape: tuple[int, int]) -> np.ndarray:
    """Where each pixel's ray meets the table plane, [H, W, 3] float32 (m); NaN where it does not."""
    one = np.full(shape, 1 / camera.depth_scale, np.float32)
    centre = camera.T_world_camera[:3, 3].astype(np.float32)
    rays = world_map(one, camera) - centre
    distance = np.where(rays[..., 2] < -1e-3, -centre[2] / rays[..., 2], np.nan)
    return centre + rays * distance[..., None]


def locate(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """The world point [H, W, 3] (m) of each pixel: by depth where it is reliable, else on the table plane."""
    import cv2

    smooth = cv2.medianBlur(depth, 5)
    points = world_map(smooth, camera)
    unsure = (smooth == 0) | flying_pixels(smooth, camera, EDGE)
    points[unsure] = table_points(camera, depth.shape)[unsure]
    return points


def inside(points: np.ndarray, workspace: np.ndarray) -> np.ndarray:
    """Which points [..., 3] lie over the workspace and not above it; a little below the table is noise and inside."""
    (x0, x1), (y0, y1), (_, z1) = np.asarray(workspace, float)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1) & (z <= z1)


@dataclass(frozen=True)
class _View:
    """One camera's evidence in one frame: masks [H, W] of object candidates and of the hand, world points [H, W, 3]."""

    candidates: np.ndarray
    hand: np.ndarray
    points: np.ndarray


def _candidates(
    image: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
) -> _View:
    points = locate(depth, camera)
    within = inside(points, workspace)
    hand = hand_region(hand_px, depth, camera, growth=1.4)
    tall = points[..., 2] > params.min_height
    table = within & ~hand & ~tall
    stands_out = tall | (_contrast(image, table) > params.min_contrast)
    return _View(_opened(stands_out & within & ~hand), hand & inside(points, _unbounded_above(workspace)), points)


def _unbounded_above(workspace: np.ndarray) -> np.ndarray:
    bounds = np.array(workspace, float)
    bounds[2, 1] = np.inf
    return bounds


def _contrast(image: np.ndarray, table: np.ndarray) -> np.ndarray:
    """How far each pixel's colour [H, W] is from the table's usual one; shadows, which keep the hue, count little."""
    import cv2

    if not table.any():
        return np.zeros(table.shape, np.float32)
    red, green, blue = np.moveaxis(np.log(cv2.GaussianBlur(image, (5, 5), 0).astype(np.float32) + 12), -1, 0)
    hue = np.stack([red - green, blue - green], axis=-1)
    light = green - np.median(green[table])
    hue = np.linalg.norm(hue - np.median(hue[table], axis=0), axis=-1)
    brighter, darker = np.maximum(light - 0.2, 0), np.maximum(-light - 0.8, 0)
    return hue + brighter + darker


def _opened(mask: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(bool)


def _vote(
    views: Sequence[_View], workspace: np.ndarray, params: SegmentParams
) -> tuple[list[np.ndarray] | None, float]:
    """Masks [H, W], one a view, of the object the views agree on (None: there is none) and its distance (m) from the hand."""
    from scipy.ndimage import binary_closing, distance_transform_edt, label

    low, high = np.asarray(workspace, float)[:2].T
    shape = tuple(np.ceil((high - low) / CELL).astype(int) + 1)
    votes = sum(_cells(v.points[v.candidates], low, shape).astype(int) for v in views)
    solid = binary_closing(votes >= min(2, len(views)), np.ones((5, 5)))
    parts, count = label(solid, np.ones((3, 3)))
    area = np.bincount(parts.ravel(), minlength=count + 1) * CELL**2
    area[0] = 0
    inner = np.zeros(shape, bool)
    inner[2:-3, 2:-3] = True
    at_edge = np.unique(parts[~inner])
    score = area.copy()
    score[at_edge] *= 0.1
    chosen = int(np.argmax(score))
    if area[chosen] < params.min_area:
        return None, 0.0
    away = distance_transform_edt(parts != chosen) * CELL
    hand = np.logical_or.reduce([_cells(v.points[v.hand], low, shape) for v in views])
    clearance = float(away[hand].min()) if hand.any() else np.inf
    masks = [v.candidates & _at(away <= 2 * CELL, v.points, low) for v in views]
    return masks, clearance


def _cells(points: np.ndarray, low: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    grid = np.zeros(shape, bool)
    ij = np.floor((points[:, :2] - low) / CELL).astype(int)
    ij = ij[((ij >= 0) & (ij < shape)).all(axis=1)]
    grid[ij[:, 0], ij[:, 1]] = True
    return grid


def _at(grid: np.ndarray, points: np.ndarray, low: np.ndarray) -> np.ndarray:
    """The grid's value under each of the points [H, W, 3]; False outside the grid."""
    ij = np.floor(np.nan_to_num((points[..., :2] - low) / CELL, nan=-1)).clip(-1, 10**6).astype(int)
    valid = ((ij >= 0) & (ij < grid.shape)).all(axis=-1)
    values = np.zeros(valid.shape, bool)
    values[valid] = grid[ij[valid][:, 0], ij[valid][:, 1]]
    return values
