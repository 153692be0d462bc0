"""Several cameras' time stamps on one clock."""

import numpy as np

from piegraph_cli.errors import DataError

SAME_RATE = 0.1
"""A recording within this share of the wanted rate is taken frame by frame."""


def align_frames(
    times: dict[str, np.ndarray], fps: float, max_skew: float, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Frame times [F] (s, from 0) and each camera's frame for them [F, C].

    Recordings at about `fps` are taken frame by frame; others are resampled to the nearest frames of a regular clock,
    without repeating one. Raises `DataError` when the cameras of a frame differ by more than `max_skew` (s).
    """
    stamps = np.stack(list(times.values()), 1)
    clock = stamps.mean(1)
    if len(clock) < 2:
        return clock - clock[:1], np.zeros(stamps.shape, np.int64)
    period = float(np.median(np.diff(clock)))
    if abs(period * fps - 1) <= SAME_RATE:
        source = np.repeat(np.arange(len(clock))[:, None], stamps.shape[1], 1)
    else:
        wanted = np.arange(clock[0], clock[-1] + 0.5 * period, max(1 / fps, period))
        nearest = np.unique(np.abs(wanted[:, None] - clock).argmin(1))
        source = np.repeat(nearest[:, None], stamps.shape[1], 1)
    chosen = np.take_along_axis(stamps, source, 0)
    skew = np.ptp(chosen, axis=1)
    if (skew > max_skew).any():
        frame = int(np.argmax(skew > max_skew))
        names = list(times)
        first, last = names[int(chosen[frame].argmin())], names[int(chosen[frame].argmax())]
        raise DataError(
            f"cameras {first} and {last} are {skew[frame] * 1000:.0f} ms apart in frame {frame}",
            where,
            f"synchronise the cameras, or raise ingest.max_skew above {max_skew}",
        )
    time = chosen.mean(1)
    return time - time[0], source.astype(np.int64)
