"""The tab of models: which are shown, how many strokes in a row they predict, and how far off they are."""

from typing import Any, ClassVar

import numpy as np

from piegraph_cli.errors import PiegraphError
from piegraph_cli.evaluation.colors import model_color
from piegraph_cli.viewer.curves import Curves
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.model_layer import TRACKED_COLOR, Predictions
from piegraph_cli.viewer.rollouts import Rollouts, add_models, strokes_of
from piegraph_cli.viewer.viewer import Viewer


def swatch(color: str) -> str:
    """A square of a colour, in HTML."""
    return f'<span style="display:inline-block;width:0.8em;height:0.8em;background:{color};margin-right:0.4em"></span>'


class ModelPanel(Panel):
    """A checkbox per model, the horizon, a table of errors at the present stroke, and errors over all strokes."""

    title: ClassVar[str] = "Models"

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        gui = viewer.server.gui
        self.layer = viewer.layer(Predictions)
        self.note = gui.add_markdown("")
        self.show = gui.add_checkbox("show predictions", self.layer.shown, visible=False)
        self.horizon = gui.add_slider("horizon", 1, 2, 1, 1, hint="strokes predicted in a row", visible=False)
        self.folder = gui.add_folder(None)
        self.table = gui.add_html("", visible=False)
        self.curves = Curves(viewer, "error at the end of a stroke [mm]", dots=True)
        self.boxes: dict[str, Any] = {}
        self.show.on_update(lambda _: viewer.post(lambda: viewer.switch(self.layer, self.show.value)))
        self.horizon.on_update(lambda _: viewer.post(self._chosen))
        viewer.on_sequence(self._sequence_changed)
        viewer.on_frame(self._tell)
        viewer.on_frame(self.curves.move)

    def _sequence_changed(self) -> None:
        for box in self.boxes.values():
            box.remove()
        self.boxes, self.layer.rollouts = {}, None
        self.show.visible = self.horizon.visible = self.table.visible = self.curves.plot.visible = False
        self.note.content = self._missing() or "predicting ..."
        if not self._missing():
            run, name = self.viewer.opened.run, self.viewer.sequence.name
            self.viewer.behind(lambda: self._found(run, name), self._start)

    def _missing(self) -> str:
        """Why there is nothing to predict, and the next command."""
        opened = self.viewer.opened
        if not self.viewer.sequence.name:
            return "no sequence"
        if not opened.run.path("dataset", None).exists():
            return opened.absent("dataset")
        return ""

    def _found(self, run: Any, name: str) -> Any:
        try:
            return strokes_of(run, name)
        except PiegraphError as error:
            return str(error)

    def _start(self, found: Any) -> None:
        if isinstance(found, str):
            self.note.content = found
            return
        rollouts, sequence = found
        viewer, of = self.viewer, self.viewer.sequence
        self.layer.rollouts, self.show.visible = rollouts, True
        self.horizon.max = max(rollouts.longest, 2)
        self.horizon.visible = rollouts.longest > 1
        self.layer.horizon = min(self.layer.horizon, rollouts.longest)
        self.horizon.value = self.layer.horizon

        def work() -> None:
            add_models(
                rollouts, sequence, viewer.opened.run, lambda: viewer.sequence is of, lambda: viewer.post(self._added)
            )

        viewer.behind(work, lambda _: self._ended())

    def _added(self) -> None:
        """Show models that were predicted with since."""
        rolled = self.layer.rollouts
        if rolled is None:
            return
        for label in rolled.predicted:
            if label not in self.boxes:
                with self.folder:
                    self.boxes[label] = self.viewer.server.gui.add_checkbox(label, label not in self.layer.hidden)
                self.boxes[label].on_update(lambda _: self.viewer.post(self._chosen))
        self._chosen()

    def _ended(self) -> None:
        rolled = self.layer.rollouts
        assert rolled is not None
        said = [f"{label}: {why}" for label, why in rolled.failed.items()]
        if not rolled.predicted:
            said.append(self.viewer.opened.absent("model"))
        self.note.content = "\n\n".join(said)

    def _chosen(self) -> None:
        """Follow the slider and the boxes."""
        rolled = self.layer.rollouts
        if rolled is None:
            return
        self.layer.horizon = min(int(self.horizon.value), rolled.longest)
        self.layer.hidden = frozenset(label for label, box in self.boxes.items() if not box.value)
        self.viewer.draw_again(self.layer)
        self._tell()
        self._draw_curves(rolled)

    def _tell(self) -> None:
        """The table at the present stroke."""
        rolled = self.layer.rollouts
        if rolled is None or not rolled.predicted:
            return
        stroke, horizon = rolled.stroke(self.viewer.frame), self.layer.horizon
        head = f"stroke {stroke + 1} of {len(rolled.frames)}, {horizon} predicted in a row"
        rows = [f"<tr><td>{swatch(TRACKED_COLOR)}tracked</td><td></td></tr>"]
        for label in self.boxes:
            error = rolled.error(label, stroke, horizon) * 1000
            told = f"{error:.1f} mm" if np.isfinite(error) else "-"
            rows.append(
                f'<tr><td>{swatch(model_color(label))}{label}</td><td style="text-align:right">{told}</td></tr>'
            )
        table = f'<table style="width:100%">{"".join(rows)}</table>'
        self.table.content = f'<div style="padding:0 0.8em;font-size:0.85em">{head}{table}</div>'
        self.table.visible = True

    def _draw_curves(self, rolled: Rollouts) -> None:
        time = self.viewer.sequence.time
        strokes = range(len(rolled.frames))
        ends = time[rolled.frames[:, 1].clip(max=len(time) - 1)]
        curves = {
            label: (
                np.array([rolled.error(label, s, self.layer.horizon) for s in strokes]) * 1000,
                model_color(label),
            )
            for label in rolled.predicted
            if label not in self.layer.hidden
        }
        self.curves.set(ends, curves, np.zeros(len(ends), bool))
