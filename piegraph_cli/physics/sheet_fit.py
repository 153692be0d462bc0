"""What depth and silhouettes ask of a sheet: to lie where the surface is measured, and nowhere where one sees past it."""

import cv2
import numpy as np

from piegraph_cli.physics.sheet_images import Shot, measured
from piegraph_cli.physics.sheet_surface import Sums, Surface

WEIGHT = 0.5
"""Of such a pixel, that of flow being 1."""
FAR = 0.04
"""Metres off the measured surface, beyond which a pixel shows something else."""
BEHIND = 0.02
"""Metres by which what is measured may be before the sheet, and the sheet is not hidden."""
REACH = 20
"""Pixels between a silhouette and its image, at most."""
LEAP = 0.06
"""Metres that this may stand for."""
HAND = 0.05
"""Metres from the hand within which it may hide the sheet, whatever the depth says."""


def lie_in_depth(surface: Surface, shot: Shot, sums: Sums) -> None:
    """Add the way along the normal to the measured surface."""
    point, known = measured(shot, surface.pixels)
    off = ((point - surface.points) * surface.normals).sum(1)
    known &= np.abs(off) < FAR
    way = off[known, None] * surface.normals[known]
    sums.add(surface.corners[known], WEIGHT * surface.weights[known], way)


def keep_silhouette(surface: Surface, shot: Shot, hand: np.ndarray | None, sums: Sums) -> None:
    """Add the ways back into the mask, and out to where the mask shows what the state does not cover."""
    if len(surface.pixels) == 0 or shot.box is None:
        return
    row, column = surface.pixels.T
    reading, depth = shot.depth[row, column], surface.depth(shot.lens)
    out = (shot.mask[row, column] == 0) & (reading > depth - BEHIND)
    if hand is not None:
        out &= ((surface.points - hand) ** 2).sum(1) > HAND**2
    apart, nearest = _nearest(shot.mask)
    chosen = np.flatnonzero(out)
    chosen = chosen[apart[row[chosen], column[chosen]] <= REACH]
    to = nearest[row[chosen], column[chosen]]
    rays = shot.lens.rays
    way = (rays[to[:, 0], to[:, 1]] - rays[row[chosen], column[chosen]]) * depth[chosen, None]
    sums.add(surface.corners[chosen], WEIGHT * surface.weights[chosen], way)
    _cover(surface, shot, depth, sums)


def _cover(surface: Surface, shot: Shot, depth: np.ndarray, sums: Sums) -> None:
    """Pull the nearest part of the surface to where the mask shows more."""
    covered = (surface.owner >= 0).astype(np.uint8)
    apart, nearest = _nearest(covered)
    number = np.zeros(covered.shape, np.int32)
    number[surface.pixels[:, 0], surface.pixels[:, 1]] = np.arange(len(surface.pixels))
    bare = np.argwhere((shot.mask > 0) & (covered == 0) & (apart <= REACH))
    if len(bare) == 0:
        return
    from_ = nearest[bare[:, 0], bare[:, 1]]
    which = number[from_[:, 0], from_[:, 1]]
    rays = shot.lens.rays
    way = (rays[bare[:, 0], bare[:, 1]] - rays[from_[:, 0], from_[:, 1]]) * depth[which, None]
    kept = (way**2).sum(1) < LEAP**2
    which = which[kept]
    sums.add(surface.corners[which], WEIGHT * surface.weights[which], way[kept])


def _nearest(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each pixel is from a mask [H, W], and the row and column [H, W, 2] of its nearest pixel there."""
    apart, label = cv2.distanceTransformWithLabels(
        (mask == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    inside = np.argwhere(mask > 0)
    places = np.zeros((int(label.max()) + 1, 2), np.int64)
    places[label[inside[:, 0], inside[:, 1]]] = inside
    return apart, places[label]
