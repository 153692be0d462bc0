"""The tab by which a person sets what the program cannot know: prompts, true spots and goals."""

from typing import ClassVar

from piegraph_cli.viewer.desk import Desk
from piegraph_cli.viewer.goal_tool import GoalTool
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.prompt_tool import PromptTool
from piegraph_cli.viewer.spot_tool import SpotTool
from piegraph_cli.viewer.tool import Tool
from piegraph_cli.viewer.viewer import Viewer

NOTHING = "nothing"


class HandPanel(Panel):
    """One tool at a time is in hand; its elements are shown then."""

    title: ClassVar[str] = "Set"

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        gui, desk = viewer.server.gui, Desk(viewer)
        kinds: tuple[type[Tool], ...] = (PromptTool, SpotTool, GoalTool)
        self.choice = gui.add_dropdown("set", (NOTHING, *(kind.name for kind in kinds)))
        self.why = gui.add_markdown("")
        self.tools: dict[str, Tool] = {}
        self.folders = {}
        for kind in kinds:
            self.folders[kind.name] = gui.add_folder(kind.name, visible=False)
            with self.folders[kind.name]:
                self.tools[kind.name] = kind(viewer, desk)
        self.in_hand: Tool | None = None
        self.choice.on_update(lambda _: viewer.post(self._take))
        self.of: tuple[object, str] | None = None
        viewer.on_sequence(self._sequence_changed)
        viewer.on_frame(self._frame_changed)

    def _take(self) -> None:
        """Lay down what is in hand, and take what is chosen, if the sequence has what it needs."""
        if self.in_hand is not None:
            self.in_hand.lay_down()
        wanted = self.tools.get(self.choice.value)
        why = wanted.missing() if wanted else ""
        self.in_hand = None if why else wanted
        self.why.content = why
        for name, folder in self.folders.items():
            folder.visible = self.tools[name] is self.in_hand
        if self.in_hand is not None:
            self.in_hand.take()

    def _sequence_changed(self) -> None:
        """Begin anew with another sequence; what is not kept yet of the same one, read again, stays in hand."""
        of, before = (self.viewer.opened.folder, self.viewer.sequence.name), self.of
        self.of = of
        if of != before or self.in_hand is None or self.in_hand.missing():
            self._take()

    def _frame_changed(self) -> None:
        if self.in_hand is not None:
            self.in_hand.frame_changed()
