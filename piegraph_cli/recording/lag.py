"""Depth that was paired with colour of another moment: what moves in depth against what moves in colour, camera by camera."""

from collections.abc import Iterable, Sequence

import numpy as np

from piegraph_cli.recording.checks import Check, Verdict
from piegraph_cli.recording.clocks import CELLS, FEWEST, TOLD, WIDTH, changes, compare_clocks

FAINT, STRONG = 0.015, 0.075
"""Metres against the still scene: below is noise, above all count alike."""
WEIGHT = 40.0
"""What the strongest counts, as in colour."""
MOST_LATE = 1.5
"""Lags are looked for up to so many seconds."""
OFF, GAIN = (0.5, 0.65), (1.3, 1.45)
"""Share of a frame's time, and times that less is explained without the lag: beyond these it is doubtful, bad.

Good recordings at 5 Hz end at 0.3 and 1.3, a frame too late has 0.7 and 1.3 and more.
"""
MOST = 150
"""Frames that are looked at: those on end in which most happens in colour."""
SHORT, SHORT_LATE = 8, 3.0
"""Frames from which something is said of short sequences, and lags, in frames, that are looked for in them."""
SHORT_OFF, SHORT_GAIN = 0.7, (1.12, 1.25)
"""Frames, and times that colour and depth of all cameras overlap more with the lag: beyond it is doubtful, bad."""


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
    """A check of each camera whose depth shows another moment than its colour; of short sequences one of all cameras.

    `color` and `depth` [F, H', W'] are what is moving in them at `times` [F] (s).
    """
    shortest = min(map(len, times))
    if shortest < FEWEST:
        return _check_short(names, color, depth, times) if shortest >= SHORT else []
    checks = []
    for name, seen, measured, at in zip(names, color, depth, times, strict=True):
        found = compare_clocks([changes(seen), changes(measured)], [at, at], MOST_LATE)
        if found is None or found.fit[1] < TOLD:
            continue
        late, gain, step = float(found.late[1]), float(found.gain[1]), found.unsure * found.step
        if abs(late) < OFF[0] * step or gain < GAIN[0]:
            continue
        bad = abs(late) > OFF[1] * step and gain > GAIN[1]
        checks.append(_check((name,), late, found.step, OFF[0] * step, "bad" if bad else "doubtful"))
    return checks


def _check(names: tuple[str, ...], late: float, step: float, threshold: float, verdict: Verdict) -> Check:
    way = "after" if late > 0 else "before"
    text = f"depth shows things {abs(late):.2f} s ({abs(late) / step:.1f} frames) {way} colour"
    cause = "depth and colour of a frame are of different moments"
    remedy = "pair depth and colour by their own time stamps, or move the numbers of the depth images by that"
    return Check("clocks", names, late, "s", threshold, verdict, text, cause, remedy)


def _check_short(
    names: Sequence[str], color: Sequence[np.ndarray], depth: Sequence[np.ndarray], times: Sequence[np.ndarray]
) -> list[Check]:
    """Too few frames to tell one camera's lag: that of all cameras, by how far what moves overlaps in both."""
    tried = np.arange(-round(10 * SHORT_LATE), round(10 * SHORT_LATE) + 1) / 10
    fits = np.mean([[_overlap(c, d, late) for late in tried] for c, d in zip(color, depth, strict=True)], axis=0)
    late, gain = float(tried[fits.argmax()]), float(fits.max() / max(fits[len(tried) // 2], 1e-9))
    if abs(late) < SHORT_OFF or gain < SHORT_GAIN[0]:
        return []
    step = float(np.median([np.median(np.diff(at)) for at in times]))
    verdict: Verdict = "bad" if gain > SHORT_GAIN[1] else "doubtful"
    return [_check(tuple(names), late * step, step, SHORT_OFF * step, verdict)]


def _overlap(color: np.ndarray, depth: np.ndarray, late: float) -> float:
    """The correlation of what moves [F, H', W'] in colour with what moves in depth so many frames later."""
    at = np.arange(len(color)) + late
    inside = (at >= 0) & (at <= len(color) - 1)
    first = np.floor(at[inside]).astype(int).clip(0, len(color) - 2)
    share = (at[inside] - first)[:, None, None]
    one, other = color[inside], depth[first] * (1 - share) + depth[first + 1] * share
    return float((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum() + 1e-9))
