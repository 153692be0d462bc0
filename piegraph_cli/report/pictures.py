"""Pictures as data of a page: WebP in base64, and how large those of a sequence may be so that the page stays small."""

import base64
import io
import re
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

PAGE = 28_000_000
"""Bytes of pictures in a page: base64 makes a third more of them, so that a page has 40 MB at most."""
SEQUENCE = 700_000
"""Bytes of pictures of one sequence at most, however few there are."""
QUALITY = 66
_BASE64 = re.compile(r"[A-Za-z0-9+/]+={0,2}")


@dataclass(frozen=True)
class Level:
    """How much of a sequence is shown."""

    moments: int
    """Rows of the sheet of all cameras."""
    width: int
    """Of one image, pixels."""
    film: int
    """Images of the film of one camera."""
    plot: bool = True


LEVELS = (
    Level(4, 400, 30),
    Level(4, 320, 24),
    Level(3, 260, 16),
    Level(2, 220, 12),
    Level(2, 160, 6, False),
    Level(1, 120, 0, False),
)
"""From few sequences to many."""


@dataclass(frozen=True)
class Picture:
    """What a page shows of one thing: an image (WebP in base64) or a plot (SVG), what it shows in words, and how it moves."""

    kind: Literal["image", "film", "plot"]
    data: str
    alt: str
    caption: str
    width: int = 0
    height: int = 0
    """Pixels, of an image."""
    film: dict[str, Any] = field(default_factory=dict)
    """Of a film, which is a sheet of its frames: their number, its columns, and their times."""

    def plain(self) -> dict[str, Any]:
        """As it is kept."""
        return asdict(self)

    @property
    def bytes(self) -> int:
        """In the page."""
        return len(self.data)


def kept_picture(row: dict[str, Any]) -> Picture:
    """A picture that was kept. Raises `ValueError` where it is not as `plain` wrote it."""
    from piegraph_cli.report.svg import is_plain

    try:
        picture = Picture(**row)
        whole = is_plain(picture.data) if picture.kind == "plot" else _BASE64.fullmatch(picture.data) is not None
        numbers = all(type(n) is int for n in (picture.width, picture.height))
    except (TypeError, AttributeError):
        raise ValueError("not a picture") from None
    if not whole or not numbers or not isinstance(picture.alt, str) or picture.kind not in ("image", "film", "plot"):
        raise ValueError("not a picture")
    return picture


def share_of(sequences: int) -> int:
    """Bytes that the pictures of one of so many sequences may have; the same for about as many."""
    return min(SEQUENCE, PAGE // max(1 << (sequences - 1).bit_length(), 1)) if sequences else SEQUENCE


def image_picture(image: np.ndarray, alt: str, caption: str, **film: Any) -> Picture:
    """An image [H, W, 3 or 4] as a picture; a film where its frames are described."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=QUALITY, method=2)
    data = base64.b64encode(buffer.getvalue()).decode()
    return Picture("film" if film else "image", data, alt, caption, image.shape[1], image.shape[0], film)


def shrink(image: np.ndarray, width: int) -> np.ndarray:
    """An image at most `width` wide."""
    import cv2

    height, before = image.shape[:2]
    if before <= width:
        return image
    return cv2.resize(image, (width, max(1, round(height * width / before))), interpolation=cv2.INTER_AREA)


def spread(count: int, wanted: int) -> list[int]:
    """Numbers of `wanted` frames of `count`, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(int)).tolist() if wanted else []
