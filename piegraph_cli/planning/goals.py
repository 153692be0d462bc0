"""Where an object shall be: its particles there, or a cloud, in which its own shape is looked for."""

from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.physics.association import align
from piegraph_cli.physics.particles import chamfer
from piegraph_cli.physics.rigid import moved_in_plane, planar_fit

GOAL_POINTS = 2_000
"""A goal cloud of more is thinned to these: what is planned does not depend on how densely a camera sees."""
COARSE = 200
"""Points with which one cloud is laid on another, before the best places are refined."""
FINE = 600
"""Points with which they are refined."""
YAWS = 12
"""Turns to begin with."""
SHARPENED = 4
"""Best places that are refined."""
ROUNDS = 30
"""Of the refinement."""
SAME_SHAPE, MARGIN = 1.5, 0.004
"""Two clouds have one shape whose chamfer distance is below so many times that of the goal's own halves, and so many metres."""
AS_GOOD = 1.15
"""A place counts beside the best one whose distance is below so many times its own, or than is expected of the true place."""
APART = 0.02
"""Metres between points of places that are not the same: what lies nearer to a better place is laid less well."""


@dataclass(frozen=True)
class Goal:
    """Where the object shall be."""

    points: np.ndarray
    """[G, 3] metres."""
    particles: np.ndarray | None = None
    """[K, N, 3] metres: the object's particles in every pose that is the goal; None where only the cloud is known."""

    @classmethod
    def of_particles(cls, particles: np.ndarray) -> "Goal":
        """The object's particles [N, 3] (m), one by one."""
        return cls(particles, particles[None])

    @classmethod
    def of_cloud(cls, goal: np.ndarray, cloud: np.ndarray, particles: np.ndarray, rigid: bool = False) -> "Goal":
        """A goal cloud [G, 3] for an object that is seen as `cloud` [P, 3] now, with `particles` [N, 3] (m).

        Where the goal shows the very shape of now, moved, the particles are known in it: in several poses, if the object is
        symmetric. Where it is bent otherwise they are not; but what is `rigid` is then taken to lie where it fits best, for
        cameras on one side see other parts of it here than there.
        """
        goal = thinned(goal, GOAL_POINTS).astype(np.float32)
        cloud = thinned(cloud, GOAL_POINTS).astype(np.float32)
        grain = _grain(goal)
        # halves are sparser than wholes: so near should the whole clouds be, points at random on one surface
        expected = grain * (np.sqrt(1 / 2) + np.sqrt(len(goal) / 2 / len(cloud))) / 2
        moved = _places(cloud, goal, np.asarray(particles, np.float32), grain, float(expected), rigid)
        return cls(goal, moved if len(moved) else None)

    @classmethod
    def at(cls, pose: tuple[float, float, float], rest: np.ndarray, cloud: np.ndarray, particles: np.ndarray) -> "Goal":
        """The pose x, y (m), yaw (rad) of an object with rest shape `rest` [N, 3] (m): its middle lies at x, y, turned by
        yaw from how `rest` lies. The object is seen as `cloud` [P, 3] now, with `particles` [N, 3] (m).

        Where the object has its rest shape now, its particles are known in the goal, as in `of_cloud`.
        """
        cloud = thinned(cloud, GOAL_POINTS).astype(np.float32)
        placed = _posed(rest, pose)
        seen, chosen, own = (_flat(points) for points in (cloud, particles, rest))  # a camera sees no underside
        near = chamfer(chosen, seen)
        there = _places(own, seen, own, near, near)
        motions = [planar_fit(now[:, :2], placed[:, :2]) for now in there]
        moved = [np.column_stack([moved_in_plane(particles[:, :2], m), particles[:, 2]]) for m in motions]
        found = np.array(_distinct(moved), np.float32).reshape(-1, *particles.shape)
        return cls(found[0] if len(found) else placed, found if len(found) else None)


