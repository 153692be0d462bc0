"""Intrinsics that belong to other images: of another size or lens, cropped or turned since, or to depth along the rays.

Each is tried on the planes that were found: what brings the tables to z = 0 is named.
"""

from collections.abc import Sequence
from dataclasses import replace

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


def find_lens(
    planes: Sequence[Sequence[Plane]],
    poses: Sequence[np.ndarray],
    intrinsics: Sequence[np.ndarray],
    bad: Sequence[int],
    table: float,
    limits: Limits,
) -> Cause | None:
    """The factor of K, or of its focal lengths alone, that explains the faults of two cameras or more, `bad`.

    `planes` per camera in its frame (m), `poses` [4, 4] and `intrinsics` [3, 3] as they are given.
    """
    if len(bad) < 2:
        return None

    def worst(rows: list[list[float]]) -> float:
        return _worst([np.linalg.inv(K * rows) @ K for K in intrinsics], planes, poses, bad, table, limits)

    tried = [float(f) for f in FACTORS if abs(f - 1) > UNCHANGED]
    found = [(worst([[f] * 3, [f] * 3, [1] * 3]), f, True) for f in tried]
    found += [(worst([[f, 1, 1], [1, f, 1], [1, 1, 1]]), f, False) for f in tried]
    score, factor, resized = min(found)
    if score > CLOSE:
        return None
    if resized:
        text = f"K of images about {factor:.2f} times as large puts the table at z = {table:g}: were they resized?"
        return Cause(
            text, "give K of the images as they are: its first two rows, times what the images were", tuple(bad)
        )
    text = f"focal lengths {factor:.2f} times as long put the table at z = {table:g}: K is that of other images or another lens"
    return Cause(text, "give K of these images: piegraph calibrate --intrinsics", tuple(bad))


def find_turned(
    planes: Sequence[Sequence[Plane]],
    poses: Sequence[np.ndarray],
    intrinsics: Sequence[np.ndarray],
    sizes: Sequence[Size],
    bad: Sequence[int],
    table: float,
    limits: Limits,
) -> Cause | None:
    """Images that were turned by a quarter, or a K whose middle has its numbers exchanged, as what explains the faults `bad`.

    `sizes` are width and height (px) of the images.
    """
    tried: list[tuple[str, str, list[np.ndarray]]] = []
    for name, to in (("clockwise", _back_clockwise), ("counterclockwise", _back_counterclockwise)):
        text = f"turning the images back, by a quarter {name}, puts the table at z = {table:g}: were they turned since?"
        tried.append((text, AGAIN, [to(size) for size in sizes]))
    text = f"exchanging cx and cy of K puts the table at z = {table:g}"
    apart = min(abs(intrinsics[c][0, 2] - intrinsics[c][1, 2]) / max(sizes[c]) for c in bad)
    exchanged = [_shifted(K[0, 2] - K[1, 2], K[1, 2] - K[0, 2]) for K in intrinsics]
    if apart > UNCHANGED:
        tried.append((text, "K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], cx along the width", exchanged))
    for text, remedy, pixels in tried:
        seen = [np.linalg.inv(K) @ M @ K for K, M in zip(intrinsics, pixels, strict=True)]
        if _worst(seen, planes, poses, bad, table, limits) < CLOSE:
            return Cause(text, remedy, tuple(bad))
    return None


def find_crop(
    planes: Sequence[Sequence[Plane]],
    poses: Sequence[np.ndarray],
    intrinsics: Sequence[np.ndarray],
    sizes: Sequence[Size],
    bad: Sequence[int],
    table: float,
    limits: Limits,
) -> Cause | None:
    """Rows that were cut off, or added, at the top of the images since, as what explains the faults of two cameras or more.

    What was cut off at the left turns a view about the vertical, which no table shows.
    """
    if len(bad) < 2:
        return None

    def worst(share: float) -> float:
        back = [_shifted(0, share * height) for _, height in sizes]
        seen = [np.linalg.inv(K) @ M @ K for K, M in zip(intrinsics, back, strict=True)]
        return _worst(seen, planes, poses, bad, table, limits)

    best = float(min(CROPS, key=worst))
    if worst(best) > CLOSE:
        return None
    rows, done = abs(best) * sizes[bad[0]][1], "cut off" if best > 0 else "added"
    text = f"with about {rows:.0f} rows {done} at the top since, the table is at z = {table:g}: were the images "
    text += "cropped?" if best > 0 else "padded?"
    columns = (
        "of columns at the left and rows at the top, what was cut off is less in cx and cy of K, what was added more"
    )
    return Cause(text, columns, tuple(bad))


def along_rays(points: np.ndarray) -> np.ndarray:
    """Points [N, 3] (m) as they are where depth is measured along the rays: found with z in its place."""
    return points * (points[:, 2] / np.linalg.norm(points, axis=1))[:, None]


def find_ranges(
    planes: Sequence[Sequence[Plane]], poses: Sequence[np.ndarray], bad: Sequence[int], table: float, limits: Limits
) -> Cause | None:
    """Depth along the rays, as what explains the faults `bad`; `planes` are those of points `along_rays`."""
    if any(not planes[c] for c in bad):
        return None
    if _worst([np.eye(3)] * len(planes), planes, poses, bad, table, limits) > CLOSE:
        return None
    text = f"depth taken as the distance along each pixel's ray puts the table at z = {table:g}"
    return Cause(
        text, "write z, the distance along the camera's axis, as depth cameras and renderers give it too", tuple(bad)
    )


def _worst(
    seen: Sequence[np.ndarray],
    planes: Sequence[Sequence[Plane]],
    poses: Sequence[np.ndarray],
    bad: Sequence[int],
    table: float,
    limits: Limits,
) -> float:
    """The worst fault of the cameras `bad`, were their points moved by `seen` [3, 3]."""
    return max(min(limits(fault_of(_seen_by(p, seen[c]), poses[c], table)) for p in planes[c]) for c in bad)


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
