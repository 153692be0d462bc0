"""The hand: its skeleton, and the end-effector with the way it came."""

from typing import ClassVar

import numpy as np

from piegraph_cli.evaluation.overlays import BONES, HAND_COLOR
from piegraph_cli.viewer.arrays import NO_LINES, NO_POINTS, segments
from piegraph_cli.viewer.layer import Layer
from piegraph_cli.workspace.slices import Slices

FREE, TOUCHING, WAY = (255, 150, 0), (220, 30, 30), (255, 190, 120)
TIP = 0.009
"""Metres that the end-effector is wide."""
WAY_SECONDS = 2.0
"""How long the way behind the end-effector is."""


class Hand(Layer):
    """Bones between the 21 joints where a hand was seen; the end-effector, red while it touches the object."""

    name: ClassVar[str] = "hand"

    def missing(self) -> str:
        """Whatever tells where the end-effector is will do."""
        return "" if self._path() is not None else self.viewer.sequence.missing("hands", "tracks")

    def _path(self) -> Slices | None:
        """The artifact that has its path; tracks and clouds tell of contact too."""
        found = (self.viewer.sequence.get(name) for name in ("tracks", "clouds", "hands"))
        return next((one for one in found if one is not None), None)

    def open(self) -> None:
        """Read the path, which is short, and make what moves."""
        path = self._path()
        assert path is not None
        self.hands = self.viewer.sequence.get("hands")
        self.way = path["end_effector"]
        self.contact = path["contact"] if "contact" in path else np.zeros(len(path), bool)
        self.bones = self.lines("bones", NO_LINES, HAND_COLOR, 3.0)
        self.trail = self.lines("way", NO_LINES, WAY, 3.0)
        self.joints = self.dots("joints", NO_POINTS, HAND_COLOR)
        self.tip = self.dots("tip", NO_POINTS, FREE, TIP)

    def draw(self, frame: int) -> None:
        """Move skeleton, end-effector and way."""
        joints = np.full((21, 3), np.nan) if self.hands is None else self.hands.row("keypoints", frame)
        self.bones.points = segments(joints, BONES)
        self.joints.points = joints[np.isfinite(joints).all(1)]
        tip = self.way[frame : frame + 1]
        self.tip.points = tip[np.isfinite(tip).all(1)]
        self.tip.colors = np.array(TOUCHING if self.contact[frame] else FREE, np.uint8)
        time = self.viewer.sequence.time
        way = self.way[time.searchsorted(time[frame] - WAY_SECONDS) : frame + 1]
        steps = np.arange(max(0, len(way) - 1))
        self.trail.points = segments(way, np.stack([steps, steps + 1], 1))
