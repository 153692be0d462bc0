"""Where the pattern of a sheet goes from one image to the next: dense optical flow, and how far it is trusted.

Flow counts where it leads back to where it began, where there is texture, and where depth is measured at both ends.
"""

from collections.abc import Callable

import cv2
import numpy as np

from piegraph_cli.physics.sheet_images import Shot, crop, measured, sampled, textured
from piegraph_cli.physics.sheet_surface import Sums, Surface, length

RETURNS = 1.5
"""Pixels from where it began within which flow there and back must end."""
LONGEST, LONGEST_DRIFT = 0.12, 0.06
"""Metres that anything moves in a frame, and that a state is off the pattern."""
NEAR = 0.02
"""Metres between the surface and what is measured of it: beyond, the pixel shows something else."""
PATCH, SMOOTH, FLAT = 9, 1.0, 1.0
"""Pixels of the square about a pixel that is compared, the blur before (px), and variance from which it tells."""
LIKE, SAME, CLOSE = 0.7, 0.7, 0.05
"""Correlations: from which flow leads to the same place, and from which, and how near to that of flow, a place rests."""
GREY = 90
"""What is painted where there is nothing to compare."""
MOST_GAIN = 3.0
"""Contrast of a rendering may be raised by so much, to be that of the image."""
AROUND, BARE = 22, 8
"""Pixels around the sheet that flow is told about, and where nothing is painted there."""
FEWEST = 50
"""Pixels of a rendering that are worth a look."""

Tells = Callable[[Surface, np.ndarray], np.ndarray]
"""Of a surface and some of its pixels [Q]: which of them go where the sheet goes."""


class Patches:
    """An image [H, W] as it is compared with others about each pixel: blurred, with mean and variance of the patch there."""

    def __init__(self, image: np.ndarray):
        """`image` is blurred already, float32."""
        self.image, self.mean = image, _mean(image)
        self.variance = (_mean(image * image) - self.mean**2).clip(min=FLAT)

    def alike(self, other: "Patches") -> np.ndarray:
        """The correlation [H, W] with another image, -1 to 1; near 0 where either is without a pattern."""
        both = _mean(self.image * other.image) - self.mean * other.mean
        return both / np.sqrt(self.variance * other.variance)


def _mean(values: np.ndarray) -> np.ndarray:
    return cv2.boxFilter(values, cv2.CV_32F, (PATCH, PATCH))


