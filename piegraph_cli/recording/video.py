"""Colour images within a video, decoded one after the other."""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.encoded import MOST_PIXELS

QUALITY = 95
"""Of the JPEG images that are made of a video's frames."""


class VideoFrames:
    """A video's frames by number, from 0; quick where they are asked for in order."""

    def __init__(self, path: Path, camera: str):
        self.path, self.camera = path, camera
        self._open()

    def _open(self) -> None:
        import cv2

        self._video, self._next = cv2.VideoCapture(str(self.path)), 0
        if not self._video.isOpened():
            raise DataError(
                f"video of camera {self.camera} cannot be read", str(self.path), "copy it again; is it cut?"
            )
        width, height = self.size
        if width * height > MOST_PIXELS:
            message = f"video of camera {self.camera} says that it is {width} x {height}"
            raise DataError(message, str(self.path), f"at most {MOST_PIXELS} pixels are read")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        import cv2

        return int(self._video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(self._video.get(cv2.CAP_PROP_FRAME_HEIGHT))

    def image(self, frame: int) -> np.ndarray:
        """A frame as BGR uint8 [H, W, 3]. Raises `DataError` naming camera and frame where the video ends before it."""
        if frame < self._next:
            self._open()
        while self._next < frame and self._video.grab():
            self._next += 1
        found, image = self._video.read() if self._next == frame else (False, None)
        if not found or image is None:
            message = f"the video of camera {self.camera} ends at frame {self._next}, frame {frame} is missing"
            raise DataError(message, str(self.path), "copy it again, or remove the depth images after it")
        self._next += 1
        return image

    def encoded(self, frame: int) -> bytes:
        """A frame as JPEG."""
        import cv2

        flags = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
        return cv2.imencode(".jpg", self.image(frame), flags)[1].tobytes()
