"""The tab by which layers are switched on and off."""

from typing import ClassVar

from piegraph_cli.viewer.layer import Layer, Panel
from piegraph_cli.viewer.viewer import Viewer


class LayerPanel(Panel):
    """A checkbox per layer, and beside those that have nothing to show the command that makes it."""

    title: ClassVar[str] = "See"

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        gui = viewer.server.gui
        self.boxes = {layer: gui.add_checkbox(layer.name, layer in viewer.on) for layer in viewer.layers}
        for layer, box in self.boxes.items():
            box.on_update(lambda _, layer=layer: self._switch(layer))
        self.note = gui.add_markdown("")
        viewer.on_sequence(self._tell_missing)

    def _switch(self, layer: Layer) -> None:
        self.viewer.post(lambda: self.viewer.switch(layer, self.boxes[layer].value))

    def _tell_missing(self) -> None:
        said = {}
        for layer, box in self.boxes.items():
            why = layer.missing()
            box.disabled = bool(why)
            if why:
                said[why] = None
        self.note.content = "\n\n".join(said)