def thinned(points: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the points [P, 3], at random but always the same, in their order."""
    if len(points) <= most:
        return points
    return points[np.sort(np.random.default_rng(0).choice(len(points), most, replace=False))]


def move_in_plane(points: np.ndarray, motion: tuple[float, float, float]) -> np.ndarray:
    """Points [N, 3] (m) turned by DYAW (rad) about their centre and moved by DX, DY (m)."""
    centre = points[:, :2].mean(0)
    moved = points.copy()
    moved[:, :2] = moved_in_plane(points[:, :2] - centre, np.array(motion)) + centre
    return moved.astype(np.float32)


def _posed(rest: np.ndarray, pose: tuple[float, float, float]) -> np.ndarray:
    """A rest shape [N, 3] (m) turned by a pose's yaw (rad) about its middle, which then lies at its x, y (m)."""
    planar = moved_in_plane(rest[:, :2] - rest[:, :2].mean(0), np.array(pose))
    return np.column_stack([planar, rest[:, 2]]).astype(np.float32)


def _flat(points: np.ndarray) -> np.ndarray:
    """Points [N, 3] (m) as seen from above, at z = 0."""
    return (points * [1, 1, 0]).astype(np.float32)


def _grain(goal: np.ndarray) -> float:
    """Chamfer distance (m) of the halves of a cloud [G, 3]: how near two clouds of one thing can be."""
    half = np.random.default_rng(1).permutation(len(goal))
    return chamfer(goal[half[::2]], goal[half[1::2]]) if len(goal) > 3 else 0.0


def _places(
    cloud: np.ndarray, goal: np.ndarray, particles: np.ndarray, grain: float, expected: float, rigid: bool = False
) -> np.ndarray:
    """The particles [K, N, 3] in each place in which the cloud [P, 3] lies on the goal [G, 3]; none where it does not.

    What is `rigid` lies where it does best.

    `grain` (m) says how coarse the goal is, `expected` (m) which chamfer distance these clouds have where one lies on the
    other.
    """
    few, there = thinned(cloud, COARSE), thinned(goal, COARSE)
    tries = []
    for yaw in np.arange(YAWS) * (2 * np.pi / YAWS):
        turned = move_in_plane(few, (*(goal.mean(0) - few.mean(0))[:2], float(yaw)))
        tries.append(_laid(turned, there))
    tries.sort(key=lambda rough: chamfer(rough, there))
    tries = _distinct(tries)[:SHARPENED]
    many, where = thinned(cloud, FINE), thinned(goal, FINE)
    found = []
    for rough in tries:
        sharp = _laid(_carried(few, rough, many), where, ROUNDS)
        # along a thin thing nearest points hardly pull: there the middles of whole clouds know better
        for placed in (sharp, sharp + (goal.mean(0) - _carried(many, sharp, cloud).mean(0))):
            found.append((chamfer(_carried(many, placed, cloud), goal), _carried(many, placed, particles)))
    found.sort(key=lambda entry: entry[0])
    good = [
        placed
        for apart, placed in found
        if apart <= min(SAME_SHAPE * grain + MARGIN, AS_GOOD * max(expected, found[0][0]))
    ]
    if rigid and not good:
        good = [found[0][1]]
    return np.array(_distinct(good), np.float32).reshape(-1, *particles.shape)


def _distinct(places: list[np.ndarray]) -> list[np.ndarray]:
    """Those of places [P, 3] (m) of the same points that are not near an earlier one."""
    kept: list[np.ndarray] = []
    for placed in places:
        if all(np.linalg.norm(placed - other, axis=1).mean() > APART for other in kept):
            kept.append(placed)
    return kept


def _laid(points: np.ndarray, goal: np.ndarray, rounds: int = 10) -> np.ndarray:
    """Points [P, 3] turned about the vertical and shifted onto a goal [G, 3], without regard to normals."""
    ours, theirs = (torch.nn.functional.pad(torch.as_tensor(side), (0, 3)) for side in (points, goal))
    every = torch.ones(len(points), dtype=torch.bool)
    return align(ours, theirs, every, len(goal), upright=True, rounds=rounds)[:, :3].numpy()


def _carried(source: np.ndarray, target: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [N, 3] under the motion of the plane, and the lift, that took `source` [P, 3] nearest to `target` [P, 3].

    What lies on a table turns about the vertical alone; a thin thing would also roll, which no cloud shows.
    """
    pose = planar_fit(source[:, :2], target[:, :2])
    lift = target[:, 2].mean() - source[:, 2].mean()
    return np.column_stack([moved_in_plane(points[:, :2], pose), points[:, 2] + lift]).astype(np.float32)
