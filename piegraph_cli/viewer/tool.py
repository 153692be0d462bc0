"""What a person sets by hand: one tool for each thing that can be set, of which one at a time is in hand."""

from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import numpy as np

from piegraph_cli.errors import PiegraphError
from piegraph_cli.recording.images import decode_color
from piegraph_cli.viewer.desk import Desk
from piegraph_cli.viewer.viewer import Viewer

Found = TypeVar("Found")


class Tool:
    """Elements in a folder of the tab, and what happens in the scene while the tool is in hand.

    The viewer calls all of these on its own thread.
    """

    name: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    """Artifacts of the sequence without which there is nothing to do."""

    def __init__(self, viewer: Viewer, desk: Desk):
        """Make the elements; they are shown while the tool is in hand."""
        self.viewer, self.desk, self.gui = viewer, desk, viewer.server.gui

    def missing(self) -> str:
        """Why there is nothing to do, with the next command; empty where there is."""
        return self.viewer.sequence.missing(*self.needs)

    def take(self) -> None:
        """The tool was taken in hand, or another sequence opened."""

    def frame_changed(self) -> None:
        """Another frame is shown."""

    def lay_down(self) -> None:
        """Take everything of the tool out of the scene."""

    def look_up(self, work: Callable[[], Found], then: Callable[[Found], None], told: Any) -> None:
        """Do what takes long on another thread; `then` gets what was found, `told` says what was wrong."""

        def tried() -> Found | PiegraphError:
            try:
                return work()
            except PiegraphError as error:
                return error

        def finish(found: Found | PiegraphError) -> None:
            if isinstance(found, PiegraphError):
                told.content = str(found).replace("\n", "\n\n")
            else:
                then(found)

        self.viewer.behind(tried, finish)

    def pictures(self, frame: int) -> list[np.ndarray]:
        """The colour images [H, W, 3] of all cameras at a frame, to be drawn on; grey where there is none."""
        sequence, found = self.viewer.sequence, []
        for c, camera in enumerate(sequence.cameras):
            data = sequence.encoded("color", frame, c)
            grey = np.full((camera.height, camera.width, 3), 128, np.uint8)
            found.append(grey if data is None else decode_color(data))
        return found