def compared(first: np.ndarray, second: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How alike two images [H, W] are about each pixel where flow [H, W, 2] takes it, and where it is: [H, W] each, -1 to 1.

    Flow goes on smoothly over the edge of a layer that moves over another; the pattern there does not go along.
    """
    one, two = (cv2.GaussianBlur(image.astype(np.float32), (0, 0), SMOOTH) for image in (first, second))
    row, column = np.indices(first.shape, np.float32)
    taken = cv2.remap(two, column + there[..., 0], row + there[..., 1], cv2.INTER_LINEAR)
    before = Patches(one)
    return before.alike(Patches(taken)), before.alike(Patches(two))


class Flow:
    """Dense optical flow. Source: Kroeger et al., Fast Optical Flow using Dense Inverse Search (2016); OpenCV's."""

    def __init__(self) -> None:
        self.there, self.back = (cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM) for _ in range(2))
        self.back.setVariationalRefinementIterations(0)  # it only has to end near where the other began

    def between(self, first: np.ndarray, second: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where pixels [P, 2] (row, column) of one image are in another, [P, 2] float32, and where that is sure [P].

        A pixel about which the other image is the same where it was has not moved, whatever flow says.
        """
        one, two = np.ascontiguousarray(first), np.ascontiguousarray(second)
        there = self.there.calc(one, two, np.zeros((*one.shape, 2), np.float32))
        moved, still = compared(one, two, there)
        back = self.back.calc(two, one, np.zeros((*one.shape, 2), np.float32))
        flat = pixels[:, 0] * there.shape[1] + pixels[:, 1]
        moved, still = moved.take(flat), still.take(flat)
        step = there.reshape(-1, 2).take(flat, 0)
        at = pixels[:, ::-1].astype(np.float32) + step
        returned = sampled(back, at[:, 0], at[:, 1], cv2.BORDER_REPLICATE)
        sure = (length(step + returned) < RETURNS) & (moved > LIKE)  # not where flow is not finite
        rests = (still > SAME) & (still > moved - CLOSE)
        at[rests], sure[rests] = pixels[rests, ::-1], True
        return np.where(sure[:, None], at, np.float32(0))[:, ::-1], sure

    def onwards(self, surface: Surface, before: Shot, now: Shot, tells: Tells, sums: Sums) -> None:
        """Add how far the pattern moved between two images; `surface` is what the first shows."""
        if before.box is None or now.box is None:
            return
        cut = crop(before.mask | now.mask, AROUND)
        some = np.flatnonzero(before.textured.take(surface.flat))
        old, known = measured(before, surface.pixels[some])
        known &= length(old - surface.points[some]) < NEAR
        some, old = some[known], old[known]
        told = tells(surface, some)
        some, old = some[told], old[told]
        shades = before.grey.take(surface.flat[some]).astype(np.float32)
        self._follow(surface, some, (before.grey[cut], now.grey[cut], cut), old, now, LONGEST, sums, shades)

    def against(self, surface: Surface, shades: np.ndarray, now: Shot, tells: Tells, sums: Sums) -> None:
        """Add how far the state `surface` is off the image, its pixels having the `shades` [P] (NaN: not known)."""
        known = np.isfinite(shades)
        if known.sum() < FEWEST:
            return
        at = surface.flat[known]
        common = now.mask.take(at) > 0
        if common.sum() < FEWEST:
            return
        shades = shades[known]
        real, drawn = now.grey.take(at[common]).astype(np.float32), shades[common]
        gain = min(MOST_GAIN, float(real.std() / max(drawn.std(), 1e-3)))
        image, covered = np.full(now.grey.shape, GREY, np.uint8), np.zeros(now.mask.shape, np.uint8)
        image.ravel()[at] = np.rint((shades - drawn.mean()) * gain + real.mean()).clip(0, 255).astype(np.uint8)
        covered.ravel()[at] = 1
        either = now.mask | covered
        cut, photo = crop(either, BARE), np.where(either > 0, now.grey, np.uint8(GREY))
        chosen = np.flatnonzero(known)[textured(image, covered).take(at)]
        chosen = chosen[tells(surface, chosen)]
        images = image[cut], photo[cut], cut
        self._follow(surface, chosen, images, surface.points[chosen], now, LONGEST_DRIFT, sums)

    def _follow(
        self,
        surface: Surface,
        chosen: np.ndarray,
        images: tuple[np.ndarray, np.ndarray, tuple[slice, slice]],
        start: np.ndarray,
        now: Shot,
        longest: float,
        sums: Sums,
        shades: np.ndarray | None = None,
    ) -> None:
        """Add the ways of Q `chosen` pixels from `start` [Q, 3] (m) to what is measured where flow takes them.

        With `shades` [Q] that is also where the mask may miss the sheet.
        """
        first, second, cut = images
        corner = np.array([cut[0].start, cut[1].start])
        at = surface.pixels[chosen] - corner
        inside = (at.min(1) >= 0) & (at[:, 0] < first.shape[0]) & (at[:, 1] < first.shape[1])
        if inside.sum() < FEWEST:
            return
        chosen, at, start = chosen[inside], at[inside], start[inside]
        to, sure = self.between(first, second, at)
        end, seen = measured(now, to + corner.astype(np.float32), None if shades is None else shades[inside])
        way = end - start
        kept = np.flatnonzero(sure & seen & (length(way) < longest))
        sums.add(surface.corners[chosen[kept]], surface.weights[chosen[kept]], way[kept])
