"""Several cameras that run: a thread reads each of them, keeps its latest shot, and hands shots to the take that is on."""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping

from piegraph_cli.capture.cameras import DepthCamera, Mode, Shot
from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera

WARM_UP = 10
"""Shots after which exposure and the clock's offset have settled."""
PATIENCE = 5.0
"""Seconds that a camera may take to begin."""
APART = 0.05
"""Seconds, beside a frame, by which shots of one moment may differ."""
SILENCE = 2.0
"""Seconds without a shot after which a camera has stopped."""


class Station:
    """Cameras by name, from `start` to `stop`; also as a context."""

    def __init__(self, cameras: Mapping[str, DepthCamera], mode: Mode):
        self.cameras, self.mode = dict(cameras), mode
        self.models: dict[str, Camera] = {}
        """What each camera said of itself when it was started."""
        self.latest: dict[str, Shot] = {}
        self.failure: Exception | None = None
        """Why the first camera that stopped did."""
        self._receive: Callable[[str, Shot], None] | None = None
        self._begin = 0.0
        self._counts = dict.fromkeys(self.cameras, 0)
        self._busy = {name: threading.Lock() for name in self.cameras}
        self._running = False
        self._threads: list[threading.Thread] = []
        self._changed = threading.Condition()

    def __enter__(self) -> "Station":
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def notes(self) -> list[str]:
        """What the cameras have to say."""
        return [note for camera in self.cameras.values() for note in camera.notes]

    def start(self) -> None:
        """Start all cameras and wait until each has settled. Raises what a camera raises that cannot."""
        for name, camera in self.cameras.items():
            self.models[name] = camera.start(self.mode)
        self._running = True
        for name in self.cameras:
            thread = threading.Thread(target=self._read, args=(name,), name=f"camera {name}", daemon=True)
            thread.start()
            self._threads.append(thread)
        self.wait(lambda: min(self._counts.values()) >= WARM_UP, PATIENCE + WARM_UP / self.mode.fps)

    def stop(self) -> None:
        """Stop reading, then the cameras."""
        self._running = False
        for thread in self._threads:
            thread.join(SILENCE + 1)
        self._threads = []
        for camera in self.cameras.values():
            camera.stop()

    def wait(self, until: Callable[[], bool], seconds: float) -> None:
        """Wait for something that shots bring about. Raises `DataError` where a camera stops, or it does not come."""
        end = time.monotonic() + seconds
        with self._changed:
            while not until():
                if self.failure is not None:
                    raise self.failure
                if not self._changed.wait(min(0.1, max(end - time.monotonic(), 0.0))) and time.monotonic() >= end:
                    slow = min(self._counts, key=lambda name: self._counts[name])
                    raise DataError(
                        f"camera {slow} delivers nothing: {self._counts[slow]} frames in {seconds:.0f} s",
                        hint="check cable and port, or ask for a lower --fps",
                    )

    def shots(self) -> list[Shot]:
        """The next shot of each camera. Raises `DataError` where a camera stops, or their times do not belong together."""
        begin = dict(self._counts)
        self.wait(lambda: all(self._counts[name] > begin[name] for name in begin), SILENCE)
        found = [self.latest[name] for name in begin]
        times = {name: shot.time for name, shot in zip(begin, found, strict=True)}
        first, last = min(times, key=lambda n: times[n]), max(times, key=lambda n: times[n])
        if times[last] - times[first] > APART + 1 / self.mode.fps:
            raise DataError(
                f"{first} is {(times[last] - times[first]) * 1000:.0f} ms behind {last}",
                hint="look again; if it stays so, their clocks disagree: plug them in anew",
            )
        return found

    def hand_to(self, receive: Callable[[str, Shot], None] | None) -> None:
        """Let `receive` have every shot from now on, in the thread of its camera, until it is another's turn.

        Now is the latest shot of all cameras: what another camera took before, and its thread brings late, has no partner.
        Where their clocks disagree by more than a camera may be late, nothing tells which is right, and it gets all.
        No thread is within the former `receive` any more when this returns.
        """
        with contextlib.ExitStack() as stack:
            for lock in self._busy.values():
                stack.enter_context(lock)
            times = [shot.time for shot in self.latest.values()]
            self._begin = max(times) if times and max(times) - min(times) < SILENCE else 0.0
            self._receive = receive

    def _read(self, name: str) -> None:
        """Read one camera until all is over or it fails."""
        while self._running:
            try:
                shot = self.cameras[name].read(SILENCE)
                with self._busy[name]:
                    if self._receive is not None and shot.time > self._begin:
                        self._receive(name, shot)
                    self.latest[name] = shot
            except Exception as error:  # a thread has nobody else to tell
                with self._changed:
                    self.failure = self.failure or error
                    self._changed.notify_all()
                return
            with self._changed:
                self._counts[name] += 1
                self._changed.notify_all()
