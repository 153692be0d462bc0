"""Whether cameras see one picture of the table: what is left when a pose is off along the table, whose plane stays."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import Check, Verdict, listed

CELLS, SIZE, REACH = 225, 256, 20
"""Cells of the table's picture to either side, of its Fourier transform, and how many of them a shift may have."""
FINEST = 0.002
"""Side of a cell, metres."""
ON_TABLE = 0.02
"""Depth within this share of the table's shows it."""
COARSE, FINE = 6.0, 0.7
"""Widths, in cells, between which the texture is looked at."""
FAINT = 2.0
"""Texture that is weaker, in grey values, is noise."""
FEWEST = 400
"""Cells that two pictures must share."""
ANGLES = np.arange(-6.0, 6.01, 0.75)
"""Turns that are tried (deg)."""
LIES_WELL = 2
"""Cells of shift that need no further look, where the pictures fit well."""
APART, FIT, GAIN = (0.010, 0.014), (0.35, 0.5), (1.1, 1.2)
"""Distance (m) of two pictures that is doubtful, bad; how well they must fit there, and how much better than in place."""


@dataclass(frozen=True)
class Picture:
    """The table as a camera sees it from above, its texture alone."""

    texture: np.ndarray
    """[CELLS, CELLS] float32, of unit strength; 0 where it is not seen."""
    seen: np.ndarray
    """[CELLS, CELLS] float32, 0 or 1."""
    strength: float
    """Of the texture, grey values."""


@dataclass(frozen=True)
class Fit:
    """How one picture has to be moved to lie on another."""

    apart: float
    """Mean distance, metres."""
    degrees: float
    fit: float
    """Correlation there."""
    gain: float
    """How many times more is left unexplained in place."""

    @property
    def verdict(self) -> Verdict:
        """What to say of it."""
        bad = self.apart > APART[1] and self.fit > FIT[1] and self.gain > GAIN[1]
        doubtful = self.apart > APART[0] and self.fit > FIT[0] and self.gain > GAIN[0]
        return "bad" if bad else "doubtful" if doubtful else "good"


def picture_of(camera: Camera, color: np.ndarray, depth: np.ndarray, workspace: np.ndarray, table: float) -> Picture:
    """The table from above, from colour [H, W, 3] and depth [H, W] in the camera's units.

    `workspace` [3, 2] (m) says which part of the table, `table` its height (m).
    """
    import cv2

    across = (np.arange(CELLS) + 0.5 - CELLS / 2) * _cell(workspace)
    x, y = np.meshgrid(workspace[0].mean() + across, workspace[1].mean() + across)
    pixels, z = camera.project(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, table)]))
    at = np.where(z[:, None] > 0.05, pixels, -1e4).reshape(CELLS, CELLS, 2).astype(np.float32)
    grey = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY).astype(np.float32)
    image = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=-1.0)
    metres = cv2.remap(depth.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_NEAREST) * camera.depth_scale
    on = (metres > 0) & (np.abs(metres - z.reshape(CELLS, CELLS)) < ON_TABLE * metres) & (image >= 0)
    seen = cv2.erode(on.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.float32)

    def smooth(values: np.ndarray, width: float) -> np.ndarray:
        return cv2.GaussianBlur(values, (0, 0), width)

    flat = smooth(image * seen, COARSE) / np.maximum(smooth(seen, COARSE), 1e-3)
    fine = smooth((image - flat) * seen, FINE)
    strength = np.sqrt(smooth(fine**2, 10.0) / np.maximum(smooth(seen, 10.0), 1e-3))
    whole = float(np.sqrt((fine**2 * seen).sum() / max(float(seen.sum()), 1.0)))
    return Picture(fine / np.maximum(strength, 1.0) * seen, seen, whole)


def _cell(workspace: np.ndarray) -> float:
    return max(FINEST, float(np.diff(workspace[:2], axis=1).max()) / CELLS)


