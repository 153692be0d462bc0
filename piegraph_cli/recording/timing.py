"""Several cameras' time stamps: checked one by one, and brought together on one clock."""

import numpy as np

from piegraph_cli.errors import DataError

SAME_RATE = 0.1
"""A recording within this share of the wanted rate is taken frame by frame."""
SLOWEST, FASTEST, UNUSUAL = 0.2, 2000.0, 200.0
"""Frames a second beyond which time stamps are not in seconds, and from which that is asked."""
COUNTED = 8
"""Steps of whole numbers up to this one count frames: of milliseconds they would be 125 frames a second."""
UNITS = ((1e3, 1e3, "milliseconds"), (1e6, 1e6, "microseconds"), (np.inf, 1e9, "nanoseconds"))
"""Step (s) up to which time stamps are in a unit, how many of it a second has, and its name."""
TICKS = ((1e17, 1e18), 1e7, "ticks of 100 ns")
"""The same of what Windows counts since 1601, or since year 1: since 1970 it is more nanoseconds."""
COUNTS = "time stamps are in seconds: divide frame numbers by the frames a second"
LONGEST_GAP, GAP = 10.0, 1.0
"""Seconds without a frame that are refused, and that are said, where they are also many times the usual step."""
LONGEST = 86_400.0
"""Seconds that a sequence lasts at most."""
LATEST = 1e11
"""Seconds that no clock shows."""
LEAST_REPEATED, REPEATED = 3, 0.2
"""Time stamps, and a share of them, that repeat the one before from which they were rounded."""
MANY = 10
FEWEST = 0.5
"""Share of the frames that must have a partner in every camera."""


def check_times(times: np.ndarray, where: str, item: str = "line", first: int = 1) -> list[str]:
    """Check one camera's time stamps [frame] (s), which are `item` `first` and so on of `where`; returns warnings of gaps.

    Raises `DataError` naming the line for stamps that are not finite, do not increase, leap ahead, or are no seconds.
    """
    wrong = np.flatnonzero(~np.isfinite(times))
    if len(wrong):
        raise DataError(
            f"{item} {wrong[0] + first} is not a finite number", where, "one time stamp in seconds per line"
        )
    steps = np.diff(times)
    back = np.flatnonzero(steps <= 0)
    if (steps == 0).sum() >= max(LEAST_REPEATED, REPEATED * len(steps)) and steps.min() >= 0:
        message = f"{(steps == 0).sum()} of {len(times)} time stamps repeat the one before: were they rounded?"
        raise DataError(
            message, where, "write seconds with three decimals or more; times since 1970 need double precision"
        )
    if len(back):
        raise DataError(
            f"time stamps must increase: {item} {back[0] + 1 + first} does not",
            where,
            "sort or repair the file, or cut it there",
        )
    if not len(steps):
        return []
    usual = float(np.median(steps))
    warnings = _check_rate(times, steps, where)
    longest = int(np.argmax(steps))
    if steps[longest] > max(LONGEST_GAP, MANY * usual):
        raise DataError(
            f"time stamps leap {steps[longest]:.1f} s ahead at {item} {longest + 1 + first}",
            where,
            "if nothing was recorded in between, make two sequences of it; otherwise repair the clock",
        )
    _check_span(times, where)
    gaps = np.flatnonzero(steps > max(GAP, MANY * usual))
    if len(gaps):
        more = f", and {len(gaps) - 1} more" if len(gaps) > 1 else ""
        warnings.append(f"{where}: {steps[gaps[0]]:.1f} s without a frame before {item} {gaps[0] + 1 + first}{more}")
    return warnings


def _check_rate(times: np.ndarray, steps: np.ndarray, where: str) -> list[str]:
    """Refuse rates that cameras do not have, with the unit that would make one; warn of those they hardly have."""
    usual = float(np.median(steps))
    counted = (
        1 <= usual <= COUNTED and len(steps) > 1 and bool((steps == usual).all() and (times == np.round(times)).all())
    )
    frames = f"whole numbers, {usual:g} apart: are these frame numbers?"
    if 1 / usual < SLOWEST:
        if counted:
            raise DataError(f"time stamps are {frames}", where, COUNTS)
        _, in_second, unit = (
            TICKS if TICKS[0][0] <= times[0] < TICKS[0][1] else next(row for row in UNITS if usual < row[0])
        )
        message = f"{1 / usual:.2g} frames a second: are these {unit}?"
        raise DataError(message, where, f"time stamps are in seconds: divide by {in_second:.0f}")
    if 1 / usual > FASTEST:
        raise DataError(f"{1 / usual:.2g} frames a second", where, "give the time stamps in seconds")
    if counted:
        return [f"{where}: time stamps are {frames}\n  try: {COUNTS}"]
    if 1 / usual > UNUSUAL:
        return [f"{where}: {1 / usual:.0f} frames a second: are these minutes?\n  try: give the time stamps in seconds"]
    return []


def _check_span(times: np.ndarray, where: str) -> None:
    """Refuse times that no clock shows, and more of them than a day has."""
    if times[-1] - times[0] > LONGEST or abs(times[-1]) > LATEST:
        message = f"time stamps go from {times[0]:.6g} to {times[-1]:.6g} s"
        raise DataError(message, where, f"a sequence lasts {LONGEST:.0f} s at most: cut it, or repair the clock")


