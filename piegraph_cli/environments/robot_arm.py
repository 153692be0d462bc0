"""What cameras see of a robot that pushes: a round rod, the flange that holds it, and the arm it hangs from; no motion."""

import numpy as np

from piegraph_cli.environments.render import HAND, Part

BASE = np.array([-0.75, 0.05, 0.45])
"""Where the arm comes from, metres: beyond the workspace, at the table's -x side."""
_ROD, _FLANGE, _WRIST = 0.13, 0.05, 0.035
"""Length of the rod, height and radius of the flange, metres."""
_LINK = 0.045
"""Radius of the arm, metres."""
_STEEL, _WHITE = np.array([[0.30, 0.31, 0.33]]), np.array([[0.62, 0.63, 0.64]])
_SIDES = 16


def arm_parts(tip: np.ndarray, radius: float) -> list[Part]:
    """The arm with the rod's lower end at `tip` [3] (m); `radius` (m) of the rod."""
    top = tip + np.array([0, 0, _ROD])
    wrist = top + np.array([0, 0, _FLANGE])
    return [
        _cylinder(tip, top, radius, _STEEL),
        _cylinder(top, wrist, _WRIST, _STEEL),
        _cylinder(wrist, np.maximum(BASE, [-np.inf, -np.inf, wrist[2]]), _LINK, _WHITE),
    ]


def _cylinder(start: np.ndarray, end: np.ndarray, radius: float, color: np.ndarray) -> Part:
    """A closed cylinder from start [3] to end [3] (m), linear RGB [1, 3]."""
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, [0.0, 1.0, 0.0] if abs(along[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    turn = np.arange(_SIDES) * 2 * np.pi / _SIDES
    ring = radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(along, side))
    vertices = np.concatenate([start + ring, end + ring, [start, end]])
    here = np.arange(_SIDES)
    after, first, last = (here + 1) % _SIDES, np.full(_SIDES, 2 * _SIDES), np.full(_SIDES, 2 * _SIDES + 1)
    sides = [(here, after, after + _SIDES), (here, after + _SIDES, here + _SIDES)]
    caps = [(first, after, here), (last, here + _SIDES, after + _SIDES)]
    triangles = np.concatenate([np.stack(corners, -1) for corners in (*sides, *caps)])
    return Part(vertices, triangles, HAND, color, smooth=False)
