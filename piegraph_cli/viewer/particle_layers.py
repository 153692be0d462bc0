"""Layers of what was tracked: particles and springs."""

from typing import ClassVar

import numpy as np

from piegraph_cli.evaluation.figures import particle_colors
from piegraph_cli.viewer.layer import Layer


class Particles(Layer):
    """The tracked particles."""

    name: ClassVar[str] = "particles"
    needs: ClassVar[tuple[str, ...]] = ("tracks",)

    def open(self) -> None:
        """Colours by place at the start, so that turning shows."""
        self.tracks = self.viewer.sequence.get("tracks")
        first = self.tracks.row("positions", 0)
        self.points = self.scene.add_point_cloud(
            f"{self.root}/points", first, np.asarray(particle_colors(first)), point_size=0.004, precision="float32"
        )

    def draw(self, frame: int) -> None:
        """Move them."""
        self.points.points = self.tracks.row("positions", frame)
