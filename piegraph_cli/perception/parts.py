"""What stands out from the table in one frame: the evidence of each camera, and the separate parts they agree on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.perception.hand_region import hand_region
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.places import inside, locate
from piegraph_cli.recording.camera import Camera

CELL = 0.005
"""Cell size (m) of the table grid on which the cameras vote."""
FEWEST_SHARED = 4
"""Cells that two views must both see of a thing."""
LOGARITHMS = np.log(np.arange(256, dtype=np.float32) + 12)
"""Of the values of a channel, the dark ones brought together."""
PATTERN = 3
"""Sides of the workspace from which what stands out is no thing but the table's pattern."""
AT_EDGE = 0.1
"""What the area of a part counts that reaches in from the workspace's edge."""


@dataclass(frozen=True)
class View:
    """One camera's evidence in one frame: masks [H, W] of object candidates and of the hand, world points [H, W, 3]."""

    candidates: np.ndarray
    tall: np.ndarray
    """[H, W] bool, those of the candidates that stand above the table."""
    hand: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class Part:
    """One connected part of what the cameras agree on in a frame."""

    masks: list[np.ndarray]
    """[H, W] bool of each camera; one that does not see it has an empty mask."""
    away: np.ndarray
    """[X, Y] distance (m) of each cell of the table grid from it."""
    area: float
    """Table covered (m2)."""
    score: float
    """The area, less where it reaches in from the workspace's edge."""
    clearance: float
    """Distance (m) from the hand, infinite where no hand is."""
    low: np.ndarray
    """[2] the grid's corner (m)."""
    pieces: tuple["Part", ...] = ()
    """What it falls into where narrower gaps count."""

    @property
    def at_edge(self) -> bool:
        """Whether it reaches the workspace's edge."""
        return _sides(self.away == 0) > 0

    @property
    def centre(self) -> np.ndarray:
        """Its middle [2] on the table (m)."""
        return np.argwhere(self.away == 0).mean(axis=0) * CELL + self.low + CELL / 2

    def distance(self, points: np.ndarray) -> np.ndarray:
        """How far (m) from it points [N, 2] of the table lie; infinite outside the grid or where they are NaN."""
        ij, valid = _grid_places(points, self.low, self.away.shape)
        far = np.full(len(points), np.inf)
        far[valid] = self.away[ij[valid][:, 0], ij[valid][:, 1]]
        return far


def view_of(
    image: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
) -> View:
    """What of one image stands above the table or differs from it in colour, and is no hand."""
    points = locate(depth, camera)
    within = inside(points, workspace)
    hand = hand_region(hand_px, depth, camera, growth=1.4)
    tall = points[..., 2] > params.min_height
    table = within & ~hand & ~tall
    stands_out = tall | (_contrast(image, table) > params.min_contrast)
    shown = _opened(stands_out & within & ~hand)
    return View(shown, shown & tall, hand & inside(points, _unbounded_above(workspace)), points)


def parts_of(views: Sequence[View], workspace: np.ndarray, params: SegmentParams) -> list[Part]:
    """The parts of at least `params.min_area` that the views agree on, the one of the highest score first.

    Where what stands out reaches most sides of the workspace, that is the table's pattern: height alone tells then.
    """
    from scipy.ndimage import distance_transform_edt, label

    low, high = np.asarray(workspace, float)[:2].T
    shape = tuple(np.ceil((high - low) / CELL).astype(int) + 1)
    votes = np.sum([cells(v.points[v.candidates], low, shape) for v in views], axis=0) >= min(2, len(views))
    if len(views) == 2:
        votes = _with_sides(votes, views, low)
    hand = np.logical_or.reduce([cells(v.points[v.hand], low, shape) for v in views])

    def part(grid: np.ndarray, pieces: tuple[Part, ...] = ()) -> Part:
        away = distance_transform_edt(~grid) * CELL
        area = float(grid.sum() * CELL**2)
        score = area * AT_EDGE if _sides(grid) else area
        clearance = float(away[hand].min()) if hand.any() else np.inf
        return Part(masks_near(views, away, low), away, area, score, clearance, low, pieces)

    grids = _large(label(_closed(votes, 5), np.ones((3, 3)))[0], params.min_area)
    if any(_sides(grid) >= PATTERN for grid in grids) and any((v.candidates & ~v.tall).any() for v in views):
        standing = parts_of([replace(v, candidates=v.tall) for v in views], workspace, params)
        if standing:
            return standing
    narrow, _ = label(_closed(votes, 3), np.ones((3, 3)))
    found = []
    for grid in grids:
        pieces = _large(np.where(grid, narrow, 0), params.min_area)
        found.append(part(grid, tuple(part(piece) for piece in pieces) if len(pieces) > 1 else ()))
    return sorted(found, key=lambda one: -one.score)


