"""Outlines of what stands on the table: in depth against edges in colour, and of one camera against another's."""

from dataclasses import dataclass

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.planes import Plane, Rays

STANDS_OUT = 0.012
"""What is higher above the table than this share of its depth stands on it; flying pixels do not reach it, noise seldom."""
TALLEST = 0.4
"""Higher above the table (m) is no longer the scene."""
REACH = 0.08
"""Shifts up to this share of the width are tried."""
FEWEST = 60
"""Pixels of outline that are needed to match it."""
PIECE, SPECKS = 5e-4, 3
"""A piece counts that is larger than this share of the image, and than so many times the largest speck of noise."""
CLEAR = 3.0
"""A match counts if it stands this many deviations above chance."""

FLIPS = {
    "mirrored, left for right,": (slice(None), slice(None, None, -1)),
    "upside down": (slice(None, None, -1),),
    "turned by 180 degrees": (slice(None, None, -1), slice(None, None, -1)),
}
"""Ways in which one image of a pair may have been turned over, and how that is undone."""
FLIPPED, NEAR = (0.18, 2.0), 3
"""How far outlines stand out on colour that is turned over, and how many times as far as without; pixels they may be aside."""


@dataclass(frozen=True)
class Shift:
    """How depth has to be moved to lie on colour."""

    x: int
    """Pixels to the right."""
    y: int
    """Pixels down."""
    gain: float
    """How much better the edges fit there than without a shift."""
    more: float
    """Share of the outline that lies on edges there, beyond the share that does without a shift."""


def standing(depth: np.ndarray, camera: Camera, rays: Rays, table: Plane) -> np.ndarray:
    """Mask [H, W] of the readings of a depth image (in the camera's units) that lie above the table, of any pose.

    Noise lies as often below the table as above: what is no larger than the specks there stands for nothing.
    """
    slope = (rays.rays @ table.normal).reshape(rays.shape)
    down = _between(rays.rows[:: rays.shape[1]], camera.height)
    across = _between(rays.columns[: rays.shape[1]], camera.width)
    metres = depth * np.float32(camera.depth_scale)
    height = table.distance - metres * (down @ slope.astype(np.float32) @ across.T)
    out = STANDS_OUT * metres
    above, areas = _pieces((depth > 0) & (height > out) & (height < TALLEST))
    specks = _pieces((depth > 0) & (height < -out) & (height > -2 * out))[1]
    return np.append(False, areas > max(PIECE * depth.size, SPECKS * specks.max(initial=0)))[above]


def _pieces(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The connected pieces of a mask [H, W] without what is thinner than three pixels: their numbers from 1 on [H, W], and
    areas [P] (pixels)."""
    import cv2

    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(opened)
    return labels, statistics[1:, cv2.CC_STAT_AREA]


def _between(nodes: np.ndarray, length: int) -> np.ndarray:
    """Linear interpolation [length, nodes] from values at nodes to every pixel."""
    at = np.arange(length)
    return np.stack([np.interp(at, nodes, row) for row in np.eye(len(nodes))], 1).astype(np.float32)


def match_outlines(masks: list[np.ndarray], colors: list[np.ndarray]) -> Shift | None:
    """The shift that best lays the outlines of masks [H, W] on the edges of colour images [H, W, 3].

    None where there is no outline, or none that stands out in colour.
    """
    import cv2

    reach = max(3, round(REACH * masks[0].shape[1]))
    total, count = np.zeros((2 * reach + 1, 2 * reach + 1)), 0
    for mask, color in zip(masks, colors, strict=True):
        inner = mask.astype(np.uint8)
        outline = mask & (cv2.erode(inner, np.ones((3, 3), np.uint8), borderValue=1) == 0)
        if outline.sum() < FEWEST:
            continue
        edges = _edges(color)
        padded = np.pad(edges, reach, constant_values=edges.mean())
        left, top, wide, high = cv2.boundingRect(outline.astype(np.uint8))
        around = padded[top : top + high + 2 * reach, left : left + wide + 2 * reach]
        part = outline[top : top + high, left : left + wide]
        total += cv2.matchTemplate(around, part.astype(np.float32), cv2.TM_CCORR)
        count += int(outline.sum())
    if not count:
        return None
    fit = cv2.GaussianBlur(total / count, (0, 0), 0.8)
    row, column = np.unravel_index(int(fit.argmax()), fit.shape)
    middle = float(np.median(fit))
    deviation = 1.48 * float(np.median(np.abs(fit - middle)))
    if fit.max() < middle + CLEAR * max(deviation, 1e-6):
        return None
    # noise moves the top of a broad hill by a pixel or two, which says nothing
    gain = float((fit.max() - middle) / max(fit[reach, reach] - middle, 0.1 * (fit.max() - middle)))
    return Shift(int(column) - reach, int(row) - reach, gain, float(fit.max() - fit[reach, reach]))


def find_flip(masks: list[np.ndarray], colors: list[np.ndarray]) -> str | None:
    """How colour images [H, W, 3] are turned over against the outlines of masks [H, W]; None if they are not."""
    as_is = _standing_out(masks, colors)
    fits = {name: _standing_out(masks, [color[undone] for color in colors]) for name, undone in FLIPS.items()}
    best = max(fits, key=lambda name: fits[name])
    return best if fits[best] > max(FLIPPED[0], FLIPPED[1] * as_is) else None


def _standing_out(masks: list[np.ndarray], colors: list[np.ndarray]) -> float:
    """How much stronger edges are on the outlines of masks, a few pixels aside at most, than around them; at most 1."""
    import cv2

    total, count = np.zeros((2 * NEAR + 1, 2 * NEAR + 1)), 0
    for mask, color in zip(masks, colors, strict=True):
        outline = mask & (cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) == 0)
        if outline.sum() < FEWEST:
            continue
        edges = _edges(color)
        around = cv2.dilate(outline.astype(np.uint8), np.ones((41, 41), np.uint8)) > 0
        padded = np.pad(edges - edges[around].mean(), NEAR)
        total += cv2.matchTemplate(padded, outline.astype(np.float32), cv2.TM_CCORR)
        count += int(outline.sum())
    return float(total.max() / count) if count else 0.0


def _edges(color: np.ndarray) -> np.ndarray:
    """Strength of edges [H, W] in 0..1, strong ones alike: a shadow shall not outweigh an outline."""
    import cv2

    smooth = cv2.GaussianBlur(np.ascontiguousarray(color), (0, 0), 1.0)
    steps = [np.abs(cv2.Sobel(smooth, cv2.CV_16S, *along, ksize=3)) for along in ((1, 0), (0, 1))]
    red, green, blue = cv2.split(steps[0] + steps[1])
    strength = cv2.max(cv2.max(red, green), blue).astype(np.float32)
    top = float(np.percentile(strength[::4, ::4], 98))
    return np.minimum(strength / np.float32(max(top, 1.0)), np.float32(1))
