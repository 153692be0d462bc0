"""One take: shots become files beside the recording while it lasts, and a sequence folder when it is over."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.capture.cameras import Shot
from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.layout import write_frame, write_times

QUALITY = 95
"""Of JPEG."""
FEWEST = 2
"""Frames of each camera below which a take is nothing."""


@dataclass(frozen=True)
class Taken:
    """What became of a take."""

    sequence: str
    frames: dict[str, int]
    """Of each camera."""
    dropped: dict[str, int]
    """Frames that a camera left out, by the gaps between its times."""
    seconds: float
    kept: bool


class Take:
    """Writes shots to `.NAME.part` in the recording, which `finish` renames to NAME: a sequence is whole or not there."""

    def __init__(self, recording: Path, name: str, cameras: dict[str, Camera], fps: int):
        self.recording, self.name, self.cameras, self.fps = recording, name, cameras, fps
        self.folder = recording / f".{name}.part"
        self.times: dict[str, list[float]] = {camera: [] for camera in cameras}
        if (recording / name).exists() or self.folder.exists():
            place = recording / name if (recording / name).exists() else self.folder
            raise DataError("is there already", str(place), "remove it, or move it elsewhere")
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise DataError(f"cannot be written: {error.strerror}", str(recording), "choose another folder") from None

    def add(self, camera: str, shot: Shot) -> None:
        """Write a camera's shot; in its own thread. Raises `DataError` where the disk is full."""
        times = self.times[camera]
        if times and shot.time <= times[-1]:
            return
        model = self.cameras[camera]
        try:
            write_frame(self.folder, model, len(times), shot.color, shot.depth, QUALITY)
        except OSError as error:
            raise DataError(
                f"frame {len(times)} of {camera} cannot be written: {error.strerror}",
                str(self.recording),
                "free disk space, or record elsewhere",
            ) from None
        times.append(shot.time)

    @property
    def seconds(self) -> float:
        """How long it has lasted."""
        return max((t[-1] - t[0] for t in list(self.times.values()) if t), default=0.0)

    def finish(self, keep: bool = True) -> Taken:
        """End the take once no thread adds to it any more: keep it, or remove it. What has too few frames is never kept."""
        end = min((t[-1] for t in self.times.values() if t), default=0.0)
        for name, times in self.times.items():
            self._cut(name, times, end + 0.5 / self.fps)
        frames = {name: len(times) for name, times in self.times.items()}
        seconds, kept = self.seconds, keep and min(frames.values()) >= FEWEST
        dropped = {name: self._dropped(times) for name, times in self.times.items()}
        if not kept:
            shutil.rmtree(self.folder, ignore_errors=True)
            return Taken(self.name, frames, dropped, seconds, False)
        begin = min(times[0] for times in self.times.values())
        try:
            for name, times in self.times.items():
                write_times(self.folder, self.cameras[name], np.array(times) - begin)
            self.folder.rename(self.recording / self.name)
        except OSError as error:
            raise DataError(
                f"the take cannot be finished: {error.strerror}",
                str(self.folder),
                "free disk space; the images are there, their times are lost",
            ) from None
        return Taken(self.name, frames, dropped, seconds, True)

    def _cut(self, name: str, times: list[float], end: float) -> None:
        """Drop what came after a camera that had stopped: nothing belongs to it."""
        while times and times[-1] > end:
            times.pop()
            for kind in ("color", "depth"):
                for file in (self.folder / name / kind).glob(f"{len(times):06d}.*"):
                    file.unlink()

    def _dropped(self, times: list[float]) -> int:
        steps = np.diff(times) * self.fps
        return int(np.maximum(np.round(steps) - 1, 0).sum())
