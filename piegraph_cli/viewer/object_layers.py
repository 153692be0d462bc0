"""Layers of the object: the cloud, the tracked particles with their springs, and where these truly were."""

from typing import ClassVar

import numpy as np

from piegraph_cli.evaluation.colors import GOAL
from piegraph_cli.viewer.arrays import (
    MOST_POINTS,
    NO_LINES,
    NO_POINTS,
    UNKNOWN,
    cloud_colors,
    rgb,
    segments,
    spring_graph,
    strain_colors,
    strain_of,
    thinned,
)
from piegraph_cli.viewer.layer import Layer

TRACKED = (20, 20, 20)
TRUE = rgb(GOAL)


class Cloud(Layer):
    """The fused cloud in the colours of the images; grey where these are not there."""

    name: ClassVar[str] = "cloud"
    needs: ClassVar[tuple[str, ...]] = ("clouds",)

    def open(self) -> None:
        """Read where the frames begin."""
        clouds = self.viewer.sequence.get("clouds")
        assert clouds is not None
        self.clouds, self.offsets = clouds, clouds["offsets"]
        self.points = self.scene.add_point_cloud(
            f"{self.root}/points", NO_POINTS, UNKNOWN, point_size=0.002, point_shape="square", point_shading="flat"
        )
        most = int(np.diff(self.offsets).max(initial=0))
        self.note = f"clouds of up to {most:,} points are thinned to {MOST_POINTS:,}" if most > MOST_POINTS else ""

    def draw(self, frame: int) -> None:
        """Draw the points of a frame."""
        points = thinned(self.clouds.rows("points", *map(int, self.offsets[frame : frame + 2])))
        self.points.points = points
        if len(points):  # no colours are none that the browser takes
            self.points.colors = cloud_colors(points, self.viewer.pictures.at(frame))


class Particles(Layer):
    """The tracked particles, and springs coloured by strain."""

    name: ClassVar[str] = "particles"
    needs: ClassVar[tuple[str, ...]] = ("tracks",)
    note = "springs: blue shorter, grey at rest, red longer, full at 10 %"

    def open(self) -> None:
        """Springs are those of the first frame, where the object is at rest."""
        tracks = self.viewer.sequence.get("tracks")
        assert tracks is not None
        self.tracks, first = tracks, tracks.row("positions", 0)
        self.graph = spring_graph(first)
        self.points = self.dots("points", first, TRACKED)
        lines = segments(first, self.graph.pairs)
        self.springs = self.lines("springs", lines, np.zeros_like(lines), 2.0)

    def draw(self, frame: int) -> None:
        """Move them."""
        positions = self.tracks.row("positions", frame)
        strain = strain_of(positions, self.graph.pairs, self.graph.rest_length)
        self.points.points = positions
        self.springs.points = segments(positions, self.graph.pairs)
        self.springs.colors = np.repeat(strain_colors(strain)[:, None], 2, axis=1)


class Truth(Layer):
    """Where the tracked particles truly were, with a line from each that was tracked."""

    name: ClassVar[str] = "true particles"
    needs: ClassVar[tuple[str, ...]] = ("tracks", "scores")
    shown: ClassVar[bool] = False

    def missing(self) -> str:
        """A real recording is scored too, without a truth."""
        scores = self.viewer.sequence.get("scores")
        if scores is not None and not scores.lengths["true_frame"]:
            return "true particles: this recording has no `truth.h5`"
        return super().missing()

    def open(self) -> None:
        """Make what moves."""
        sequence = self.viewer.sequence
        self.tracks, self.scores = sequence.get("tracks"), sequence.get("scores")
        self.points = self.dots("points", NO_POINTS, TRUE)
        self.errors = self.lines("errors", NO_LINES, TRUE, 2.0)

    def draw(self, frame: int) -> None:
        """Move them."""
        assert self.tracks is not None
        assert self.scores is not None
        true = self.scores.row("true_positions", frame)
        self.points.points = true
        self.errors.points = np.stack([self.tracks.row("positions", frame), true], 1)
