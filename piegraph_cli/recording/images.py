"""Many encoded images in one byte array: what artifacts hold and the core reads, one image at a time."""

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.encoded import decode_image


def join_images(encoded: Iterable[bytes]) -> tuple[np.ndarray, np.ndarray]:
    """Encoded images to one byte array uint8 [byte] and offsets int64 [image + 1]."""
    parts = list(encoded)
    offsets = np.cumsum([0, *map(len, parts)]).astype(np.int64)
    return np.frombuffer(b"".join(parts), np.uint8), offsets


def encode_masks(masks: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Masks, bool [H, W] each, as one-bit PNG images in a byte array with offsets."""
    return join_images(encode_mask(mask) for mask in masks)


def encode_mask(mask: np.ndarray) -> bytes:
    """A mask, bool [H, W], as a one-bit PNG."""
    import cv2

    return cv2.imencode(".png", mask.astype(np.uint8) * 255, [cv2.IMWRITE_PNG_BILEVEL, 1])[1].tobytes()


def encode_depth(depth: np.ndarray) -> bytes:
    """A depth image uint16 [H, W] as PNG."""
    import cv2

    return cv2.imencode(".png", depth)[1].tobytes()


def decode_color(data: np.ndarray) -> np.ndarray:
    """Encoded bytes uint8 [byte] of a checked colour image to RGB uint8 [H, W, 3]."""
    import cv2

    return decode_image(data, cv2.IMREAD_COLOR_RGB)


class ImageStack:
    """Encoded images by frame and camera; images lie frame by frame, cameras within."""

    def __init__(self, data: np.ndarray, offsets: np.ndarray, cameras: int, what: str):
        inside = len(offsets) and offsets[0] == 0 and offsets[-1] == len(data) and (np.diff(offsets) >= 0).all()
        if not inside or (len(offsets) - 1) % cameras:
            raise DataError(
                f"the offsets of the {what} images are damaged", hint="make the artifact again with --force"
            )
        self.data, self.offsets, self.cameras, self.what = data, offsets, cameras, what

    def __len__(self) -> int:
        """Frames."""
        return (len(self.offsets) - 1) // self.cameras

    def _decode(self, frame: int, camera: int, flag: int) -> np.ndarray:
        image = frame * self.cameras + camera
        try:
            return decode_image(self.data[self.offsets[image] : self.offsets[image + 1]], flag)
        except ValueError as error:
            message = f"{self.what} image of frame {frame}, camera {camera} cannot be decoded: {error}"
            raise DataError(message, hint="ingest again") from None

    def has(self, frame: int, camera: int) -> bool:
        """Whether there is such an image."""
        image = frame * self.cameras + camera
        return bool(self.offsets[image + 1] > self.offsets[image])

    def color(self, frame: int, camera: int) -> np.ndarray:
        """RGB uint8 [H, W, 3]."""
        import cv2

        return self._decode(frame, camera, cv2.IMREAD_COLOR_RGB)

    def grey(self, frame: int, camera: int) -> np.ndarray:
        """Grey uint8, a quarter as wide and high as the colour image."""
        import cv2

        return self._decode(frame, camera, cv2.IMREAD_REDUCED_GRAYSCALE_4)

    def depth(self, frame: int, camera: int) -> np.ndarray:
        """Depth uint16 [H, W] in the camera's units, 0 for no reading."""
        import cv2

        return self._decode(frame, camera, cv2.IMREAD_UNCHANGED)

    def mask(self, frame: int, camera: int) -> np.ndarray:
        """Mask bool [H, W]."""
        import cv2

        return self._decode(frame, camera, cv2.IMREAD_GRAYSCALE) > 0

    def of_camera(self, camera: int, kind: Literal["color", "depth", "mask"] = "color") -> "CameraImages":
        """One camera's images as a sequence indexed by frame."""
        return CameraImages(self, camera, kind)


class CameraImages(Sequence):
    """One camera's decoded images, indexed by frame; the last one is kept, since it is often asked for again."""

    def __init__(self, stack: ImageStack, camera: int, kind: str):
        self.stack, self.camera, self.read = stack, camera, getattr(stack, kind)
        self.last: tuple[int, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self.stack)

    def __getitem__(self, frame):
        if not 0 <= frame < len(self):
            raise IndexError(frame)
        if self.last is None or self.last[0] != frame:
            self.last = (frame, self.read(frame, self.camera))
        return self.last[1]
