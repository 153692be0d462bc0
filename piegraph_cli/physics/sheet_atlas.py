"""A picture of both faces of a sheet over its flat coordinates, filled while the sheet is known to lie as it does.

It is what a state is compared with, so that small errors from image to image do not add up.
"""

import cv2
import numpy as np

from piegraph_cli.physics.sheet_images import Shot, sampled
from piegraph_cli.physics.sheet_mesh import SheetMesh
from piegraph_cli.physics.sheet_surface import Surface, spread

TEXEL = 0.002
"""Metres."""
BLUR = 0.8
"""Deviation of the blur that fills what lies between pixels, texels."""
LEAST = 0.15
"""Weight of a texel that is known, a pixel at its middle having about 0.25."""
NEAR = 0.012
"""Metres between the surface and what is measured of it."""
PATTERNED, MOSTLY = 0.3, 0.9
"""Share of a place's pixels with texture from which it has a pattern, and of the sheet from which all of it has."""


class Atlas:
    """Grey values over two faces."""

    def __init__(self, mesh: SheetMesh):
        self.low = mesh.points[:, :2].min(0) - TEXEL
        columns, rows = np.ceil((np.ptp(mesh.points[:, :2], axis=0)) / TEXEL).astype(int) + 3
        self.flat = ((mesh.points[:, :2] - self.low) / TEXEL).astype(np.float32)
        self.shades = np.full((2, rows, columns), np.nan, np.float32)
        self.texture = np.full((2, rows, columns), np.nan, np.float32)
        """Share of what filled a texel that had texture, then."""
        self.usual = 0.0
        """The mean of that."""

    def _texels(self, surface: Surface, some: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Column and row [P, 2] of what pixels show."""
        return spread(surface.corners[some], surface.weights[some], self.flat)

    def fill(self, surfaces: list[Surface], shots: list[Shot]) -> None:
        """Put in what the images show where the atlas is empty."""
        total, weight, texture = np.zeros((3, *self.shades.shape), np.float32)
        for surface, shot in zip(surfaces, shots, strict=True):
            row, column = surface.pixels.T
            off = np.abs(shot.depth[row, column] - surface.depth)
            kept = shot.inner[row, column] & (off < NEAR)
            texel = np.rint(self._texels(surface)[kept]).astype(int)
            place = np.where(surface.front[kept], 0, 1), texel[:, 1], texel[:, 0]
            np.add.at(total, place, shot.grey[row[kept], column[kept]].astype(np.float32))
            np.add.at(weight, place, 1.0)
            np.add.at(texture, place, shot.textured[row[kept], column[kept]].astype(np.float32))
        for face in range(2):
            shade, known, share = (cv2.GaussianBlur(a[face], (0, 0), BLUR) for a in (total, weight, texture))
            fresh = (known > LEAST) & np.isnan(self.shades[face])
            self.shades[face][fresh] = (shade / np.maximum(known, 1e-6))[fresh]
            self.texture[face][fresh] = (share / np.maximum(known, 1e-6))[fresh]
        filled = self.texture[np.isfinite(self.texture)]
        self.usual = float(filled.mean()) if len(filled) else 0.0

    @property
    def plain(self) -> bool:
        """Whether most of the sheet has no pattern."""
        return self.usual <= PATTERNED

    def drawn(self, surface: Surface) -> np.ndarray:
        """The shade [P] of each pixel's place on the sheet, NaN where it is not known."""
        return self._at(self.shades, surface)

    def patterned(self, surface: Surface, some: np.ndarray) -> np.ndarray:
        """Which of `some` [Q] pixels show a place that had texture when the atlas was filled; where unknown, as usual.

        A shadow that passes over a plain sheet has borders too, but none that belongs to it.
        """
        if self.usual > MOSTLY:
            return np.ones(len(some), bool)
        share = self._at(self.texture, surface, some)
        return np.where(np.isfinite(share), share, self.usual) > PATTERNED

    def _at(self, values: np.ndarray, surface: Surface, some: np.ndarray | slice = slice(None)) -> np.ndarray:
        column, row = self._texels(surface, some).T
        found, front = np.empty(len(row), np.float32), surface.front[some]
        for face, chosen in ((0, front), (1, ~front)):
            if chosen.any():
                found[chosen] = sampled(values[face], column[chosen], row[chosen], value=np.nan)
        return found
