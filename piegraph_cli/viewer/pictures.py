"""Images of a sequence at the size in which they are shown, decoded when a frame is looked at."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.overlays import draw_mask
from piegraph_cli.recording.camera import Camera
from piegraph_cli.viewer.source import Sequence

WIDTH = 320
"""Pixels that a shown image has at least; it is reduced by 2, 4 or 8 while it stays as wide."""


@dataclass(frozen=True)
class Picture:
    """What one camera saw, reduced."""

    camera: Camera
    image: np.ndarray
    """[H, W, 3] uint8, RGB."""
    mask: np.ndarray | None
    """[H, W] bool, the object; None where there are no masks."""
    reduced: int
    """How many pixels of the camera a pixel is wide."""

    @cached_property
    def drawn(self) -> np.ndarray:
        """[H, W, 3] uint8: the image with the mask, where there is one; not to be written to."""
        return self.image if self.mask is None else draw_mask(self.image, self.mask)


class Pictures:
    """The pictures of a sequence. What was decoded last is kept: several layers ask for one frame."""

    def __init__(self, sequence: Sequence):
        self.sequence = sequence
        self._kept: tuple[int, list[Picture]] = (-1, [])

    def at(self, frame: int) -> list[Picture]:
        """The pictures of a frame, a camera each; none where there are no frames."""
        if self._kept[0] != frame:
            self._kept = frame, list(self._decoded(frame))
        return self._kept[1]

    def _decoded(self, frame: int) -> Iterator[Picture]:
        import cv2

        flags = {1: cv2.IMREAD_COLOR_RGB, 2: cv2.IMREAD_REDUCED_COLOR_2}
        flags |= {4: cv2.IMREAD_REDUCED_COLOR_4, 8: cv2.IMREAD_REDUCED_COLOR_8}
        for c, camera in enumerate(self.sequence.cameras):
            reduced = max((by for by in flags if camera.width >= by * WIDTH), default=1)
            data = self.sequence.encoded("color", frame, c)
            image = None if data is None else cv2.imdecode(data, flags[reduced])
            if image is None:
                message = f"the colour image of frame {frame}, camera {camera.name} cannot be decoded"
                raise DataError(message, str(self.sequence.opened.folder), "piegraph ingest --force")
            if reduced > 1:  # the reduced flags of this OpenCV give blue first
                image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            yield Picture(camera, image, self._mask(frame, c, reduced, image.shape), reduced)

    def _mask(self, frame: int, camera: int, reduced: int, shape: tuple[int, ...]) -> np.ndarray | None:
        import cv2

        data = self.sequence.encoded("mask", frame, camera)
        mask = None if data is None else cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        if mask is None:
            return None
        return cv2.resize(mask, shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
