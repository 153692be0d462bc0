"""What a depth camera must be able to do to be recorded, and which ones are plugged in.

Another make of camera is a class of `DepthCamera` in a module of its own, with its `connected` in `DRIVERS`.
"""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.errors import MissingError, UsageError
from piegraph_cli.recording.camera import Camera

DRIVERS = ("piegraph_cli.capture.realsense",)
"""Modules with `connected() -> list[DepthCamera]`."""


@dataclass(frozen=True)
class Mode:
    """What a camera is asked for: size of colour (px) and frames a second."""

    width: int = 640
    height: int = 480
    fps: int = 30


@dataclass(frozen=True)
class Shot:
    """Colour and depth of one moment."""

    time: float
    """s, by the clock of this computer, which all cameras share."""
    color: np.ndarray
    """RGB uint8 [H, W, 3]."""
    depth: np.ndarray
    """uint16 [H, W], registered to colour, in units of the camera's depth scale."""


class DepthCamera(ABC):
    """A camera that gives colour and depth."""

    serial: str
    """What tells it from others of its make, also after it was plugged in anew."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        """What a user should know, since `start`."""

    @abstractmethod
    def start(self, mode: Mode) -> Camera:
        """Begin to deliver; gives intrinsics and depth scale, with the serial as name and no pose.

        Raises `UsageError` for a mode that it does not have, naming those it has, and `DataError` where it is busy.
        """

    @abstractmethod
    def read(self, timeout: float) -> Shot:
        """The next shot. Raises `DataError` where none comes within `timeout` (s)."""

    @abstractmethod
    def stop(self) -> None:
        """End; harmless where it never began."""


def connected() -> list[DepthCamera]:
    """The cameras that are plugged in, by serial number. Raises `MissingError` where there is none."""
    found = [camera for driver in DRIVERS for camera in importlib.import_module(driver).connected()]
    if not found:
        raise MissingError(
            "no camera is plugged in",
            hint="plug it into a USB 3 port; `rs-enumerate-devices` lists what the system sees, and needs librealsense's "
            "udev rules",
        )
    return sorted(found, key=lambda camera: camera.serial)


def choose(found: Sequence[DepthCamera], wanted: str | None, known: dict[str, str]) -> dict[str, DepthCamera]:
    """Cameras by name: all of them, or those of `wanted`: `2`, `SERIAL,SERIAL` or `front=SERIAL,left=SERIAL`.

    `known` are the names that serial numbers have in the recording; others are called cam0, cam1 and so on. Raises
    `UsageError` for what cannot be read, `MissingError` for cameras that are not there.
    """
    by_serial = {camera.serial: camera for camera in found}
    there = f"plugged in: {', '.join(by_serial)}"
    if wanted is None or (wanted.isdigit() and len(wanted) < 3):
        count = len(found) if wanted is None else int(wanted)
        if not 1 <= count <= len(found):
            raise MissingError(f"{count} cameras are asked for, {len(found)} found", "--cameras", there)
        ours = [serial for serial in by_serial if serial in known]
        pairs = [("", serial) for serial in [*ours, *(s for s in by_serial if s not in known)][:count]]
    else:
        pairs = [(name, serial) for name, _, serial in (part.strip().rpartition("=") for part in wanted.split(","))]
    missing = [serial for _, serial in pairs if serial not in by_serial]
    if missing:
        raise MissingError(f"camera {missing[0]} is not plugged in", "--cameras", there)
    free = (f"cam{n}" for n in range(len(pairs) + len(known)) if f"cam{n}" not in known.values())
    named = {
        name or known.get(serial) or next(free): by_serial[serial] for name, serial in sorted(pairs, key=_by_serial)
    }
    if len(named) < len(pairs) or len({serial for _, serial in pairs}) < len(pairs):
        raise UsageError(
            "two cameras have one name, or one has two", f"--cameras {wanted}", "as in front=1234,left=5678"
        )
    for name in named:
        if not name.replace("_", "").replace("-", "").isalnum():
            raise UsageError(
                f"{name!r} is no name for a camera", "--cameras", "letters, digits, - and _: it is a folder"
            )
    return named


def _by_serial(pair: tuple[str, str]) -> str:
    return pair[1]
