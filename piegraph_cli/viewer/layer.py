"""What a layer and a panel are: things drawn into the scene, and tabs beside it."""

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

if TYPE_CHECKING:
    from piegraph_cli.viewer.viewer import Viewer

Color = tuple[int, int, int]

PARTICLE = 0.004
"""Metres that a drawn particle is wide."""


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

    def dots(self, name: str, points: np.ndarray, color: Color, size: float = PARTICLE) -> Any:
        """Round points [N, 3] (m) of a size (m) in one colour, as a handle whose `points` can be set."""
        look = {"point_size": size, "point_shape": "circle", "precision": "float32"}
        return self.scene.add_point_cloud(f"{self.root}/{name}", points, color, **look)

    def lines(self, name: str, ends: np.ndarray, color: Color | np.ndarray, width: float = 1.5) -> Any:
        """Lines [S, 2, 3] (m) of a width in pixels, in one colour or in those of their ends [S, 2, 3]."""
        thin = {"thickness": width, "thickness_units": "screen"}
        return self.scene.add_line_segments(f"{self.root}/{name}", ends, color, **thin)

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
