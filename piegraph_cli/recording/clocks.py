"""How far the clocks of cameras are apart, from when things move in their images; no pose is needed for it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from piegraph_cli.recording.checks import Check, Verdict

WIDTH, CELLS = 80, (6, 4)
"""Images are looked at so wide, pixels, and in so many cells across and down."""
FAINT, STRONG = 8.0, 48.0
"""Changes of grey against the still scene: below is noise, above all count alike."""
MOST, MOST_SHARE = 3.0, 0.3
"""Offsets are looked for up to so many seconds, and this share of the recording."""
STEP = 0.02
"""Offsets are tried so finely, seconds."""
RIDGE = 0.03
FEWEST, MOVING = 16, 6
"""Frames that are needed, and in how many of them something has to move."""
ROUNDS = 12
OFF, GAIN = (0.45, 0.6), (1.1, 1.25)
"""Share of a frame's time, and times that less is explained without the offset: from these on it is doubtful, bad.

Good recordings at 5 Hz end at 0.06 s and 1.1.
"""
TOLD = 0.3
"""Share of what changes in a camera that has to be foretold by others, or nothing can be said."""


@dataclass(frozen=True)
class Clocks:
    """How the clocks of cameras are found to be."""

    late: np.ndarray
    """[C] seconds by which what a camera shows lies behind its time stamps, against most others (of two: the first)."""
    fit: np.ndarray
    """[C] share of a camera's changes that others foretell, with these offsets."""
    gain: np.ndarray
    """[C] how many times more is left unexplained were the camera not late."""
    step: float
    """Seconds from frame to frame."""
    lost: float
    """Share of the frames that a camera lacks between its first and its last, the largest of all cameras."""

    @property
    def unsure(self) -> float:
        """How many times larger an offset must be to be told, for what is lost between frames."""
        return 1 + 5 * self.lost

    def verdict(self, camera: int) -> Verdict:
        """What to say of a camera's clock."""
        late, gain = abs(self.late[camera]) / (self.unsure * self.step), self.gain[camera]
        if self.fit[camera] < TOLD or late < OFF[0] or gain < GAIN[0]:
            return "good"
        return "bad" if late > OFF[1] and gain > GAIN[1] else "doubtful"


