"""The time line: run, sequence, frame, play and speed."""

import time

from piegraph_cli.viewer.viewer import Viewer

SPEEDS = ("0.25", "0.5", "1", "2", "4", "8")


class Timeline:
    """The elements above the tabs, and the clock that plays."""

    def __init__(self, viewer: Viewer):
        self.viewer = viewer
        gui = viewer.server.gui
        folders = [str(opened.folder) for opened in viewer.runs]
        self.run = gui.add_dropdown("run", folders, visible=len(folders) > 1)
        self.sequence = gui.add_dropdown("sequence", ["-"])
        self.frame = gui.add_slider("frame", min=0, max=1, step=1, initial_value=0)
        self.play = gui.add_button("play")
        self.speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
        self.now = gui.add_markdown("")
        self.playing = False
        self._began = (0.0, 0.0)
        self.run.on_update(lambda _: viewer.post(self._open_run))
        self.sequence.on_update(lambda _: viewer.post(self._open_sequence))
        self.frame.on_update(self._moved)
        self.play.on_click(lambda _: viewer.post(self._press))
        self.speed.on_update(lambda _: viewer.post(self._begin))
        viewer.on_sequence(self._sequence_changed)
        viewer.on_frame(self._frame_changed)
        viewer.on_tick(self._tick)

    def _open_run(self) -> None:
        opened = next(opened for opened in self.viewer.runs if str(opened.folder) == self.run.value)
        if opened is not self.viewer.opened:
            self.viewer.open(opened, opened.names[0] if opened.names else "")

    def _open_sequence(self) -> None:
        if self.sequence.value not in ("-", self.viewer.sequence.name):
            self.viewer.open(self.viewer.opened, self.sequence.value)

    def _moved(self, event) -> None:
        """A person moved the slider; what the viewer itself set is no wish."""
        if event.client is not None:
            self.viewer.show(int(self.frame.value))
            self.viewer.post(self._begin)

    def _press(self) -> None:
        self.playing = not self.playing
        self.play.label = "pause" if self.playing else "play"
        if self.playing and self.viewer.frame == len(self.viewer.sequence) - 1:
            self.viewer.show(0)
        self.viewer.post(self._begin)

    def _begin(self) -> None:
        """Play from where the time line stands."""
        if len(self.viewer.sequence):
            self._began = (time.monotonic(), float(self.viewer.sequence.time[self.viewer.frame]))

    def _tick(self) -> None:
        sequence = self.viewer.sequence
        if not self.playing or not len(sequence):
            return
        began, at = self._began
        now = at + (time.monotonic() - began) * float(self.speed.value)
        frame = int(sequence.time.searchsorted(now, "right")) - 1
        if frame >= len(sequence) - 1:
            self._press()
        if frame != self.viewer.frame:
            self.viewer.show(frame)

    def _sequence_changed(self) -> None:
        viewer = self.viewer
        self.sequence.options = tuple(viewer.opened.names) or ("-",)
        self.sequence.value = viewer.sequence.name or "-"
        self.frame.max = max(1, len(viewer.sequence) - 1)
        self.frame.disabled = self.play.disabled = not len(viewer.sequence)
        self._begin()

    def _frame_changed(self) -> None:
        viewer = self.viewer
        self.frame.value = viewer.frame
        if len(viewer.sequence):
            self.now.content = f"{viewer.sequence.time[viewer.frame]:.2f} s of {viewer.sequence.time[-1]:.2f} s"
