"""Whether disk and processor keep up with the cameras, found out before a take."""

import os
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from piegraph_cli.capture.cameras import Shot
from piegraph_cli.capture.take import QUALITY
from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.layout import write_frame

PROBE = 32
"""MB written to find the speed of the disk."""
SPARE = 1.5
"""How many times as fast as needed the disk should be."""
BUSY = 0.8
"""Share of the processor's cores that writing may take."""
SHORTEST = 60.0
"""Seconds that the space must last for."""


@dataclass(frozen=True)
class Load:
    """What recording takes, and what there is."""

    needed: float
    """MB a second of all cameras."""
    speed: float
    """MB a second that the disk takes."""
    free: float
    """MB."""
    cores: float
    """Processor cores that encoding keeps busy."""
    available: int

    @property
    def seconds(self) -> float:
        """How long the space lasts."""
        return self.free / self.needed


def measure(folder: Path, shots: Mapping[str, Shot], cameras: Mapping[str, Camera], fps: int) -> Load:
    """Write one shot of each camera, and a piece of file, into a folder beside the recording; both are removed again."""
    probe = folder / ".probe"
    try:
        shutil.rmtree(probe, ignore_errors=True)
        probe.mkdir(parents=True)
        begin = time.thread_time()
        for name, shot in shots.items():
            write_frame(probe, cameras[name], 0, shot.color, shot.depth, QUALITY)
        cores = (time.thread_time() - begin) * fps
        size = sum(file.stat().st_size for file in probe.rglob("*") if file.is_file()) / 1e6
        speed = _write_speed(probe / "piece")
        free = shutil.disk_usage(folder).free / 1e6
    except OSError as error:
        raise DataError(f"cannot be written: {error.strerror}", str(folder), "choose another folder or disk") from None
    finally:
        shutil.rmtree(probe, ignore_errors=True)
    return Load(size * fps, speed, free, cores, os.cpu_count() or 1)


def _write_speed(path: Path) -> float:
    """MB a second, with what is written really on the disk."""
    piece = os.urandom(1_000_000)
    begin = time.monotonic()
    with path.open("wb") as file:
        for _ in range(PROBE):
            file.write(piece)
        file.flush()
        os.fsync(file.fileno())
    return PROBE / max(time.monotonic() - begin, 1e-6)


def check(load: Load, folder: Path, seconds: float | None) -> list[str]:
    """Raise `DataError` where a take cannot be written, and say what is tight; `seconds` is how long a take is, if known."""
    needs = f"the cameras give {load.needed:.0f} MB a second"
    hint = "a lower --fps, a smaller --size, fewer cameras, or another disk"
    if load.speed < load.needed:
        raise DataError(f"{needs}, this disk takes {load.speed:.0f}", str(folder), hint)
    if load.seconds < (seconds or SHORTEST):
        raise DataError(
            f"{load.free:.0f} MB are free, enough for {load.seconds:.0f} s ({needs})", str(folder), "free disk space"
        )
    notes = []
    if load.speed < SPARE * load.needed:
        notes.append(
            f"{needs}, and this disk takes hardly more ({load.speed:.0f}): watch for dropped frames, or use {hint}"
        )
    if load.cores > BUSY * load.available:
        notes.append(
            f"writing keeps {load.cores:.1f} of {load.available} cores busy: frames will be dropped; a lower --fps or a "
            "smaller --size"
        )
    return notes