def moving(images: Iterable[np.ndarray]) -> np.ndarray:
    """How much differs from the still scene in grey images uint8 [H, W], float32 [F, H', W'], `WIDTH` wide."""
    import cv2

    small = []
    for image in images:
        size = WIDTH, max(CELLS[1], round(WIDTH * image.shape[0] / image.shape[1]))
        small.append(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    grey = np.stack(small).astype(np.float32)
    return (np.abs(grey - np.median(grey, axis=0)) - FAINT).clip(0, STRONG - FAINT)


def changes(moved: np.ndarray) -> np.ndarray:
    """How much of what is `moving` [F, H', W'] is in each part of the images, float [F, 24]."""
    import cv2

    return np.stack([cv2.resize(one, CELLS, interpolation=cv2.INTER_AREA).ravel() for one in moved]).astype(float)


def compare_clocks(seen: Sequence[np.ndarray], times: Sequence[np.ndarray], most: float = MOST) -> Clocks | None:
    """The offsets, up to `most` (s), with which the `changes` [F, K] of each camera say most of the others'.

    `times` [F] (s) are their time stamps. None for fewer than two cameras, or where too little happens.
    """
    if len(seen) < 2 or any(
        len(t) < FEWEST or (one.sum(1) > 0.5).sum() < MOVING for one, t in zip(seen, times, strict=True)
    ):
        return None
    most = min(most, MOST_SHARE * min(float(t[-1] - t[0]) for t in times))
    tried = np.arange(-round(most / STEP), round(most / STEP) + 1) * STEP
    fits = {
        (a, b): np.array([_fit(seen[a], seen[b], times[a], times[b], late) for late in tried])
        for a, b in combinations(range(len(seen)), 2)
    }
    late = _best(fits, len(seen), len(tried))
    at, zero = late + len(tried) // 2, len(tried) // 2
    scores = [_of_camera(fits, c, late) for c in range(len(seen))]
    here = np.array([score[k] for score, k in zip(scores, at.clip(0, len(tried) - 1), strict=True)])
    still = np.array([score[zero] for score in scores])
    step = float(np.median([np.median(np.diff(t)) for t in times]))
    foretold = np.zeros((len(seen), len(seen)))
    for a, b in fits:
        between = float(late[b] - late[a]) * STEP
        foretold[a, b] = foretold[b, a] = _fit(seen[a], seen[b], times[a], times[b], between, apart=True)
    fit = foretold.sum(1) / (len(seen) - 1)
    lost = max(1 - len(t) / (1 + (t[-1] - t[0]) / np.median(np.diff(t))) for t in times)
    return Clocks(late * STEP, fit, (1 - still) / np.maximum(1 - here, 1e-6), step, max(0.0, float(lost)))


def _best(fits: dict[tuple[int, int], np.ndarray], cameras: int, tried: int) -> np.ndarray:
    """Offsets [C], in steps, found by moving the camera that gains most, again and again."""
    late, zero = np.zeros(cameras, int), tried // 2
    for _ in range(ROUNDS):
        scores = [_of_camera(fits, c, late) for c in range(cameras)]
        best = [int(score.argmax()) - zero for score in scores]
        gains = [
            score[new + zero] - score[min(max(old + zero, 0), tried - 1)]
            for score, new, old in zip(scores, best, late, strict=True)
        ]
        if max(gains) < 1e-4:
            break
        late[int(np.argmax(gains))] = best[int(np.argmax(gains))]
    return late - (late[0] if cameras == 2 else round(float(np.median(late))))


def _of_camera(fits: dict[tuple[int, int], np.ndarray], camera: int, late: np.ndarray) -> np.ndarray:
    """The mean fit of a camera with all others at each offset that was tried, were the others as `late` says (steps)."""
    tried = len(next(iter(fits.values())))
    steps, total = np.arange(tried) - tried // 2, np.zeros(tried)
    for (a, b), fit in fits.items():
        if camera in (a, b):
            between = steps - late[a] if camera == b else late[b] - steps
            at = between + tried // 2
            total += np.where((at >= 0) & (at < tried), fit[at.clip(0, tried - 1)], -1.0)
    return total / (len(late) - 1)


def _fit(
    one: np.ndarray,
    other: np.ndarray,
    one_times: np.ndarray,
    other_times: np.ndarray,
    late: float,
    apart: bool = False,
) -> float:
    """Share of the variance of each camera's changes that the other's explain linearly, were the other `late` (s).

    With `apart` each frame is explained by what was learned from the others: many columns explain anything else.
    """
    moved = np.stack([np.interp(one_times + late, other_times, column) for column in other.T], 1)
    return (_explained(one, moved, apart) + _explained(moved, one, apart)) / 2


def _explained(by: np.ndarray, what: np.ndarray, apart: bool) -> float:
    """Share of the variance of columns [F, K] that a linear function of others [F, L] explains, the mean over columns."""
    x = (by - by.mean(0)) / np.maximum(by.std(0), 1e-9)
    y = (what - what.mean(0)) / np.maximum(what.std(0), 1e-9)
    hat = x @ np.linalg.solve(x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T)
    left = y - hat @ y
    if apart:
        left /= np.maximum(1 - np.diag(hat), 0.05)[:, None]
    return 1 - float((left**2).mean() / max(float((y**2).mean()), 1e-9))


def check_clocks(names: Sequence[str], seen: Sequence[np.ndarray], times: Sequence[np.ndarray]) -> list[Check]:
    """A check of each camera's clock, from its `changes` [F, K] and time stamps [F] (s); none where nothing can be told."""
    clocks = compare_clocks(seen, times)
    if clocks is None:
        return []
    checks = []
    for k, name in enumerate(names):
        late, verdict = float(clocks.late[k]), clocks.verdict(k)
        text = f"it shows things {abs(late):.2f} s {'after' if late > 0 else 'before'} the others"
        found = explained(name, late) if verdict != "good" else ("", "")
        checks.append(Check("clocks", (name,), late, "s", OFF[0] * clocks.unsure * clocks.step, verdict, text, *found))
    return checks


def explained(name: str, late: float) -> tuple[str, str]:
    """The cause, and what to do, for a camera that is so late (s)."""
    way = "late: its time stamps are ahead of what it shows" if late > 0 else "early: its time stamps lag what it shows"
    return (
        f"the clock of {name} is {abs(late):.2f} s {way}",
        f"one clock for all cameras, or ingest.offsets = {name}={late:.2f}",
    )
