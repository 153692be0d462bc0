"""The images of all cameras at the time line's frame, side by side."""

from typing import ClassVar

import numpy as np

from piegraph_cli.evaluation.overlays import label, tile
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.viewer import Viewer


class ImagePanel(Panel):
    """Two images in a row, each with its camera's name and the object's mask."""

    title: ClassVar[str] = "Images"
    left: ClassVar[bool] = True

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        gui = viewer.server.gui
        self.image = gui.add_image(np.full((8, 8, 3), 255, np.uint8), jpeg_quality=80, visible=False)
        self.note = gui.add_markdown("", visible=False)
        viewer.on_sequence(self._sequence_changed)
        viewer.on_frame(self._frame_changed)

    def _sequence_changed(self) -> None:
        why = self.viewer.sequence.missing("frames", "masks")
        self.note.content, self.note.visible = why, bool(why)
        self.image.visible = bool(self.viewer.sequence.cameras)

    def _frame_changed(self) -> None:
        pictures = self.viewer.pictures.at(self.viewer.frame)
        if pictures:
            images = [label(picture.drawn.copy(), picture.camera.name, 0.8) for picture in pictures]
            self.image.image = tile([images[k : k + 2] for k in range(0, len(images), 2)])
