"""What every reader makes of one camera in one sequence: its images, however they are kept, with their time stamps."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.layout import read_color, read_depth


class Images(Protocol):
    """One camera's images in their order; what is wrong with one raises `DataError` naming file, camera and frame."""

    def color(self, k: int) -> bytes:
        """A colour image as JPEG or PNG, of the camera's size."""

    def depth(self, k: int) -> tuple[np.ndarray, bytes | None]:
        """Depth as it was recorded, uint16 [H, W] in units of the camera's depth scale, and the PNG it was kept as, if any."""

    def mask(self, k: int) -> np.ndarray | None:
        """The object's mask, bool [H, W] of colour's size, where the recording has one."""


@dataclass(frozen=True)
class Film:
    """One camera's images of a sequence, with their time stamps."""

    camera: Camera
    times: np.ndarray
    """[image] s, rising."""
    images: Images
    numbers: np.ndarray
    """[image] what each is called by in the recording."""

    def depth(self, k: int) -> tuple[np.ndarray, bytes | None]:
        """As `Images.depth`, the largest number that its pixels hold being no reading: some programs write holes so."""
        image, encoded = self.images.depth(k)
        endless = image == np.iinfo(image.dtype).max
        return (np.where(endless, 0, image).astype(image.dtype), None) if endless.any() else (image, encoded)


@dataclass(frozen=True)
class ImageFiles:
    """Images in files of their own: colour as JPEG or PNG, depth as 16-bit PNG; no masks."""

    camera: Camera
    files: Sequence[tuple[Path, Path]]
    """Colour and depth of each image."""

    def color(self, k: int) -> bytes:
        """The file's bytes."""
        return read_color(self.files[k][0], self.camera)

    def depth(self, k: int) -> tuple[np.ndarray, bytes | None]:
        """The image, and the file's bytes."""
        path = self.files[k][1]
        return read_depth(path, self.camera), path.read_bytes()

    def mask(self, k: int) -> np.ndarray | None:
        """None."""
        return None


class Scene(NamedTuple):
    """What the cameras see at one time: the first arguments of `look`."""

    color: list[np.ndarray]
    """RGB uint8 [H, W, 3] of each camera."""
    depth: list[np.ndarray]
    """uint16 [H, W] of each camera, registered to colour, in units of its depth scale."""
    cameras: list[Camera]
