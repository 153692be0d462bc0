"""The images of all cameras side by side, away from the scene, where a person clicks on pixels."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from piegraph_cli.viewer.viewer import Viewer

PLACE = np.array([0.0, 0.0, 100.0])
"""Middle of the images (m): far above the scene, so that nothing stands before them."""
FACING = (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)
"""Quaternion by which images stand upright and are seen along y."""
GAP = 0.02
"""Between images, each of which is one wide."""
ROOM = 1.15
"""How much farther one stands than it takes to see them all."""

Clicked = Callable[[int, tuple[float, float]], None]
"""Called with the camera and the pixel: column, row."""


class Desk:
    """Images of the cameras, one tile each; while it is open, clicks on them are told by camera and pixel."""

    def __init__(self, viewer: Viewer):
        self.viewer, self.scene = viewer, viewer.server.scene
        self._tell: Clicked | None = None
        self._sizes: list[tuple[int, int]] = []
        self._images: list = []
        self._before: dict[int, tuple] = {}

    def open(self, tell: Clicked) -> None:
        """Take clicks; `show` says on what."""
        if self._tell is None:
            self.scene.on_click()(self._pressed)
        self._tell = tell

    def show(self, images: Sequence[np.ndarray]) -> None:
        """Show images [H, W, 3] uint8, one of each camera."""
        sizes = [(image.shape[1], image.shape[0]) for image in images]
        if sizes != self._sizes:
            self._clear()
            self._sizes = sizes
            for c, (image, (x, z)) in enumerate(zip(images, self._middles(), strict=True)):
                place = PLACE + np.array([x, 0.0, z])
                shown = self.scene.add_image(
                    f"/desk/{c}", image, 1.0, self._height(c), wxyz=FACING, position=place, receive_shadow=False
                )
                self._images.append(shown)
        else:
            for shown, image in zip(self._images, images, strict=True):
                shown.image = image
        self.stand_before()

    def stand_before(self) -> None:
        """Bring the browsers that are not there yet before the images; `close` brings them back."""
        for number, client in self.viewer.server.get_clients().items():
            if number not in self._before and self._sizes:
                camera = client.camera
                self._before[number] = (camera.position, camera.look_at)
                camera.position, camera.look_at = PLACE - np.array([0.0, self._distance(camera), 0.0]), PLACE

    def close(self) -> None:
        """Take no clicks any more, and bring the browsers back to where they were."""
        if self._tell is not None:
            self.scene.remove_click_callback(self._pressed)
        self._tell = None
        self._clear()
        for number, client in self.viewer.server.get_clients().items():
            if number in self._before:
                client.camera.position, client.camera.look_at = self._before[number]
        self._before = {}

    def pixel(self, origin: Sequence[float], direction: Sequence[float]) -> tuple[int, tuple[float, float]] | None:
        """Which camera's image a ray meets, and in which pixel (column, row); None where it meets none."""
        start, along = np.asarray(origin, float) - PLACE, np.asarray(direction, float)
        if abs(along[1]) < 1e-9 or start[1] / along[1] >= 0:
            return None
        x, _, z = start - along * (start[1] / along[1])
        for c, ((left, up), (width, height)) in enumerate(zip(self._middles(), self._sizes, strict=True)):
            column, row = (x - left + 0.5) * width, (0.5 - (z - up) / self._height(c)) * height
            if 0 <= column < width and 0 <= row < height:
                return c, (round(column - 0.5, 1), round(row - 0.5, 1))
        return None

    def _pressed(self, event) -> None:
        met = self.pixel(event.ray_origin, event.ray_direction)
        if met is not None and self._tell is not None:
            tell = self._tell
            self.viewer.post(lambda: tell(*met))

    def _height(self, c: int) -> float:
        width, height = self._sizes[c]
        return height / width

    def _fields(self) -> tuple[int, int, float]:
        """Columns, rows, and the height of a field."""
        columns = math.ceil(math.sqrt(len(self._sizes)))
        return columns, math.ceil(len(self._sizes) / columns), max(self._height(c) for c in range(len(self._sizes)))

    def _middles(self) -> list[tuple[float, float]]:
        """Middle of each image, to the right of and above `PLACE`."""
        columns, rows, height = self._fields()
        return [
            ((k % columns - (columns - 1) / 2) * (1 + GAP), ((rows - 1) / 2 - k // columns) * (height + GAP))
            for k in range(len(self._sizes))
        ]

    def _distance(self, camera) -> float:
        columns, rows, height = self._fields()
        wide, high = columns * (1 + GAP) / 2, rows * (height + GAP) / 2
        return ROOM * max(high, wide / max(camera.aspect, 0.1)) / math.tan(camera.fov / 2)

    def _clear(self) -> None:
        self.scene.remove_by_name("/desk")
        self._sizes, self._images = [], []
