"""Encoded images, JPEG and PNG alone: what they say of their size is looked at before they are decoded."""

import struct

import numpy as np

MOST_PIXELS = 1 << 26
"""Of one image."""
MOST_BYTES = 1 << 28
"""Of one image's file."""
POINTER = b"version https://git-lfs"
"""How a file begins that Git LFS left in place of the real one."""
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"


def decode_image(data: "bytes | np.ndarray", flag: int) -> np.ndarray:
    """The image of encoded bytes, as `cv2.imdecode` gives it with that flag. Raises `ValueError` that says what is wrong."""
    import cv2

    view = memoryview(data)  # type: ignore[arg-type]
    size = declared_size(view)
    if size is None:
        if bytes(view[: len(POINTER)]) == POINTER:
            raise ValueError("it is a pointer of Git LFS in place of the file: git lfs pull")
        raise ValueError("it is empty" if not len(view) else "it is neither JPEG nor PNG")
    width, height = size
    if not 0 < width * height <= MOST_PIXELS:
        raise ValueError(f"it says that it is {width} x {height}, at most {MOST_PIXELS} pixels are read")
    if view[:8] == _PNG and not _chunks_fit(view):
        raise ValueError("it is cut off, or its parts do not fit together")
    try:
        image = cv2.imdecode(np.frombuffer(view, np.uint8), flag)
    except cv2.error as error:
        raise ValueError(str(error).strip().splitlines()[0]) from None
    if image is None:
        raise ValueError("it is cut off or damaged")
    return image


def declared_size(data: memoryview) -> tuple[int, int] | None:
    """Width and height by the header of a JPEG or PNG; None of what is neither."""
    if data[:8] == _PNG and len(data) >= 24 and data[12:16] == b"IHDR":
        return struct.unpack(">II", data[16:24])
    return _jpeg_size(data) if data[:3] == _JPEG else None


def _chunks_fit(data: memoryview) -> bool:
    """Whether the parts of a PNG lie in it up to its end: as much as a part says that it has is taken of memory first."""
    place = 8
    while place + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[place : place + 8])
        place += 12 + length
        if kind == b"IEND":
            return place <= len(data)
    return False


def _jpeg_size(data: memoryview) -> tuple[int, int] | None:
    """Of the first frame header: markers follow each other, each with the length of what belongs to it."""
    place = 2
    while place + 9 <= len(data):
        if data[place] != 0xFF:
            return None
        marker = data[place + 1]
        if marker in (0xFF, 0x01) or 0xD0 <= marker <= 0xD8:  # filling, and markers without a length
            place += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[place + 5 : place + 9])
            return width, height
        place += 2 + struct.unpack(">H", data[place + 2 : place + 4])[0]
    return None
