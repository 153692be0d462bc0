"""A goal that is made by hand of an object's particles: moved, turned and bent on the table."""

import numpy as np

from piegraph_cli.physics.bending import bend, bent_by
from piegraph_cli.physics.rigid import moved_in_plane
from piegraph_cli.physics.springs import build_springs, farthest_point_sample

REACH = 2.2
"""Spacings of the particles up to which springs join them."""
MUCH, MORE = 1.3, 0.004
"""A goal is bent further than the object was seen beyond so many times that, and so many metres."""


class GoalShape:
    """Particles `start` [N, 3] (m) as they are, and `points` [N, 3] (m) where they shall be."""

    def __init__(self, start: np.ndarray):
        self.start = np.asarray(start, np.float32)
        near = np.linalg.norm(self.start[:, None] - self.start[None], axis=-1)
        spacing = float(np.sort(near, axis=1)[:, 1].mean()) if len(start) > 1 else 1.0
        self.pairs = build_springs(self.start, REACH * max(spacing, 1e-4)).pairs
        self.points = self.start.copy()
        self.held: dict[int, np.ndarray] = {}
        """Where on the table [2] (m) particles are held, by number."""

    def controls(self, count: int) -> np.ndarray:
        """Particles [count] to take hold of, spread over the object."""
        end = int(((self.start - self.start.mean(0)) ** 2).sum(1).argmax())
        return farthest_point_sample(self.start, min(count, len(self.start)), end)

    def move(self, points: np.ndarray, middle: np.ndarray, x: float, y: float, yaw: float) -> None:
        """Take `points` [N, 3] turned by yaw (rad) about `middle` [2] and then shifted by x, y (m)."""
        self.points = points.copy()
        turned = moved_in_plane(points[:, :2] - middle, np.array([x, y, yaw]))
        self.points[:, :2] = turned + middle
        self.held = {}

    def drag(self, particle: int, place: np.ndarray) -> None:
        """Bring a particle to a place [2] (m); those that were dragged before stay, or the farthest one of all at first."""
        if not self.held:
            far = int(((self.points - self.points[particle]) ** 2).sum(1).argmax())
            self.held[far] = self.points[far, :2].copy()
        self.held[particle] = np.asarray(place, float)
        numbers = np.array(list(self.held))
        self.points = bend(self.start, self.pairs, numbers, np.array(list(self.held.values())), self.points)

    def bent(self) -> float:
        """How far (m) the goal is from the object as it is, moved rigidly."""
        return bent_by(self.start, self.points)

    def doubt(self, seen: np.ndarray) -> str:
        """A word on a goal that is bent further than the object was in any of the states `seen` [F, N, 3] (m)."""
        most = max((bent_by(self.start, state) for state in seen), default=0.0)
        if self.bent() <= MUCH * most + MORE:
            return ""
        return (
            f"the goal is bent by {1000 * self.bent():.0f} mm; in this sequence the object never was by more than "
            f"{1000 * most:.0f} mm: can it be bent like that?"
        )
