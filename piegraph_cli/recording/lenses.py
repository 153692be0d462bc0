"""Intrinsics that belong to other images: of another size or lens, cropped or turned since, or to depth along the rays.

Each is tried on the planes that were found: what brings the tables to z = 0 is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.recording.causes import Cause, Limits, fault_of
from piegraph_cli.recording.planes import Plane

FACTORS = np.geomspace(0.3, 3.0, 231)
"""Factors of K that are tried, 1 % apart."""
UNCHANGED = 0.03
"""What is off by less is no such slip."""
CLOSE = 0.5
"""A slip is found if it brings each table within this share of what would be bad."""
CROPS = np.array([share for share in np.linspace(-0.4, 0.4, 321) if abs(share) > 0.02])
"""Shares of the image's height that are tried as cut off at the top, or added if negative."""
AGAIN = "calibrate with images as they are recorded, or give K, width and height of these"

Size = tuple[int, int]


def _back_clockwise(size: Size) -> np.ndarray:
    return np.array([[0.0, -1, size[1] - 1], [1, 0, 0], [0, 0, 1]])


def _back_counterclockwise(size: Size) -> np.ndarray:
    return np.array([[0.0, 1, 0], [-1, 0, size[0] - 1], [0, 0, 1]])


@dataclass(frozen=True)
class Tables:
    """The tables of several cameras, of which some are wrong."""

    planes: Sequence[Sequence[Plane]]
    """Of each camera, in its frame (m)."""
    poses: Sequence[np.ndarray]
    """[4, 4] as they are given."""
    intrinsics: Sequence[np.ndarray]
    """[3, 3] as they are given."""
    sizes: Sequence[Size]
    """Width and height (px) of the images."""
    bad: Sequence[int]
    """The cameras whose tables are wrong."""
    height: float
    """Where the table should be: z (m)."""
    limits: Limits

    def worst(self, moved: Sequence[np.ndarray]) -> float:
        """The worst fault of the wrong ones, were the points of each camera moved by its `moved` [3, 3]."""
        return max(
            min(self.limits(fault_of(_seen_by(p, moved[c]), self.poses[c], self.height)) for p in self.planes[c])
            for c in self.bad
        )

    def cause(self, text: str, remedy: str) -> Cause:
        """What explains the wrong ones."""
        return Cause(text, remedy, tuple(self.bad))


def find_lens(tables: Tables) -> Cause | None:
    """The factor of K, or of its focal lengths alone, that explains the faults of two cameras or more."""
    if len(tables.bad) < 2:
        return None

    def worst(rows: list[list[float]]) -> float:
        return tables.worst([np.linalg.inv(K * rows) @ K for K in tables.intrinsics])

    tried = [float(f) for f in FACTORS if abs(f - 1) > UNCHANGED]
    found = [(worst([[f] * 3, [f] * 3, [1] * 3]), f, True) for f in tried]
    found += [(worst([[f, 1, 1], [1, f, 1], [1, 1, 1]]), f, False) for f in tried]
    score, factor, resized = min(found)
    if score > CLOSE:
        return None
    if resized:
        text = (
            f"K of images about {factor:.2f} times as large puts the table at z = {tables.height:g}: were they resized?"
        )
        return tables.cause(text, "give K of the images as they are: its first two rows, times what the images were")
    text = f"focal lengths {factor:.2f} times as long put the table at z = {tables.height:g}"
    text += ": K is that of other images or another lens"
    return tables.cause(text, "give K of these images: piegraph calibrate --intrinsics")


def find_turned(tables: Tables) -> Cause | None:
    """Images that were turned by a quarter, or a K whose middle has its numbers exchanged, as what explains the faults."""
    tried: list[tuple[str, str, list[np.ndarray]]] = []
    for name, to in (("clockwise", _back_clockwise), ("counterclockwise", _back_counterclockwise)):
        text = f"turning the images back, by a quarter {name}, puts the table at z = {tables.height:g}: were they turned since?"
        tried.append((text, AGAIN, [to(size) for size in tables.sizes]))
    text = f"exchanging cx and cy of K puts the table at z = {tables.height:g}"
    apart = min(abs(tables.intrinsics[c][0, 2] - tables.intrinsics[c][1, 2]) / max(tables.sizes[c]) for c in tables.bad)
    exchanged = [_shifted(K[0, 2] - K[1, 2], K[1, 2] - K[0, 2]) for K in tables.intrinsics]
    if apart > UNCHANGED:
        tried.append((text, "K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], cx along the width", exchanged))
    for text, remedy, pixels in tried:
        if tables.worst(_moved(tables, pixels)) < CLOSE:
            return tables.cause(text, remedy)
    return None


def find_crop(tables: Tables) -> Cause | None:
    """Rows that were cut off, or added, at the top of the images since, as what explains the faults of two cameras or more.

    What was cut off at the left turns a view about the vertical, which no table shows.
    """
    if len(tables.bad) < 2:
        return None

    def worst(share: float) -> float:
        return tables.worst(_moved(tables, [_shifted(0, share * height) for _, height in tables.sizes]))

    best = float(min(CROPS, key=worst))
    if worst(best) > CLOSE:
        return None
    rows, done = abs(best) * tables.sizes[tables.bad[0]][1], "cut off" if best > 0 else "added"
    text = (
        f"with about {rows:.0f} rows {done} at the top since, the table is at z = {tables.height:g}: were the images "
    )
    text += "cropped?" if best > 0 else "padded?"
    columns = (
        "of columns at the left and rows at the top, what was cut off is less in cx and cy of K, what was added more"
    )
    return tables.cause(text, columns)


def along_rays(points: np.ndarray) -> np.ndarray:
    """Points [N, 3] (m) as they are where depth is measured along the rays: found with z in its place."""
    return points * (points[:, 2] / np.linalg.norm(points, axis=1))[:, None]


def find_ranges(tables: Tables) -> Cause | None:
    """Depth along the rays, as what explains the faults, where the planes are those of points `along_rays`."""
    if any(not tables.planes[c] for c in tables.bad) or tables.worst([np.eye(3)] * len(tables.planes)) > CLOSE:
        return None
    text = f"depth taken as the distance along each pixel's ray puts the table at z = {tables.height:g}"
    return tables.cause(
        text, "write z, the distance along the camera's axis, as depth cameras and renderers give it too"
    )


def _moved(tables: Tables, pixels: Sequence[np.ndarray]) -> list[np.ndarray]:
    """How points move [3, 3] per camera whose pixels move by `pixels` [3, 3]."""
    return [np.linalg.inv(K) @ M @ K for K, M in zip(tables.intrinsics, pixels, strict=True)]


def _shifted(x: float, y: float) -> np.ndarray:
    """The map of pixels [3, 3] by which they come to lie x and y (px) farther."""
    return np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]])


def _seen_by(plane: Plane, moved: np.ndarray) -> Plane:
    """A plane whose points p would have been `moved` @ p, the third row aside; the lens's distortion is left alone."""
    M = moved.copy()
    M[2] = [0, 0, 1]
    normal = plane.normal @ np.linalg.inv(M)
    length = float(np.linalg.norm(normal))
    return replace(plane, normal=normal / length, distance=plane.distance / length, centre=M @ plane.centre)
