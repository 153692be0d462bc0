"""Takes, one after the other: countdown, take, what became of it, until the user has enough."""

import queue
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from piegraph_cli.capture.folder import next_name
from piegraph_cli.capture.station import Station
from piegraph_cli.capture.take import Take, Taken
from piegraph_cli.recording.camera import Camera

BOARD = "board"
"""The sequence that shows the board."""
TICK = 0.05


class Session:
    """Makes takes of a station's cameras; what the user types comes line by line through `lines`."""

    def __init__(
        self,
        station: Station,
        recording: Path,
        cameras: dict[str, Camera],
        lines: "queue.Queue[str]",
        say: Callable[[str], None],
    ):
        self.station, self.recording, self.cameras = station, recording, cameras
        self.lines, self.say = lines, say
        self.state = "ready"
        """What is going on, for the live picture."""
        self.taken: list[Taken] = []
        self.failure: Exception | None = None
        """Why it ended, if not because the user had enough."""

    def run(self, takes: int | None, seconds: float | None, countdown: int, board: bool = False) -> None:
        """Make so many takes of so many seconds each; without either, Enter begins and ends a take, and q ends all.

        Ctrl-C ends a take and keeps it, and ends all. A camera that stops, or a full disk, does the same.
        """
        try:
            while takes is None or len(self.taken) < takes:
                name = BOARD if board else next_name(self.recording)
                if takes is None and not self._asked(name):
                    return
                self._count_down(countdown, name)
                if not self._take(name, seconds):
                    return
        except KeyboardInterrupt:
            self.say("interrupted")
        finally:
            self.state = "ended"

    def _asked(self, name: str) -> bool:
        """Wait for Enter; False where the user has enough."""
        self.say(f"Enter begins {name}, q ends")
        while True:
            self.state = f"ready for {name}"
            line = self._typed()
            if line is not None:
                return line != "q"
            self._check()
            time.sleep(TICK)

    def _typed(self) -> str | None:
        try:
            return self.lines.get_nowait().strip().lower()
        except queue.Empty:
            return None

    def _check(self) -> None:
        if self.station.failure is not None:
            raise self.station.failure

    def _count_down(self, seconds: int, name: str) -> None:
        for left in range(seconds, 0, -1):
            self.state = f"{name} in {left}"
            self.say(f"{left} ...")
            end = time.monotonic() + 1
            while time.monotonic() < end:
                self._check()
                time.sleep(TICK)

    def _take(self, name: str, seconds: float | None) -> bool:
        """One take; whether to go on."""
        take, keep, on = Take(self.recording, name, self.cameras, self.station.mode.fps), True, True
        with self._received(take):
            self.say(f"{name}: recording" + ("" if seconds else ", Enter ends it, d drops it"))
            try:
                while (seconds is None or take.seconds < seconds) and self.station.failure is None:
                    self.state = f"recording {name}: {take.seconds:.1f} s"
                    line = self._typed()
                    if line is not None:
                        keep, on = line != "d", line != "q"
                        break
                    time.sleep(TICK)
            except KeyboardInterrupt:
                self.say("interrupted: what was taken is kept")
                on = False
        self._finish(take, keep)
        if self.station.failure is not None:
            self.failure, on = self.station.failure, False
        return on

    @contextmanager
    def _received(self, take: Take) -> Iterator[None]:
        """Hand shots to a take, and wait for those that are being written when it is over."""
        self.station.hand_to(take.add)
        try:
            yield
        finally:
            self.station.hand_to(None)

    def _finish(self, take: Take, keep: bool) -> None:
        done = take.finish(keep)
        self.taken.append(done)
        counts = ", ".join(f"{name} {count}" for name, count in done.frames.items())
        if not done.kept:
            why = "dropped" if not keep else "too short, not kept"
            self.say(f"{done.sequence}: {why}")
            return
        self.say(f"{done.sequence}: {done.seconds:.1f} s, frames: {counts}")
        lost = {name: count for name, count in done.dropped.items() if count}
        if lost:
            left_out = ", ".join(f"{name} {count}" for name, count in lost.items())
            self.say(
                f"  dropped frames: {left_out}. If they are many: a lower --fps, a smaller --size, ports of their own"
            )
