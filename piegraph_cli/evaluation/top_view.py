"""Cloud and particles from above and from the side, as images without a ground, for light pages and dark ones."""

from dataclasses import dataclass

import numpy as np

CLOUD, TRUE, HAND, TABLE = (140, 150, 165), (124, 132, 143), (217, 72, 15), (124, 132, 143)
SIDE = 0.28
"""Height of the side view, of the picture's width."""
BARS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Lengths (m) that the scale may show."""


@dataclass(frozen=True)
class Moment:
    """What is drawn of one frame; whatever is not known is None."""

    cloud: np.ndarray | None = None
    """[P, 3] (m)."""
    particles: np.ndarray | None = None
    """[N, 3] (m)."""
    true: np.ndarray | None = None
    """Where the particles truly are, [N, 3] (m)."""
    hand: np.ndarray | None = None
    """The hand's way up to this frame, [F, 3] (m)."""


def extent(moments: list[Moment], margin: float = 0.03) -> tuple[np.ndarray, float]:
    """Middle [2] and width (m) of a square that holds the object in all moments."""
    shown = [points for m in moments for points in (m.cloud, m.particles, m.true) if points is not None and len(points)]
    if not shown:
        return np.zeros(2), 0.5
    low, high = np.min([p[:, :2].min(0) for p in shown], 0), np.max([p[:, :2].max(0) for p in shown], 0)
    return (low + high) / 2, float((high - low).max()) + 2 * margin


def draw_moment(
    moment: Moment, colors: np.ndarray | None, middle: np.ndarray, width: float, size: int, text: str
) -> np.ndarray:
    """An RGBA image `size` wide: x to the right and y up from above, and below that x and z from the side.

    Particles have `colors` uint8 [N, 3]; rings are where they truly are. The bar is a length, the line the table.
    """
    side = round(size * SIDE)
    canvas = _Canvas(size, size + side)
    scale = size / width

    def above(points: np.ndarray) -> np.ndarray:
        return np.stack([points[:, 0] - middle[0], middle[1] - points[:, 1]], 1) * scale + size / 2

    def aside(points: np.ndarray) -> np.ndarray:
        x = (points[:, 0] - middle[0]) * scale + size / 2
        return np.stack([x, size + side * 0.8 - points[:, 2] * scale], 1)

    canvas.line((4, size + side * 0.8), (size - 4, size + side * 0.8), TABLE)
    for view in (above, aside):
        if moment.cloud is not None:
            canvas.dust(view(moment.cloud), CLOUD, 130)
        if moment.hand is not None:
            canvas.dots(view(moment.hand[np.isfinite(moment.hand).all(1)]), HAND, 1)
        if moment.true is not None:
            canvas.rings(view(moment.true), TRUE, max(size // 50, 4))
        if moment.particles is not None and colors is not None:
            canvas.dots(view(moment.particles), colors, max(size // 90, 2))
    bar = max((b for b in BARS if b * scale < size * 0.45), default=BARS[0])
    canvas.line((8, size - 8), (8 + bar * scale, size - 8), TABLE)
    canvas.write(f"{bar * 100:g} cm", 8, size - 14)
    canvas.write(text, 6, 16)
    return canvas.pixels


class _Canvas:
    """An RGBA image, empty at first. Colours reach a pixel further than the opacity, so that edges are smooth."""

    def __init__(self, width: int, height: int):
        self.pixels = np.zeros((height, width, 4), np.uint8)
        self.color, self.opacity = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint8)

    def dust(self, places: np.ndarray, color, opacity: int) -> None:
        column, row = np.rint(places).astype(int).T
        inside = (column >= 0) & (column < self.opacity.shape[1]) & (row >= 0) & (row < self.opacity.shape[0])
        self.color[row[inside], column[inside]], self.opacity[row[inside], column[inside]] = color, opacity
        self._keep()

    def dots(self, places: np.ndarray, color, radius: int) -> None:
        import cv2

        colors = np.broadcast_to(np.asarray(color, np.uint8), (len(places), 3)).tolist()
        for (x, y), of in zip(np.rint(places).astype(int).tolist(), colors, strict=True):
            cv2.circle(self.color, (x, y), radius + 1, of, -1)
            cv2.circle(self.opacity, (x, y), radius, 255, -1, cv2.LINE_AA)
        self._keep()

    def rings(self, places: np.ndarray, color, radius: int) -> None:
        import cv2

        for x, y in np.rint(places).astype(int).tolist():
            cv2.circle(self.color, (x, y), radius, color, 4)
            cv2.circle(self.opacity, (x, y), radius, 255, 1, cv2.LINE_AA)
        self._keep()

    def line(self, start, end, color) -> None:
        import cv2

        first, last = ((round(x), round(y)) for x, y in (start, end))
        cv2.line(self.color, first, last, color, 5)
        cv2.line(self.opacity, first, last, 255, 2, cv2.LINE_AA)
        self._keep()

    def write(self, text: str, x: int, y: int) -> None:
        import cv2

        cv2.putText(self.color, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, TABLE, 4)
        cv2.putText(self.opacity, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, 255, 1, cv2.LINE_AA)
        self._keep()

    def _keep(self) -> None:
        """Lay what was drawn over the picture, and begin anew."""
        seen = self.opacity > 0
        new, old = self.opacity[seen].astype(float)[:, None] / 255, self.pixels[seen].astype(float)
        total = new + old[:, 3:] / 255 * (1 - new)
        mixed = (self.color[seen] * new + old[:, :3] * old[:, 3:] / 255 * (1 - new)) / total
        self.pixels[seen] = np.rint(np.concatenate([mixed, total * 255], 1)).astype(np.uint8)
        self.color[:], self.opacity[:] = 0, 0
