"""What a layer and a panel are: things drawn into the scene, and tabs beside it."""

from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from piegraph_cli.viewer.viewer import Viewer


class Layer:
    """One thing of the scene that a person switches on and off.

    The viewer calls all of these on its own thread: `open` when a sequence is opened and the layer is on, `draw` at each frame,
    `clear` when it is switched off or the sequence is left. Scene names begin with `self.root`.
    """

    name: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    """Artifacts of the sequence without which there is nothing to draw: the checkbox is off then, and says why."""
    shown: ClassVar[bool] = True
    """Whether it is on at the start."""
    listed: ClassVar[bool] = True
    """Whether the tab of layers has a box for it; a panel of its own switches it otherwise."""
    note: str = ""
    """What a person should know of what is drawn: a legend, what was left out."""

    def __init__(self, viewer: "Viewer"):
        self.viewer = viewer
        self.scene = viewer.server.scene
        self.root = f"/{self.name.replace(' ', '_')}"

    def missing(self) -> str:
        """Why there is nothing to draw, with the next command; empty where there is."""
        return self.viewer.sequence.missing(*self.needs)

    def open(self) -> None:
        """Make what the sequence needs once."""

    def draw(self, frame: int) -> None:
        """Draw a frame of the viewer's sequence."""

    def clear(self) -> None:
        """Take everything of this layer out of the scene."""
        self.scene.remove_by_name(self.root)


class Panel:
    """One tab beside the scene. Made once, inside its tab; its callbacks hand their work to `viewer.post`."""

    title: ClassVar[str]
    left: ClassVar[bool] = False
    """Whether it stands at the left, under each other with all of these, and not in a tab at the right."""

    def __init__(self, viewer: "Viewer"):
        """Make the elements of the tab; `viewer.on_sequence` and `viewer.on_frame` tell of changes."""
        self.viewer = viewer
