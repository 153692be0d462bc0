"""Image messages to what frames hold: colour as JPEG or PNG, depth as uint16 in units of the camera's depth scale."""

import struct
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.encoded import MOST_PIXELS, decode_image

QUALITY = 95
"""Of JPEG images made of raw ones."""
FLOAT_SCALE = 0.00025
"""Metres per unit into which float depth is turned: 16.4 m at most."""
MILLIMETRES = 0.001
COLORS = ("rgb8", "bgr8", "rgba8", "bgra8", "mono8", "8UC1", "8UC3", "yuv422", "uyvy", "yuv422_yuy2", "yuyv")
DEPTHS = {"16UC1": np.uint16, "mono16": np.uint16, "Z16": np.uint16, "32FC1": np.float32}
TO_BGR = {
    "rgb8": "COLOR_RGB2BGR",
    "rgba8": "COLOR_RGBA2BGR",
    "bgra8": "COLOR_BGRA2BGR",
    "yuv422": "COLOR_YUV2BGR_UYVY",
    "uyvy": "COLOR_YUV2BGR_UYVY",
    "yuv422_yuy2": "COLOR_YUV2BGR_YUYV",
    "yuyv": "COLOR_YUV2BGR_YUYV",
}
PNG = b"\x89PNG"


def is_depth(encoding: str) -> bool:
    """Whether an encoding, or the format of a compressed image, is of depth."""
    return encoding.split(";")[0].strip() in DEPTHS or "compressedDepth" in encoding


def encoded_color(message: Any, where: str) -> tuple[bytes, tuple[int, int]]:
    """A colour message as JPEG or PNG bytes, and its width and height (px). Raises `DataError` for what is none."""
    import cv2

    if hasattr(message, "format"):
        data = message.data.tobytes()
        return data, decoded(data, cv2.IMREAD_COLOR, where).shape[1::-1]
    if message.encoding not in COLORS:
        raise _unknown(message.encoding, where, COLORS)
    channels = {"rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1}.get(message.encoding, 2)
    image = _pixels(message, np.dtype(np.uint8), channels, where)
    if message.encoding in TO_BGR:
        image = cv2.cvtColor(np.ascontiguousarray(image), getattr(cv2, TO_BGR[message.encoding]))
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
    return data, image.shape[1::-1]


def decoded(data: bytes, flag: int, where: str) -> np.ndarray:
    """The image of encoded bytes."""
    try:
        return decode_image(data, flag)
    except ValueError as error:
        raise DataError(f"the image cannot be decoded: {error}", where, "export the recording again") from None


def depth_scale(encoding: str) -> float:
    """Metres per unit of what `depth_units` gives, for that encoding."""
    return FLOAT_SCALE if encoding.startswith("32FC1") else MILLIMETRES


def depth_units(message: Any, where: str) -> np.ndarray:
    """A depth message as uint16 [H, W] in units of `depth_scale`, 0 for no reading. Raises `DataError` for what is none."""

    if hasattr(message, "format"):
        return _compressed_depth(message, where)
    if message.encoding not in DEPTHS:
        raise _unknown(message.encoding, where, tuple(DEPTHS))
    kind = np.dtype(DEPTHS[message.encoding]).newbyteorder(">" if message.is_bigendian else "<")
    image = _pixels(message, kind, 1, where)
    return _units(image, where) if kind.kind == "f" else image.astype(np.uint16)


def _compressed_depth(message: Any, where: str) -> np.ndarray:
    """Depth in a PNG, plain or behind the header of `compressedDepth`, whose float images hold inverse depth."""
    import cv2

    data = message.data.tobytes()
    quantised = None
    if not data.startswith(PNG):
        if data[12:16] != PNG:
            raise _unknown(message.format or "an empty format", where, ("PNG", "compressedDepth png"))
        quantised, data = struct.unpack("<ff", data[4:12]), data[12:]
    image = decoded(data, cv2.IMREAD_UNCHANGED, where)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(f"depth must be a one-channel 16-bit image, got {image.dtype} {image.shape}", where)
    if quantised is None or not message.format.startswith("32FC1"):
        return image
    a, b = quantised
    with np.errstate(divide="ignore", invalid="ignore"):
        return _units(np.where(image > 0, a / (image - np.float64(b)), np.nan), where)


def _units(metres: np.ndarray, where: str) -> np.ndarray:
    """Float depth (m) in units of `FLOAT_SCALE`; what is not finite, or too far, is no reading."""
    known = np.isfinite(metres) & (metres > 0)
    far = known & (metres > np.iinfo(np.uint16).max * FLOAT_SCALE)
    if known.any() and far.sum() > 0.5 * known.sum():
        middle = float(np.median(metres[known]))
        raise DataError(f"depth is {middle:.0f} m: are these millimetres?", where, "32FC1 is metres: write 16UC1 else")
    with np.errstate(invalid="ignore"):
        return np.where(known & ~far, np.rint(metres / FLOAT_SCALE), 0).astype(np.uint16)


def _pixels(message: Any, kind: np.dtype, channels: int, where: str) -> np.ndarray:
    """The pixels [H, W] or [H, W, channels] of a raw image, held against what the message says of itself."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * kind.itemsize
    if not 0 < width * height <= MOST_PIXELS or step < row or len(message.data) < step * height:
        size = f"{width} x {height} pixels, {step} bytes a row, {len(message.data)} bytes"
        raise DataError(f"image of {size} does not hold together", where, "export the recording again")
    rows = np.asarray(message.data[: step * height]).reshape(height, step)[:, :row]
    image = np.ascontiguousarray(rows).view(kind)
    return image.reshape(height, width, channels) if channels > 1 else image.reshape(height, width)


def _unknown(encoding: str, where: str, known: tuple[str, ...]) -> DataError:
    return DataError(
        f"encoding {encoding!r} cannot be read", where, f"republish the topic as one of {', '.join(known)}"
    )
