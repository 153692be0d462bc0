"""Depth that was paired with colour of another moment: what changes in depth against what changes in colour, camera by camera.

Both are pixels of one place, so what changes from a frame to the next changes in the same pixels of both, or so many frames
later in all of them.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from piegraph_cli.recording.checks import Check, Verdict
from piegraph_cli.recording.clocks import CELLS, WIDTH

FAINT, STRONG = 0.015, 0.075
"""Metres against the still scene: below is noise, above all count alike."""
WEIGHT = 40.0
"""What the strongest counts, as in colour."""
MOST_LATE = 1.5
"""Lags are looked for up to so many seconds, and a third of the frames."""
FEWEST, LONG = 8, 16
"""Frames from which something is said, and from which a part of a frame is told."""
CHANGE, ALIKE = 0.08, 0.25
"""How often a pixel has to change, the mean over the image, in colour and in depth, and how well the changes have to agree."""
OFF, SHORT_OFF, SHORTEST = 0.3, 0.6, 0.025
"""Frames of a lag that is doubtful, in long sequences and in short ones, and the least of it (s).

Good recordings at 5 Hz end at 0.17 frames; half a frame has 0.15 to 0.87.
"""
BAD, GAIN, SHORT_GAIN = 0.6, 1.25, 1.45
"""Frames, and times that the changes agree better with the lag, in long sequences and in short ones: beyond both it is bad.

A frame too late has 0.92 and 1.4 and more; good recordings gain nothing, parts of them of 8 to 14 frames up to 1.4.
"""
MOST = 150
"""Frames that are looked at: those on end in which most happens in colour."""


def moving_in_depth(images: Iterable[np.ndarray], scale: float) -> np.ndarray:
    """How much images uint16 [H, W] of `scale` m a unit differ from the still scene, float32 [F, H', W'], `WIDTH` wide."""
    import cv2

    small = []
    for image in images:
        size = WIDTH, max(CELLS[1], round(WIDTH * image.shape[0] / image.shape[1]))
        small.append(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST))
    depth = np.stack(small).astype(np.float32) * scale
    depth[depth == 0] = np.nan
    known = np.isfinite(depth).any(0)
    still = np.zeros(depth.shape[1:], np.float32)
    still[known] = np.nanmedian(depth[:, known], axis=0)
    off = np.nan_to_num(np.abs(depth - still) * known)
    return ((off - FAINT).clip(0, STRONG - FAINT) / (STRONG - FAINT) * WEIGHT).astype(np.float32)


def busiest(seen: np.ndarray) -> slice:
    """Those of the frames of `changes` [F, K], `MOST` on end, in which most changes from one to the next."""
    if len(seen) <= MOST:
        return slice(0, len(seen))
    moved = np.cumsum([0.0, *np.abs(np.diff(seen, axis=0)).sum(1)])
    first = int((moved[MOST - 1 :] - moved[: len(moved) - MOST + 1]).argmax())
    return slice(first, first + MOST)


def check_lags(
    names: Sequence[str], color: Sequence[np.ndarray], depth: Sequence[np.ndarray], times: Sequence[np.ndarray]
) -> list[Check]:
    """A check of each camera whose depth shows another moment than its colour; of all, where no single one tells enough.

    `color` and `depth` [F, H', W'] are what is moving in them at `times` [F] (s).
    """
    agreed, told = [], []
    for name, seen, measured, at in zip(names, color, depth, times, strict=True):
        if len(at) < FEWEST:
            continue
        ours, theirs = (np.abs(np.diff(moved / WEIGHT, axis=0)) for moved in (seen, measured))
        most = int(np.clip(MOST_LATE / float(np.median(np.diff(at))), 2, len(at) // 3))
        agreed.append(agreement(ours, theirs, most))
        if min(one.sum() / one[0].size for one in (ours, theirs)) > CHANGE:
            told.append((name, agreed[-1], at))
    if told:
        return [check for name, agrees, at in told for check in _judged((name,), agrees, at)]
    if len(agreed) < 2 or len({len(one) for one in agreed}) > 1:
        return []
    return _judged(tuple(names), np.mean(agreed, axis=0), times[0])


def agreement(color: np.ndarray, depth: np.ndarray, most: int) -> np.ndarray:
    """The correlation [2 `most` + 1] of changes [F, H', W'] in colour with those in depth so many frames earlier to later."""
    found = []
    for late in range(-most, most + 1):
        one, other = color[max(0, -late) : len(color) - max(0, late)], depth[max(0, late) : len(depth) + min(0, late)]
        found.append(float((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum() + 1e-9)))
    return np.array(found)


def lag_of(agrees: np.ndarray) -> float:
    """The frames by which depth is late, in parts of one, by the parabola through the best of an `agreement` [2 K + 1]."""
    best, middle = int(agrees.argmax()), len(agrees) // 2
    if not 0 < best < len(agrees) - 1:
        return float(best - middle)
    before, here, after = agrees[best - 1 : best + 2]
    return float(best - middle + 0.5 * (before - after) / min(before - 2 * here + after, -1e-9))


def _judged(names: tuple[str, ...], agrees: np.ndarray, times: np.ndarray) -> list[Check]:
    """The check of cameras by the `agreement` of their depth and colour at times [F] (s), where it is not good."""
    step, late = float(np.median(np.diff(times))), lag_of(agrees)
    long = len(times) >= LONG
    threshold = max(OFF if long else SHORT_OFF, SHORTEST / step)
    if agrees.max() < ALIKE or abs(late) < threshold:
        return []
    bad = abs(late) > BAD and agrees.max() > (GAIN if long else SHORT_GAIN) * agrees[len(agrees) // 2]
    return [_check(names, late * step, step, threshold * step, "bad" if bad else "doubtful")]


def _check(names: tuple[str, ...], late: float, step: float, threshold: float, verdict: Verdict) -> Check:
    way = "after" if late > 0 else "before"
    text = f"depth shows things {abs(late):.2f} s ({abs(late) / step:.1f} frames) {way} colour"
    cause = "depth and colour of a frame are of different moments"
    remedy = "pair depth and colour by their own time stamps, or move the numbers of the depth images by that"
    return Check("clocks", names, late, "s", threshold, verdict, text, cause, remedy)
