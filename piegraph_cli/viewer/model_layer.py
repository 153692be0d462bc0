"""What models predict at the end of the present stroke, beside what was tracked there."""

from typing import Any, ClassVar

import numpy as np

from piegraph_cli.evaluation.colors import model_color
from piegraph_cli.viewer.arrays import NO_LINES, NO_POINTS, rgb, segments, spring_graph
from piegraph_cli.viewer.layer import Layer
from piegraph_cli.viewer.rollouts import Rollouts

TRACKED, TRACKED_COLOR = "tracked", "#141414"


class Predictions(Layer):
    """Particles and springs that each chosen model predicts, in its colour, and those tracked, in black.

    The panel of models gives `rollouts`, `horizon` and the labels that are `hidden`.
    """

    name: ClassVar[str] = "predictions"
    needs: ClassVar[tuple[str, ...]] = ("tracks",)
    shown: ClassVar[bool] = False
    listed: ClassVar[bool] = False
    rollouts: Rollouts | None = None
    horizon = 1
    hidden: frozenset[str] = frozenset()

    def open(self) -> None:
        """Springs are those of the first frame."""
        tracks = self.viewer.sequence.get("tracks")
        assert tracks is not None
        self.pairs = spring_graph(tracks.row("positions", 0)).pairs
        self.states: dict[str, tuple[Any, Any]] = {}

    def draw(self, frame: int) -> None:
        """Draw the end of the stroke that goes on at a frame."""
        rolled = self.rollouts
        if rolled is None:
            return
        stroke = rolled.stroke(frame)
        shown = {TRACKED: rolled.after[stroke]}
        if rolled.known(stroke, self.horizon):
            labels = [label for label in rolled.predicted if label not in self.hidden]
            shown |= {label: rolled.at(label, stroke, self.horizon) for label in labels}
        for label in {*shown, *self.states}:
            self._draw_state(label, shown.get(label))

    def _draw_state(self, label: str, state: np.ndarray | None) -> None:
        if label not in self.states:
            self.states[label] = self._made(label)
        points, springs = self.states[label]
        points.points = NO_POINTS if state is None else state
        springs.points = NO_LINES if state is None else segments(state, self.pairs)

    def _made(self, label: str) -> tuple[Any, Any]:
        color = rgb(TRACKED_COLOR if label == TRACKED else model_color(label))
        root = str(len(self.states))
        return self.dots(f"{root}/points", NO_POINTS, color), self.lines(f"{root}/springs", NO_LINES, color)