def pair_frames(times: dict[str, np.ndarray], max_skew: float, where: str) -> tuple[np.ndarray, list[str]]:
    """Each camera's frames that belong together [F, C], by time stamps (s), and warnings of those without partners.

    Of the slowest cameras the one with most frames leads; a frame belongs to the one of another camera that is nearest
    to it, if it is itself that one's nearest, and all of them lie within `max_skew` (s). A frame that half of the cameras
    have, two at least, is kept: for a camera that lost it stands the nearest of its frames, as -1 less its number.
    Raises `DataError` naming two cameras and a frame where fewer than half of the frames find partners in one of them.
    """
    names, stamps = list(times), list(times.values())
    early, late = int(np.argmin([s[-1] for s in stamps])), int(np.argmax([s[0] for s in stamps]))
    if stamps[early][-1] + max_skew < stamps[late][0]:
        spans = " and ".join(f"{names[c]} {stamps[c][0]:.2f} to {stamps[c][-1]:.2f} s" for c in (early, late))
        raise DataError(f"cameras share no time: {spans}", where, "give all cameras one clock")
    steps = [float(np.median(np.diff(s))) if len(s) > 1 else 0.0 for s in stamps]
    slow = [c for c, step in enumerate(steps) if step * (1 + SAME_RATE) >= max(steps)]
    lead = stamps[max(slow, key=lambda c: len(stamps[c]))]
    groups = np.stack([nearest(lead, other) for other in stamps], 1)
    mutual = np.stack([nearest(o, lead)[groups[:, c]] == np.arange(len(lead)) for c, o in enumerate(stamps)], 1)
    found = np.stack([other[groups[:, c]] for c, other in enumerate(stamps)], 1)
    has = mutual & (np.abs(found - lead[:, None]) <= max_skew)
    skew = np.where(has, found, -np.inf).max(1) - np.where(has, found, np.inf).min(1)
    has &= (skew <= max_skew)[:, None]
    if has.mean(0).min() < FEWEST:
        frame, skew = int(np.argmin(has.all(1))), np.ptp(found, axis=1)
        first, last = names[int(found[frame].argmin())], names[int(found[frame].argmax())]
        raise DataError(
            f"cameras {first} and {last} are {skew[frame] * 1000:.0f} ms apart in frame {frame}; "
            f"{has.all(1).sum()} of {len(lead)} frames have a partner in every camera",
            where,
            f"give all cameras one clock, or raise ingest.max_skew above {max_skew}",
        )
    kept = has.sum(1) >= min(len(stamps), max(2, -(-len(stamps) // 2)))
    groups = np.where(has, groups, ~groups)[kept]
    return groups, _left_out(times, groups, slow, max_skew)


def _left_out(times: dict[str, np.ndarray], groups: np.ndarray, slow: list[int], max_skew: float) -> list[str]:
    """Warnings of frames that have no partners, of cameras that are no faster than others, and of those that lack some."""
    names = list(times)
    alone = {names[c]: np.setdiff1d(np.arange(len(times[names[c]])), groups[:, c]) for c in slow}
    counts = [f"{name} {len(frames)} of {len(times[name])}" for name, frames in alone.items() if len(frames)]
    warnings = []
    if counts:
        name, frames = next((name, frames) for name, frames in alone.items() if len(frames))
        message = (
            f"frames without a partner in every camera within {max_skew * 1000:g} ms left out: {', '.join(counts)}"
        )
        warnings.append(f"{message}; first: frame {frames[0]} of {name}")
    lost = [f"{name} {count}" for name, count in zip(names, (groups < 0).sum(0), strict=True) if count]
    if lost:
        warnings.append(f"frames that a camera lost, of {len(groups)}: {', '.join(lost)}; it shows nothing there")
    return warnings


def nearest(stamps: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The index of the nearest of rising `others` for each of `stamps`; of two as near the earlier one."""
    after = np.searchsorted(others, stamps).clip(1, max(len(others) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(others) - 1)
    return np.where(np.abs(others[after] - stamps) < np.abs(others[before] - stamps), after, before)


def matched(times: np.ndarray, others: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Which of rising `times` (s) have a partner in rising `others`, each the other's nearest and `within` (s), and which."""
    partner = nearest(times, others)
    mutual = nearest(others, times)[partner] == np.arange(len(times))
    kept = np.flatnonzero(mutual & (np.abs(others[partner] - times) <= within))
    return kept, partner[kept]


def frame_times(times: list[np.ndarray], groups: np.ndarray) -> np.ndarray:
    """Time stamps [F, C] (s) of frames as `pair_frames` has them; where a camera lost one, the mean of the others'."""
    stamps = np.stack([own[np.where(groups[:, c] < 0, 0, groups[:, c])] for c, own in enumerate(times)], 1)
    there = groups >= 0
    mean = (stamps * there).sum(1) / there.sum(1)
    return np.where(there, stamps, mean[:, None])


def align_frames(
    times: dict[str, np.ndarray], fps: float, max_skew: float, where: str
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Frame times [F] (s, from 0), each camera's frame for them [F, C] as `pair_frames` has them, and warnings.

    `times`: rising time stamps (s) of each camera, one or more. Recordings at about `fps` are taken frame by frame;
    others are resampled to the nearest frames of a regular clock, without repeating one. Raises as `pair_frames`.
    """
    groups, warnings = pair_frames(times, max_skew, where)
    clock = frame_times(list(times.values()), groups).mean(1)
    if len(clock) > 1:
        period = float(np.median(np.diff(clock)))
        if abs(period * fps - 1) > SAME_RATE:
            wanted = np.arange(clock[0], clock[-1] + 0.5 * period, max(1 / fps, period))
            chosen = np.unique(nearest(wanted, clock))
            clock, groups = clock[chosen], groups[chosen]
    return clock - clock[0], groups.astype(np.int64), warnings
