"""Tracking held against spots that a person clicked: where a spot is, where particles carry it, and how far that is off."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from piegraph_cli.errors import DataError
from piegraph_cli.perception.clouds import flying_pixels
from piegraph_cli.physics.rigid import best_rotation, kabsch
from piegraph_cli.recording.camera import Camera

CLICK = 1.0
"""Pixels by which a careful click is off, one standard deviation along each side of the image."""
DEPTH, EDGE, AROUND = 0.003, 0.012, 3
"""Least deviation of a depth reading (m), the step that is an edge (m), and the pixels around a click that are looked at."""
UNLIKE = 3.0
"""Deviations from which depth does not belong to a spot that several cameras show."""
APART = 0.012
"""Share of the image's width by which clicks on one spot may contradict each other."""
SHALLOW = 0.02
"""Deviation (m) from which a spot says nothing of tracking."""
NEIGHBOURS, STEADY = 10, 0.05
"""Particles that carry a spot, and how much of a turn about the vertical is in theirs: it decides what they leave open."""
FAR = 0.03
"""Metres from the nearest particle beyond which a spot is not on the object; or two spacings of the particles."""


@dataclass(frozen=True)
class Seen:
    """One click as a measurement."""

    camera: Camera
    pixel: tuple[float, float]
    """Column, row."""
    depth: np.ndarray | None
    """[H, W] of the camera in its units, registered to colour; None where there is none."""
    mask: np.ndarray | None = None
    """[H, W] bool, where the object is: readings beside it are of what lies behind; None where it is not known."""


@dataclass(frozen=True)
class Sighting:
    """Where a spot is at a moment."""

    point: np.ndarray
    """[3] metres."""
    deviation: float
    """Metres that it may be off: root of the summed variances along x, y, z, from clicks and depth."""


@dataclass(frozen=True)
class Distance:
    """How far a spot that the particles carried was from where it was clicked."""

    spot: str
    first: int
    """Frame in which the spot was attached to the particles."""
    frame: int
    metres: float
    deviation: float
    """Metres of it that clicking alone may make, at both ends."""


def locate(seen: Sequence[Seen]) -> Sighting | None:
    """Where one spot is that cameras see at one moment, by their rays and depth; None where these do not tell.

    Depth that contradicts several rays is left out. Raises `DataError` for rays that do not meet.
    """
    depths = [_depth_under(one) for one in seen]
    found = _meet(seen, depths)
    if found is None or len(seen) < 2:
        return found
    for k, reading in enumerate(depths):
        if reading is not None and abs(_in_camera(seen[k], found.point)[2] - reading[0]) > UNLIKE * reading[1]:
            found = _meet(seen, [None] * len(seen)) or found
            break
    for one in seen:
        pixel = one.camera.project(found.point[None])[0][0]
        apart = float(np.linalg.norm(pixel - one.pixel))
        if apart > APART * one.camera.width:
            raise DataError(
                f"the clicks of cameras {', '.join(s.camera.name for s in seen)} are on no one spot: that of "
                f"{one.camera.name} is {apart:.0f} px beside",
                hint="click the same spot of the object in all of them, or remove one",
            )
    return found


def _depth_under(one: Seen) -> tuple[float, float] | None:
    """The depth (m) under a click and its deviation; None where there is no sure reading."""
    if one.depth is None:
        return None
    column, row = (round(value) for value in one.pixel)
    rows, columns = (slice(max(middle - AROUND, 0), middle + AROUND + 1) for middle in (row, column))
    wider = [slice(max(s.start - 1, 0), s.stop + 1) for s in (rows, columns)]
    inner = tuple(slice(s.start - w.start, s.stop - w.start) for s, w in zip((rows, columns), wider, strict=True))
    window = one.depth[tuple(wider)]
    sure = (window > 0) & ~flying_pixels(window, one.camera, EDGE)
    if one.mask is not None:
        sure &= one.mask[tuple(wider)]
    readings = window[inner][sure[inner]] * one.camera.depth_scale
    if len(readings) == 0:
        return None
    middle = float(np.median(readings))
    return middle, max(DEPTH, float(np.median(np.abs(readings - middle))) * 1.5)


def _in_camera(one: Seen, point: np.ndarray) -> np.ndarray:
    return (point - one.camera.T_world_camera[:3, 3]) @ one.camera.T_world_camera[:3, :3]


