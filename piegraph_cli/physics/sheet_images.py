"""Pictures as the tracker of a sheet reads them: where each pixel looks, what it measures, and where there is texture."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from piegraph_cli.recording.camera import Camera

EDGE, RIM = 1, 5
"""Pixels beside the mask's border that depth, and texture, leave out."""
BLUR, WINDOW = 1.0, 11
"""Deviation (px) of the blur before slopes are taken, and the side (px) of what texture is a mean over."""
LEAST = 10
"""Pixels inside the rim that texture is a mean over, at least: beside the border it is that of what lies within."""
TEXTURED = 1.0
"""Grey levels a pixel by which the image must change along its weakest direction, for flow to be more than noise."""
ALIKE = 15.0
"""Grey levels within which two images show the same."""
LAYER = 0.008
"""Metres between a surface and what is measured, within which it is measured."""
BESIDE = 32
"""Pixels around all that the object ever covers that are looked at."""
FARTHEST = 20.0
"""Metres: no camera measures beyond."""
LINE = 1024
"""Places in a line of what is sampled."""
FEWEST = 48
"""Pixels that a crop is wide and high at least: flow is looked for in pyramids."""


class Lens:
    """A window of a camera's pixels as rays in the world: the part in which the object ever is."""

    def __init__(self, camera: Camera, points: np.ndarray | None = None):
        """`points` [P, 3] (m): where the object ever is; all of the image without them."""
        window = slice(0, camera.height), slice(0, camera.width)
        if points is not None:
            pixels, depth = camera.project(points)
            at = pixels[depth > 0][:, ::-1].clip(0, [camera.height - 1, camera.width - 1]).astype(int)
            if len(at):
                (top, left), (bottom, right) = at.min(0).tolist(), (at.max(0) + 1).tolist()
                window = _wider((top, bottom, left, right), BESIDE, (camera.height, camera.width))
        self.window = window
        K = camera.K - [[0, 0, window[1].start], [0, 0, window[0].start], [0, 0, 0]]
        height, width = (part.stop - part.start for part in window)
        self.camera = camera = replace(camera, K=K, height=height, width=width)
        self.origin = camera.T_world_camera[:3, 3].astype(np.float32)
        self.towards = camera.T_world_camera[:3, :3] @ camera.K.T
        column, row = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = camera.rays(np.column_stack([column.ravel(), row.ravel()])) @ camera.T_world_camera[:3, :3].T
        self.rays = rays.astype(np.float32).reshape(camera.height, camera.width, 3)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Column, row and depth (m) [N, 3] float32 of points [N, 3] (m)."""
        if self.camera.distortion.any():
            pixels, depth = self.camera.project(points)
            return np.column_stack([pixels, depth]).astype(np.float32)
        at = (points - self.camera.T_world_camera[:3, 3]) @ self.towards
        with np.errstate(divide="ignore", invalid="ignore"):  # beside the lens: told by depth
            at[:, :2] /= at[:, 2:]
        return at.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Shot:
    """What one camera took in one frame."""

    lens: Lens
    grey: np.ndarray
    """[H, W] uint8."""
    depth: np.ndarray
    """[H, W] float32, metres, 0 for no reading."""
    mask: np.ndarray
    """[H, W] uint8, 1 on the object."""
    alike: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """Which pixels [P], by row and column, are coloured as the object is, rather than as what is around it."""

    @cached_property
    def inner(self) -> np.ndarray:
        """[H, W] bool: the object, but for its border, where there is depth."""
        return (_eroded(self.mask, EDGE) > 0) & (self.depth > 0) & (self.depth < FARTHEST)

    @cached_property
    def textured(self) -> np.ndarray:
        """[H, W] bool: pixels of the object around which its image has texture."""
        return textured(self.grey, self.mask)

    @cached_property
    def nearest(self) -> "Nearest":
        """Where the object is nearest to each pixel."""
        return Nearest(self.mask)

    @cached_property
    def box(self) -> tuple[int, int, int, int] | None:
        """First and last row and column (these left out) of the mask, None where there is none."""
        return box_of(self.mask)


def completed(shot: Shot, flat: np.ndarray, depth: np.ndarray, shades: np.ndarray | None = None) -> Shot:
    """The same with a mask that has also what it missed: pixels [P] where depth [P] (m) and shades [P] are as expected.

    Masks of many-coloured things have holes, and lack what an arm cuts off. Where a thing is not any more its shade is not
    either. Without shades what is coloured as the thing is taken.
    """
    missed = shot.mask.take(flat) == 0
    missed &= np.abs(shot.depth.take(flat) - depth) < LAYER
    if shades is not None:
        missed &= np.isfinite(shades)
    chosen = np.flatnonzero(missed)
    more, width = flat[chosen], shot.mask.shape[1]
    if shades is None:
        more = more[shot.alike(more // width, more % width)]
    elif len(more):
        off, count = np.zeros((2, *shot.mask.shape), np.float32)
        off.ravel()[more] = np.abs(shades[chosen] - shot.grey.take(more))
        count.ravel()[more] = 1
        off, count = (cv2.boxFilter(a, cv2.CV_32F, (5, 5), normalize=False) for a in (off, count))
        more = more[off.take(more) < ALIKE * count.take(more)]
    if not len(more):
        return shot
    mask = shot.mask.copy()
    mask.ravel()[more] = 1
    return replace(shot, mask=mask)


class Nearest:
    """The pixel of a mask [H, W] (not empty) that is nearest to any other."""

    def __init__(self, mask: np.ndarray):
        self.apart, self.label = cv2.distanceTransformWithLabels(
            (mask == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        inside = np.flatnonzero(mask)
        self.places = np.zeros(len(inside) + 1, np.int64)
        self.places[self.label.take(inside)] = inside

    def of(self, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of pixels [P], counted row by row: how many pixels it is from each to the mask, and which one is there."""
        return self.apart.take(flat), self.places[self.label.take(flat)]


