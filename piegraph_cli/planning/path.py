"""The whole way of the tool around a stroke: down to the object, the stroke, away from it; and boxes it keeps out of."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.params import PICK
from piegraph_cli.planning.params import PlanParams

WAY_POINTS = 6
"""Of a pick; a push has one less."""
LIFT = 0.05
"""Metres that a pick lifts what it has grasped, as in the simulated environments."""
LET_GO = 0.01
"""Metres above where it was grasped at which it is let go."""
PUSH_PARTS = ("approach", "approach", "stroke", "retreat", "retreat")
PICK_PARTS = ("approach", "approach", "stroke", "stroke", "stroke", "retreat")
"""What each way point ends."""


@dataclass(frozen=True)
class Path:
    """Way points of the tool's tip, between which it goes straight; the table is z = 0."""

    points: np.ndarray
    """[W, 3] metres."""
    times: np.ndarray
    """[W] seconds since it was above the start."""
    closed: np.ndarray
    """[W] bool: whether a gripper holds what it has grasped from there on."""


def tool_path(ends: np.ndarray, mode: int, before: np.ndarray, params: PlanParams) -> Path:
    """The path of a stroke from and to `ends` [2, 2] (m) on an object with particles `before` [N, 3] (m).

    A push goes at half of the object's height, then back along itself by `retreat`, so that the tool leaves the object
    before it rises. A pick grasps at the height of the particle it is at, lifts, carries, and lets go a little higher.
    Neither goes below the table, whatever noise says of the particles.
    """
    start, end = ends.astype(float)
    high = params.approach_height
    if mode == PICK:
        low = max(0.0, float(before[np.linalg.norm(before[:, :2] - start, axis=1).argmin(), 2]))
        heights = [high, low, low + LIFT, low + LIFT, low + LET_GO, high]
        places, closed = [start] * 3 + [end] * 3, [False, True, True, True, False, False]
    else:
        low = tip_height(before)
        along = (end - start) / np.linalg.norm(end - start)
        back = end - params.retreat * along
        heights, places = [high, low, low, low, high], [start, start, end, back, back]
        closed = [False] * len(heights)
    points = np.column_stack([np.array(places), heights])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) / params.speed
    return Path(points, np.concatenate([[0.0], np.cumsum(steps)]), np.array(closed))


def tip_height(particles: np.ndarray) -> float:
    """How high (m) the tip pushes an object [N, 3] (m): at half of its height."""
    return max(0.0, top_of(particles) / 2)


def top_of(particles: np.ndarray) -> float:
    """How high (m) above the table an object [N, 3] (m) reaches, but for single particles."""
    return float(np.percentile(particles[:, 2], 95))


def hits(start: torch.Tensor, end: torch.Tensor, picks: torch.Tensor, boxes: torch.Tensor) -> torch.Tensor:
    """Whether the tool on its way from start to end [B, 2] (m) meets one of the boxes [K, 5]: [B].

    A box is xmin, xmax, ymin, ymax (m) of the tool's middle, and zmax (m): the tool stands upright above its tip, so that
    what reaches higher than the tip is hit. `picks` [B] are carried over what is lower than `LIFT`.
    """
    along = (end - start)[:, None]
    low, high = boxes[None, :, 0:4:2], boxes[None, :, 1:4:2]
    along = torch.where(along.abs() < 1e-9, 1e-9, along)
    one, other = (low - start[:, None]) / along, (high - start[:, None]) / along
    enter, leave = torch.minimum(one, other).amax(-1), torch.maximum(one, other).amin(-1)
    passes = (enter <= leave) & (leave >= 0) & (enter <= 1)
    down = ((enter <= 0) & (leave >= 0)) | ((enter <= 1) & (leave >= 1))
    over = picks[:, None] & (boxes[None, :, 4] < LIFT)
    return ((passes & ~over) | (down & passes)).any(-1)


def tool_boxes(keep_out: Sequence[Sequence[float]], radius: float) -> torch.Tensor:
    """Boxes (xmin, xmax, ymin, ymax, zmin, zmax (m)) as `hits` takes them, for the middle of a tool of that radius (m)."""
    rows = [[b[0] - radius, b[1] + radius, b[2] - radius, b[3] + radius, b[5]] for b in keep_out if b[5] > 0]
    return torch.tensor(rows, dtype=torch.float32).reshape(-1, 5)
