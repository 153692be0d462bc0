"""One clock for all cameras: this computer's."""

from collections import deque

SETTLED = 30
"""Frames after which the offset of a clock is kept: the take must not jump."""
LATE = 0.02
"""Spread (s) of the arrivals from which a measured offset is told as rough."""


class HostClock:
    """Times of one camera's frames in seconds of this computer's clock.

    Stamps that are of this clock already are taken as they are. For those of the camera's own clock the offset is
    measured: the least delay between stamp and arrival among the first frames is the one with the least to wait for.
    """

    def __init__(self) -> None:
        self.offset: float | None = None
        """s, of a clock of its own."""
        self._delays: deque[float] = deque(maxlen=SETTLED)

    def seconds(self, stamp: float, arrival: float, own: bool) -> float:
        """The time (s) of a frame stamped `stamp` (s) by its clock, which arrived at `arrival` (s, this computer)."""
        if not own:
            return stamp
        if len(self._delays) < SETTLED:
            self._delays.append(arrival - stamp)
            self.offset = min(self._delays)
        assert self.offset is not None
        return stamp + self.offset

    @property
    def rough(self) -> bool:
        """Whether frames came so unevenly that the offset is not sure."""
        delays = sorted(self._delays)
        return bool(delays) and delays[len(delays) // 2] - delays[0] > LATE
