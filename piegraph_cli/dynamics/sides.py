"""From where on an object its strokes were recorded, and which side of it none of them tells of."""

import math
from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.poses import seen_from
from piegraph_cli.dynamics.rigid_body import body_frame, pose_now
from piegraph_cli.dynamics.stroke import Strokes

ONE_SIDE = math.pi
"""Strokes that leave an angle of this or more around the object where none begins come from one side of it (rad)."""


@dataclass(frozen=True)
class Recorded:
    """Strokes as they were recorded, seen from the object."""

    shape: np.ndarray
    """[N, 2] metres: the particles of the first sequence at rest, about their middle: the object's own frame."""
    size: float
    """Their radius of gyration (m)."""
    poses: np.ndarray
    """[S, 3] of the object before each stroke (m, rad)."""
    seen: np.ndarray
    """[S, 5] as of `on_object`."""

    @classmethod
    def of(cls, data: Sequences) -> "Recorded":
        """Those of some sequences."""
        shape = np.asarray(data.rest[0], float)[:, :2]
        shape = shape - shape.mean(0)
        size = float(np.sqrt(np.square(shape).sum(1).mean()))
        frames = [body_frame(rest, shape) for rest in data.rest]
        before = data.positions[data.strokes[:, 0]]
        poses = np.array([pose_now(data.rest[o], x, frames[o]) for o, x in zip(data.owner, before, strict=True)])
        poses = poses.reshape(-1, 3)
        return cls(shape, size, poses, on_object(data.whole(), poses, size))


def on_object(strokes: Strokes, poses: np.ndarray, size: float) -> np.ndarray:
    """Start, end and mode of strokes [B] as seen from the object at poses [B, 3] (m, rad): [B, 5], in sizes (m) of it."""
    at, ends = torch.as_tensor(poses), strokes.ends.double()
    start, end = (seen_from(at, points) / size for points in ends.unbind(1))
    return np.column_stack([start, end, strokes.mode])


def untouched(seen: np.ndarray) -> tuple[float, float] | None:
    """The middle (rad, in the object's frame) and width (rad) of the largest angle in which no stroke begins.

    `seen` [K, 5] as of `on_object`; None where strokes come from all around, and where there is none.
    """
    around = np.sort(np.arctan2(seen[:, 1], seen[:, 0]))
    if not len(around):
        return None
    gaps = np.diff(np.append(around, around[0] + 2 * math.pi))
    widest = int(gaps.argmax())
    if gaps[widest] < ONE_SIDE:
        return None
    middle = math.remainder(around[widest] + gaps[widest] / 2, 2 * math.pi)
    return middle, float(gaps[widest])


def open_side(seen: np.ndarray, turned: float, when: str) -> list[str]:
    """Words on the side of an object that strokes [K, 5] leave open; `turned`: how it lies (rad) `when`."""
    gap = untouched(seen)
    if gap is None:
        return []
    toward = np.degrees(gap[0] + turned) % 360
    return [
        f"all {len(seen)} recorded strokes begin on one side of the object, none in the {np.degrees(gap[1]):.0f} degrees "
        f"around its other side, which {when} {toward:.0f} degrees (from x to y): how it moves when it is pushed from "
        "there is not determined"
    ]