def box_of(mask: np.ndarray) -> tuple[int, int, int, int] | None:
    """First and last row and column (these left out) of what is not zero in an image [H, W]."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        return None
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def textured(grey: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Pixels [H, W] bool inside a mask [H, W] (uint8, 1) around which an image [H, W] changes whichever way one goes.

    The smaller eigenvalue of the structure tensor. Source: Shi and Tomasi (1994).
    """
    found = np.zeros(grey.shape, bool)
    box = box_of(mask)
    if box is None:
        return found
    cut = _wider(box, RIM, grey.shape)
    inside = _eroded(mask[cut], RIM).astype(np.float32)
    smooth = cv2.GaussianBlur(grey[cut].astype(np.float32), (0, 0), BLUR)
    right, down = (cv2.Sobel(smooth, cv2.CV_32F, *d, ksize=3, scale=1 / 8) for d in ((1, 0), (0, 1)))
    count = _summed(inside)
    xx, yy, xy = (_summed(inside * a) / np.maximum(count, 1.0) for a in (right * right, down * down, right * down))
    smaller = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    found[cut] = (smaller > TEXTURED**2) & (count > LEAST) & (mask[cut] > 0)
    return found


def crop(mask: np.ndarray, around: int) -> tuple[slice, slice]:
    """The part of an image around a mask [H, W], which is not empty, and so many pixels more."""
    box = box_of(mask)
    assert box is not None
    return _wider(box, around, mask.shape)


def measured(shot: Shot, at: np.ndarray, shades: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points [P, 3] (m) that a camera measures at places [P, 2] (row, column; between pixels too), and where it does [P]:
    on the object; with `shades` [P] also where the mask may miss it, the image being as they say.

    The ray is that of the place, the depth that of the nearest pixel: between two of them a surface may end.
    """
    near = np.rint(at).astype(np.int32)
    height, width = shot.grey.shape
    row, column = near[:, 0].clip(0, height - 1), near[:, 1].clip(0, width - 1)
    flat, rays = row * width + column, shot.lens.rays.reshape(-1, 3)
    reading = shot.depth.take(flat)
    known = shot.inner.take(flat)
    if shades is not None:
        known |= (np.abs(shades - shot.grey.take(flat)) < ALIKE) & (reading > 0)
    valid = known & (row == near[:, 0]) & (column == near[:, 1])
    here, rest = rays[flat], (at - near).astype(np.float32)
    below, beside = flat + np.where(row + 1 < height, width, 0), flat + (column + 1 < width)
    ways = here + rest[:, :1] * (rays[below] - here) + rest[:, 1:] * (rays[beside] - here)
    return shot.lens.origin + ways * np.where(valid, reading, np.float32(0))[:, None], valid


def sampled(
    image: np.ndarray, column: np.ndarray, row: np.ndarray, border: int = cv2.BORDER_CONSTANT, value: float = 0.0
) -> np.ndarray:
    """What an image [H, W, ...] has at places [P] between its pixels. OpenCV takes no list, of 32,766 at most: a picture."""
    count = len(column)
    places = np.zeros((2, max(1, -(-count // LINE)), LINE), np.float32)
    places.reshape(2, -1)[:, :count] = column, row
    found = cv2.remap(image, places[0], places[1], cv2.INTER_LINEAR, borderMode=border, borderValue=value)
    return found.reshape(-1, *found.shape[2:])[:count]


def _eroded(mask: np.ndarray, pixels: int) -> np.ndarray:
    return cv2.erode(mask, np.ones((2 * pixels + 1,) * 2, np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)


def _summed(values: np.ndarray) -> np.ndarray:
    return cv2.boxFilter(values, cv2.CV_32F, (WINDOW, WINDOW), normalize=False, borderType=cv2.BORDER_CONSTANT)


def _wider(box: tuple[int, int, int, int], by: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The box and `by` pixels around it, at least `FEWEST` a side, inside an image of that shape."""
    spans = []
    for first, last, end in zip(box[::2], box[1::2], shape, strict=True):
        more = max(by, (FEWEST - (last - first) + 1) // 2)
        spans.append(slice(max(0, first - more), min(end, last + more)))
    return spans[0], spans[1]
