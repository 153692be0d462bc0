"""What models predict at the end of the present stroke, beside what was tracked there."""

from typing import Any, ClassVar

import numpy as np

from piegraph_cli.evaluation.colors import model_color
from piegraph_cli.evaluation.metrics import SHAPE_RADIUS
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.viewer.arrays import NO_LINES, NO_POINTS, rgb, segments
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
        self.pairs = build_springs(tracks.row("positions", 0), SHAPE_RADIUS).pairs
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
        root = f"{self.root}/{len(self.states)}"
        look = {"point_size": 0.004, "point_shape": "circle", "precision": "float32"}
        points = self.scene.add_point_cloud(f"{root}/points", NO_POINTS, color, **look)
        thin = {"thickness": 1.5, "thickness_units": "screen"}
        return points, self.scene.add_line_segments(f"{root}/springs", NO_LINES, color, **thin)