def match(one: Picture, other: Picture, cell: float) -> Fit | None:
    """How the other picture has to be moved to lie on the one; None where there is no texture to tell it by."""
    if min(one.strength, other.strength) < FAINT:
        return None
    straight = _correlated(one, other)
    if straight is None:
        return None
    in_place = float(straight[REACH, REACH])
    best, degrees = straight, 0.0
    row, column = np.unravel_index(int(best.argmax()), best.shape)
    if max(abs(row - REACH), abs(column - REACH)) > LIES_WELL or best.max() < FIT[1]:
        for angle in ANGLES[ANGLES != 0]:
            turned = _correlated(one, _turned(other, float(angle)))
            if turned is not None and turned.max() > best.max():
                best, degrees = turned, float(angle)
        row, column = np.unravel_index(int(best.argmax()), best.shape)
    shift = np.array([column - REACH, row - REACH]) * cell
    # the turn is about the middle: on average over the picture it moves a cell as one halfway out
    turn = np.radians(abs(degrees)) * CELLS * cell / 4
    apart = float(np.hypot(np.linalg.norm(shift), turn))
    return Fit(apart, degrees, float(best.max()), (1 - in_place) / max(1 - float(best.max()), 1e-3))


def _turned(picture: Picture, degrees: float) -> Picture:
    import cv2

    turn = cv2.getRotationMatrix2D(((CELLS - 1) / 2, (CELLS - 1) / 2), degrees, 1.0)
    texture = cv2.warpAffine(picture.texture, turn, (CELLS, CELLS))
    seen = (cv2.warpAffine(picture.seen, turn, (CELLS, CELLS)) > 0.99).astype(np.float32)
    return Picture(texture * seen, seen, picture.strength)


def _correlated(one: Picture, other: Picture) -> np.ndarray | None:
    """Correlation [2 REACH + 1, 2 REACH + 1] of what both show, for each shift of the other; None where they share little.

    Source: Padfield, "Masked Object Registration in the Fourier Domain", IEEE Transactions on Image Processing 2012.
    """
    a, b, wa, wb = one.texture, other.texture, one.seen, other.seen
    fa, fwa, faa = (np.fft.rfft2(v, (SIZE, SIZE)) for v in (a, wa, a * a))
    fb, fwb, fbb = (np.conj(np.fft.rfft2(v, (SIZE, SIZE))) for v in (b, wb, b * b))

    def around(spectrum: np.ndarray) -> np.ndarray:
        whole = np.fft.irfft2(spectrum, (SIZE, SIZE))
        return np.roll(whole, (REACH, REACH), (0, 1))[: 2 * REACH + 1, : 2 * REACH + 1]

    count = around(fwa * fwb)
    if count[REACH, REACH] < FEWEST:
        return None
    many = np.maximum(count, 1.0)
    sum_a, sum_b = around(fa * fwb), around(fwa * fb)
    spread_a = np.maximum(around(faa * fwb) - sum_a**2 / many, 1e-6)
    spread_b = np.maximum(around(fwa * fbb) - sum_b**2 / many, 1e-6)
    found = (around(fa * fb) - sum_a * sum_b / many) / np.sqrt(spread_a * spread_b)
    return np.where(count >= FEWEST, found, 0.0)


def check_texture(cameras: Sequence[Camera], pictures: Sequence[Picture], workspace: np.ndarray) -> list[Check]:
    """A check of each two cameras whose pictures of the table can be compared."""
    cell = _cell(workspace)
    pairs = list(combinations(range(len(cameras)), 2))
    fits = {pair: fit for pair in pairs if (fit := match(pictures[pair[0]], pictures[pair[1]], cell))}
    odd = [pair for pair, fit in fits.items() if fit.verdict != "good"]
    alone = [k for k in range(len(cameras)) if odd and all(k in pair for pair in odd)]
    names = [camera.name for camera in cameras]
    who = (
        names[alone[0]]
        if len(alone) == 1
        else listed([n for k, n in enumerate(names) if any(k in p for p in odd)] or [""])
    )
    checks = []
    for (a, b), fit in fits.items():
        turned = f", turned by {abs(fit.degrees):.1f} deg" if fit.degrees else ""
        text = f"their pictures of the table lie {1000 * fit.apart:.0f} mm apart{turned}"
        good = fit.verdict == "good"
        cause = "" if good else f"the pose of {who} is off along the table, which leaves the table's plane where it is"
        remedy = "" if good else f"calibrate {who} again"
        found = (names[a], names[b]), 1000 * fit.apart, "mm", 1000 * APART[0], fit.verdict
        checks.append(Check("texture", *found, text, cause, remedy))
    return checks