def _meet(seen: Sequence[Seen], depths: Sequence[tuple[float, float] | None]) -> Sighting | None:
    """The point that fits rays and depths best (linear least squares, weighted by what each is good for)."""
    point: np.ndarray | None = None
    inverse = np.eye(3)
    for _ in range(3):  # the weights depend on the distance, which is not known at first
        rows, values = [], []
        for one, reading in zip(seen, depths, strict=True):
            R, c = one.camera.T_world_camera[:3, :3], one.camera.T_world_camera[:3, 3]
            ray = one.camera.rays(np.array([one.pixel]))[0]
            away = reading[0] if reading else 1.0 if point is None else _in_camera(one, point)[2]
            for axis in (0, 1):
                weight = one.camera.K[axis, axis] / (CLICK * max(away, 1e-3))
                row = weight * (R[:, axis] - ray[axis] * R[:, 2])
                rows.append(row)
                values.append(row @ c)
            if reading:
                rows.append(R[:, 2] / reading[1])
                values.append((reading[0] + R[:, 2] @ c) / reading[1])
        A = np.array(rows)
        if len(A) < 3:
            return None
        inverse = np.linalg.pinv(A.T @ A)
        point = inverse @ A.T @ np.array(values)
    assert point is not None
    in_front = all(_in_camera(one, point)[2] > 0 for one in seen)
    sighting = Sighting(point, float(np.sqrt(np.trace(inverse))))
    return sighting if in_front and sighting.deviation <= SHALLOW else None


def carry(positions: np.ndarray, start: int, point: np.ndarray) -> np.ndarray:
    """Where particles [F, N, 3] (m) carry a point [3] (m) that lies among them in frame `start`: [F, 3].

    It moves as its neighbours do, rigidly. Raises `DataError` where it is not on the object.
    """
    rest = np.asarray(positions[start], np.float64)
    count = min(NEIGHBOURS, len(rest))
    near, index = (np.atleast_1d(a) for a in cKDTree(rest).query(point, count))
    spacing = float(cKDTree(rest).query(rest, 2)[0][:, 1].mean()) if len(rest) > 1 else 0.0
    if near[0] > max(FAR, 2 * spacing):
        raise DataError(
            f"is {100 * near[0]:.1f} cm from the nearest particle of the object", hint="click on the object itself"
        )
    weights = torch.as_tensor(np.exp(-((near / max(near[-1], 1e-6)) ** 2)))
    source = torch.as_tensor(rest[index]).expand(len(positions), -1, -1)
    target = torch.as_tensor(np.asarray(positions, np.float64)[:, index])
    share = (weights / weights.sum())[None, :, None]
    from_, to = (share * source).sum(1), (share * target).sum(1)
    covariance = (share * (source - from_[:, None])).transpose(1, 2) @ (target - to[:, None])
    upright, _ = kabsch(source, target, weights, upright=True)
    scale = covariance.diagonal(dim1=1, dim2=2).abs().sum(1)[:, None, None]
    scale = torch.maximum(scale, (share * (source - from_[:, None]) ** 2).sum((1, 2))[:, None, None])
    turn = best_rotation(covariance + STEADY * scale * upright.transpose(1, 2))
    offset = torch.as_tensor(point) - from_
    return (to + (turn @ offset[..., None])[..., 0]).numpy()


def distances(positions: np.ndarray, spots: Mapping[str, Mapping[int, Sighting]]) -> list[Distance]:
    """How far spots, by name and frame, are from where particles [F, N, 3] (m) carried them from their first frame.

    Raises `DataError` naming a spot that is not on the object.
    """
    found = []
    for name, sightings in spots.items():
        frames = sorted(sightings)
        if len(frames) < 2:
            continue
        first = sightings[frames[0]]
        try:
            carried = carry(positions, frames[0], first.point)
        except DataError as error:
            raise DataError(f"spot {name} {error.message}", f"frame {frames[0]}", error.hint) from None
        for frame in frames[1:]:
            off = float(np.linalg.norm(carried[frame] - sightings[frame].point))
            deviation = float(np.hypot(first.deviation, sightings[frame].deviation))
            found.append(Distance(name, frames[0], frame, off, deviation))
    return found