def _with_sides(votes: np.ndarray, views: Sequence[View], low: np.ndarray) -> np.ndarray:
    """The cells [X, Y] bool that both views vote for, and those connected to them of what stands there for one of them.

    Two views on opposite sides of a thing share but its top, and of a rope hardly that.
    """
    from scipy.ndimage import binary_closing, label

    loose = votes.copy()
    for view in views:
        loose |= cells(view.points[view.tall], low, votes.shape)
    regions, _ = label(binary_closing(loose, np.ones((3, 3))), np.ones((3, 3)))
    both = np.bincount(regions[votes], minlength=regions.max() + 1) >= FEWEST_SHARED
    both[0] = False
    return loose & both[regions]


def _closed(grid: np.ndarray, cells: int) -> np.ndarray:
    """A grid [X, Y] without gaps of fewer cells; up to its rim, which scipy takes for empty outside."""
    from scipy.ndimage import binary_closing

    return binary_closing(np.pad(grid, cells), np.ones((cells, cells)))[cells:-cells, cells:-cells]


def _sides(grid: np.ndarray) -> int:
    """How many sides of the workspace a region [X, Y] reaches."""
    return sum(bool(side.any()) for side in (grid[:2], grid[-3:], grid[:, :2], grid[:, -3:]))


def _large(labels: np.ndarray, min_area: float) -> list[np.ndarray]:
    """The labelled regions [X, Y] bool of at least `min_area` (m2)."""
    area = np.bincount(labels.ravel()) * CELL**2
    return [labels == n for n in range(1, len(area)) if area[n] >= min_area]


def masks_near(views: Sequence[View], away: np.ndarray, low: np.ndarray) -> list[np.ndarray]:
    """Each view's candidates [H, W] within two cells of where `away` [X, Y] (m) is zero."""
    masks = [v.candidates.copy() for v in views]
    for mask, v in zip(masks, views, strict=True):
        mask[mask] = _at(away <= 2 * CELL, v.points[mask], low)
    return masks


def boxed(part: Part, cameras: Sequence[Camera]) -> str:
    """A part's box in the camera that sees it best, as a setting: `cam0 = [x0, y0, x1, y1]`."""
    c = int(np.argmax([mask.sum() for mask in part.masks]))
    rows, columns = np.nonzero(part.masks[c])
    if len(rows) == 0:
        return ""
    return f"{cameras[c].name} = [{columns.min()}, {rows.min()}, {columns.max()}, {rows.max()}]"


def cells(points: np.ndarray, low: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The cells [X, Y] bool of a grid from `low` [2] (m) in which points [N, 2 or 3] (m) lie."""
    grid = np.zeros(shape, bool)
    ij, valid = _grid_places(points, low, shape)
    grid[ij[valid][:, 0], ij[valid][:, 1]] = True
    return grid


def _grid_places(points: np.ndarray, low: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    ij = np.floor(np.nan_to_num((points[..., :2] - low) / CELL, nan=-1)).clip(-1, 10**6).astype(int)
    return ij, ((ij >= 0) & (ij < shape)).all(axis=-1)


def _at(grid: np.ndarray, points: np.ndarray, low: np.ndarray) -> np.ndarray:
    """The grid's value [P] under each of the points [P, 3]; False outside the grid."""
    ij, valid = _grid_places(points, low, grid.shape)
    values = np.zeros(valid.shape, bool)
    values[valid] = grid[ij[valid][:, 0], ij[valid][:, 1]]
    return values


def _unbounded_above(workspace: np.ndarray) -> np.ndarray:
    bounds = np.array(workspace, float)
    bounds[2, 1] = np.inf
    return bounds


def _contrast(image: np.ndarray, table: np.ndarray) -> np.ndarray:
    """How far each pixel's colour [H, W] is from the table's usual one; shadows, which keep the hue, count little."""
    if not table.any():
        return np.zeros(table.shape, np.float32)
    hue, light = hue_and_light(image)
    light = light - np.median(light[table])
    red, blue = np.moveaxis(hue - np.median(hue[table], axis=0), -1, 0)
    hue = np.sqrt(red**2 + blue**2)
    brighter, darker = np.maximum(light - 0.2, 0), np.maximum(-light - 0.8, 0)
    return hue + brighter + darker


def hue_and_light(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The smoothed image's colour ratios [H, W, 2] and brightness [H, W], logarithms."""
    import cv2

    red, green, blue = (cv2.LUT(channel, LOGARITHMS) for channel in cv2.split(cv2.GaussianBlur(image, (5, 5), 0)))
    return np.stack([red - green, blue - green], axis=-1), green


def _opened(mask: np.ndarray) -> np.ndarray:
    """A mask [H, W] without what is thinner than two pixels: a thin rope has no three."""
    import cv2

    kernel = np.ones((2, 2), np.uint8)
    eroded = cv2.erode(mask.astype(np.uint8), kernel, anchor=(0, 0))
    return cv2.dilate(eroded, kernel, anchor=(1, 1)).astype(bool)
