"""What depth and silhouettes ask of a sheet: to lie where the surface is measured, and nowhere where one sees past it."""

import numpy as np

from piegraph_cli.physics.sheet_images import Nearest, Shot
from piegraph_cli.physics.sheet_surface import Sums, Surface, length

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
    rays = shot.lens.rays.reshape(-1, 3).take(surface.flat, 0)
    off = (shot.depth.take(surface.flat) - surface.depth) * np.einsum("pc,pc->p", rays, surface.normals)
    known = np.flatnonzero(shot.inner.take(surface.flat) & (np.abs(off) < FAR))
    way = off[known, None] * surface.normals[known]
    sums.add(surface.corners[known], WEIGHT * surface.weights[known], way)


def keep_silhouette(surface: Surface, shot: Shot, hand: np.ndarray | None, sums: Sums) -> None:
    """Add the ways back into the mask, and out to where the mask shows what the state does not cover."""
    if len(surface.pixels) == 0 or shot.box is None:
        return
    rays = shot.lens.rays.reshape(-1, 3)
    out = np.flatnonzero(shot.mask.take(surface.flat) == 0)
    at, depth = surface.flat[out], surface.depth[out]
    reading = shot.depth.take(at)
    height = shot.lens.origin[2] + rays[at, 2] * reading
    beside = (reading > 0) & ((height < LOW) | (reading > depth + BEHIND))
    if hand is not None:
        beside &= length(surface.points[out] - hand) > HAND
    beside[beside] = ~shot.alike(*surface.pixels[out[beside]].T)
    apart, to = shot.nearest.of(at)
    chosen = beside & (apart <= REACH)
    which = out[chosen]
    way = (rays[to[chosen]] - rays[at[chosen]]) * depth[chosen, None]
    sums.add(surface.corners[which], WEIGHT * surface.weights[which], way)
    _cover(surface, shot, sums)


def _cover(surface: Surface, shot: Shot, sums: Sums) -> None:
    """Pull the nearest part of the surface to where the mask shows more."""
    covered = surface.owner >= 0
    bare = np.flatnonzero((shot.mask > 0) & ~covered)
    if len(bare) == 0:
        return
    apart, from_ = Nearest(covered.view(np.uint8)).of(bare)
    bare, from_ = bare[apart <= REACH], from_[apart <= REACH]
    which, rays = np.searchsorted(surface.flat, from_), shot.lens.rays.reshape(-1, 3)
    way = (rays[bare] - rays[from_]) * surface.depth[which, None]
    kept = length(way) < LEAP
    which = which[kept]
    sums.add(surface.corners[which], WEIGHT * surface.weights[which], way[kept])
