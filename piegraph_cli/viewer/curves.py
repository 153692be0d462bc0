"""Errors over time, as curves with a line where the time line stands."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from piegraph_cli.evaluation.colors import GOAL, OBJECT
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.source import Sequence
from piegraph_cli.viewer.viewer import Viewer

MOST_PLACES = 1000
"""Places along the time axis; of longer sequences each place has the largest of its frames."""

BLOCK = 256
"""Frames that are read at a time."""

TOUCHED = "rgba(220, 30, 30, 0.13)"
EXPECTED, NOW = "#7c848f", "#111111"


def true_errors(sequence: Sequence) -> np.ndarray | None:
    """How far the tracked particles are from the true ones in each frame [F] (mm), or None where these are not known."""
    tracks, scores = sequence.get("tracks"), sequence.get("scores")
    if tracks is None or scores is None or scores.lengths["true_frame"] != len(tracks):
        return None
    errors = np.zeros(len(tracks))
    for first in range(0, len(errors), BLOCK):
        where = first, min(first + BLOCK, len(errors))
        apart = tracks.rows("positions", *where) - scores.rows("true_positions", *where)
        errors[slice(*where)] = np.linalg.norm(apart, axis=-1).mean(1) * 1000
    return errors


def shortened(values: np.ndarray, count: int = MOST_PLACES) -> np.ndarray:
    """At most `count` values of [F]: the largest of as many frames in a row."""
    size = -(-len(values) // count)
    padded = np.concatenate([values, np.repeat(values[-1:], -len(values) % size)])
    with np.errstate(all="ignore"):
        return np.fmax.reduce(padded.reshape(-1, size), axis=1)


def with_line(
    time: np.ndarray, curves: list[np.ndarray], now: float, top: float, dots: bool = False
) -> tuple[np.ndarray, ...]:
    """Data of a plot: times [T + 2], each curve with two more values at `now`, and a line from 0 to `top` there.

    Curves that are `dots` have no values between those that they have.
    """
    at = int(time.searchsorted(now))
    between = [np.nan if dots else np.interp(now, time, curve, left=np.nan, right=np.nan) for curve in curves]
    more = [np.insert(curve, at, [value, value]) for curve, value in zip(curves, between, strict=True)]
    line = np.full(len(time) + 2, np.nan)
    line[at : at + 2] = 0, top
    return np.insert(time, at, [now, now]), *more, line


class Curves:
    """One plot: curves by name over time, in their colours, and the line of the time line."""

    def __init__(self, viewer: Viewer, unit: str, dots: bool = False):
        self.viewer, self.unit, self.dots = viewer, unit, dots
        self.top, self.time, self.curves = 1.0, np.zeros(2), [np.zeros(2)]
        empty = tuple(with_line(self.time, [], 0.0, 1.0))
        self.plot = viewer.server.gui.add_uplot(empty, ({}, {}), aspect=1.6, visible=False)

    def set(self, time: np.ndarray, curves: Mapping[str, tuple[np.ndarray, str]], touched: np.ndarray) -> None:
        """Show curves (values [T], colour) over times [T]; `touched` [T] shades where the hand touches the object."""
        known = [values[np.isfinite(values)] for values, _ in curves.values()]
        self.top = 1.1 * max((float(values.max()) for values in known if len(values)), default=1.0) or 1.0
        shade = [np.where(touched, self.top, 0.0)] if touched.any() else []
        self.time, self.curves = time, [*shade, *(values for values, _ in curves.values())]
        dots = {"show": self.dots, "size": 6}
        series: list[dict[str, Any]] = [{"label": "time"}]
        if shade:
            series += [{"label": "touched", "fill": TOUCHED, "width": 0, "points": {"show": False}}]
        series += [
            {"label": name, "stroke": color, "width": 0 if self.dots else 2, "points": dots | {"fill": color}}
            for name, (_, color) in curves.items()
        ]
        series += [{"label": "now", "stroke": NOW, "width": 1.5, "points": {"show": False}}]
        with self.viewer.server.atomic():
            self.plot.data = self._data()
            self.plot.series = tuple(series)
            self.plot.scales = {"x": {"time": False, "range": (0.0, self._end())}, "y": {"range": (0.0, self.top)}}
            self.plot.axes = ({"label": "s", "labelSize": 16}, {"size": 44})
            self.plot.title = self.unit
            self.plot.legend = {"live": False}
            self.plot.visible = bool(curves)

    def move(self) -> None:
        """Move the line to the time line's frame."""
        if self.plot.visible:
            self.plot.data = self._data()

    def _end(self) -> float:
        time = self.viewer.sequence.time
        return float(time[-1]) if len(time) else 1.0

    def _data(self) -> tuple[np.ndarray, ...]:
        time = self.viewer.sequence.time
        now = float(time[self.viewer.frame]) if len(time) else 0.0
        return tuple(with_line(self.time, self.curves, now, self.top, self.dots))


class CurvePanel(Panel):
    """What tracking expects to be off, what it left over, and how far it truly was off, where that is known."""

    title: ClassVar[str] = "Errors"
    left: ClassVar[bool] = True

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        self.note = viewer.server.gui.add_markdown("")
        self.curves = Curves(viewer, "tracking error [mm]")
        viewer.on_sequence(self._sequence_changed)
        viewer.on_frame(self.curves.move)

    def _sequence_changed(self) -> None:
        sequence = self.viewer.sequence
        self.note.content = sequence.missing("tracks")
        self.note.visible = bool(self.note.content)
        self.curves.plot.visible = False
        if sequence.get("tracks") is not None:
            self.viewer.behind(lambda: _errors(sequence), self._set)

    def _set(self, found: tuple[np.ndarray, dict[str, tuple[np.ndarray, str]], np.ndarray]) -> None:
        self.curves.set(*found)


def _errors(sequence: Sequence) -> tuple[np.ndarray, dict[str, tuple[np.ndarray, str]], np.ndarray]:
    """Times, curves and contact of a sequence, short enough for a plot."""
    tracks = sequence.get("tracks")
    assert tracks is not None
    curves = {"residual": (tracks["residual"] * 1000.0, OBJECT)}
    if "trust/doubt" in tracks:
        curves["expected"] = (tracks["trust/doubt"] * 1000.0, EXPECTED)
    true = true_errors(sequence)
    if true is not None:
        curves["true"] = (true, GOAL)
    short: Callable[[np.ndarray], np.ndarray] = lambda values: shortened(np.asarray(values, float))  # noqa: E731
    return (
        short(sequence.time),
        {name: (short(values), color) for name, (values, color) in curves.items()},
        short(tracks["contact"]) > 0,
    )
