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
        self.boxes = {
            layer: gui.add_checkbox(layer.name, layer in viewer.on) for layer in viewer.layers if layer.listed
        }
        for layer, box in self.boxes.items():
            box.on_update(lambda _, layer=layer: self._switch(layer))
        look = gui.add_button_group("look at", ("object", "everything"))
        look.on_click(
            lambda _: viewer.post(viewer.look_at_all if look.value == "everything" else viewer.look_at_object)
        )
        self.note = gui.add_markdown("")
        viewer.on_sequence(self._tell)

    def _switch(self, layer: Layer) -> None:
        self.viewer.post(lambda: self.viewer.switch(layer, self.boxes[layer].value))

    def _tell(self) -> None:
        """What layers say of themselves, and for those that have nothing to show what to do."""
        said: dict[str, None] = {}
        for layer, box in self.boxes.items():
            why = layer.missing()
            box.disabled = bool(why)
            said |= {text: None for text in (why or layer.note,) if text}
        self.note.content = "\n\n".join(said)
