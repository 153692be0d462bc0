"""Things that the workspace cuts: whether it does, and which box would hold them."""

from collections.abc import Callable, Sequence

import numpy as np

from piegraph_cli.perception.parts import CELL, Part

WIDER = 0.5
"""How far (m) beyond the workspace it is looked for the rest of a thing."""
ROOM = 0.1
"""Room (m) that the box to give leaves around a thing."""

Finder = Callable[[np.ndarray], Sequence[Part]]
"""The parts of a frame inside a workspace [3, 2] (m)."""


def widened(workspace: np.ndarray) -> np.ndarray:
    """A workspace [3, 2] (m) that goes farther to all sides."""
    wider = np.array(workspace, float)
    wider[:2] += [-WIDER, WIDER]
    return wider


def told_cut(part: Part, workspace: np.ndarray, parts_within: Finder) -> list[str]:
    """A warning where a part reaches the workspace's edge, with the box that would hold all of it."""
    if not part.at_edge:
        return []
    wide = max(parts_within(widened(workspace)), key=lambda one: _shared(one, part), default=None)
    x, y = part.centre
    where = f"the object at x, y = ({x:+.2f}, {y:+.2f}) m reaches the workspace's edge: what lies beyond is not seen"
    if wide is None or _shared(wide, part) == 0 or wide.at_edge:
        return [f"{where}\n  try: a larger ingest.workspace"]
    return [f"{where}\n  try: ingest.workspace = {as_setting(box_to_hold(wide, workspace))} would hold it"]


def box_to_hold(part: Part, workspace: np.ndarray) -> np.ndarray:
    """The workspace [3, 2] (m), grown so that a part lies inside with room around it."""
    places = np.argwhere(part.away == 0) * CELL + part.low
    box = np.array(workspace, float)
    box[:2, 0] = np.minimum(box[:2, 0], np.floor((places.min(axis=0) - ROOM) * 20) / 20)
    box[:2, 1] = np.maximum(box[:2, 1], np.ceil((places.max(axis=0) + CELL + ROOM) * 20) / 20)
    return box


def as_setting(workspace: np.ndarray) -> str:
    """A workspace [3, 2] (m) as it is given on the command line."""
    return ",".join(f"{value:g}" for value in workspace.round(3).ravel())


def _shared(one: Part, other: Part) -> int:
    """How many pixels two parts share."""
    return sum(int((a & b).sum()) for a, b in zip(one.masks, other.masks, strict=True))
