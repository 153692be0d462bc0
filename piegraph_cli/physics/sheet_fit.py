"""What depth and silhouettes ask of a sheet: to lie where the surface is measured, and nowhere where one sees past it."""

import numpy as np

from piegraph_cli.physics.sheet_images import Nearest, Shot, measured
from piegraph_cli.physics.sheet_surface import Sums, Surface

WEIGHT = 0.5
"""Of such a pixel, that of flow being 1."""
FAR = 0.04
"""Metres off the measured surface, beyond which a pixel shows something else."""
BEHIND = 0.02
"""Metres behind the sheet from which what is measured is seen past it."""
LOW = 0.012
"""Metres above the table below which the table is seen: what is higher beside the mask, a hand, may hide the sheet."""
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
    height = shot.lens.origin[2] + shot.lens.rays[row, column, 2] * reading
    out = (shot.mask[row, column] == 0) & (reading > 0) & ((height < LOW) | (reading > depth + BEHIND))
    if hand is not None:
        out &= ((surface.points - hand) ** 2).sum(1) > HAND**2
    chosen = np.flatnonzero(out)
    chosen = chosen[~shot.alike(row[chosen], column[chosen])]
    apart, to = shot.nearest.of(row[chosen], column[chosen])
    chosen, to = chosen[apart <= REACH], to[apart <= REACH]
    rays = shot.lens.rays
    way = (rays[to[:, 0], to[:, 1]] - rays[row[chosen], column[chosen]]) * depth[chosen, None]
    sums.add(surface.corners[chosen], WEIGHT * surface.weights[chosen], way)
    _cover(surface, shot, depth, sums)


def _cover(surface: Surface, shot: Shot, depth: np.ndarray, sums: Sums) -> None:
    """Pull the nearest part of the surface to where the mask shows more."""
    covered = (surface.owner >= 0).astype(np.uint8)
    bare = np.argwhere((shot.mask > 0) & (covered == 0))
    if len(bare) == 0:
        return
    apart, from_ = Nearest(covered).of(*bare.T)
    bare, from_ = bare[apart <= REACH], from_[apart <= REACH]
    number = np.zeros(covered.shape, np.int32)
    number[surface.pixels[:, 0], surface.pixels[:, 1]] = np.arange(len(surface.pixels))
    which = number[from_[:, 0], from_[:, 1]]
    rays = shot.lens.rays
    way = (rays[bare[:, 0], bare[:, 1]] - rays[from_[:, 0], from_[:, 1]]) * depth[which, None]
    kept = (way**2).sum(1) < LEAP**2
    which = which[kept]
    sums.add(surface.corners[which], WEIGHT * surface.weights[which], way[kept])
