"""Whether a recording's geometry can be true: cameras, depth and colour against the table and each other.

Each check has a figure, a threshold and a verdict; what is bad comes with a cause that was tried on the same data.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.recording.agreement import Sight
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.causes import Cause, Fault, fault_of, find_cause
from piegraph_cli.recording.checks import Check, check_images, judged
from piegraph_cli.recording.edges import find_flip, match_outlines, standing
from piegraph_cli.recording.given import explained_by_entries
from piegraph_cli.recording.lenses import Tables, along_rays, find_crop, find_lens, find_ranges, find_turned
from piegraph_cli.recording.pairs import check_pairs
from piegraph_cli.recording.planes import Plane, Rays, find_planes
from piegraph_cli.recording.texture import check_texture, picture_of

OFFSET, TILT = (0.004, 0.007), (1.2, 2.2)
"""A table off by more (m, deg) is doubtful, bad. Good recordings end at 2.5 mm and 0.9 degrees."""
OFFSET_SHARE = (0.006, 0.01)
"""The same as shares of the distance: depth is less sure from far away."""
ORTHONORMAL = 1e-3
LOOKS_DOWN = (85.0, 110.0)
"""Angle (deg) between a camera's axis and straight down."""
IN_VIEW = 0.05
"""Share of the image that should show the table, for one that is not found to be bad."""
SHIFT, GAIN = (0.012, 0.018), (1.25, 1.5)
"""Shift of depth against colour as a share of the width, and how much better the edges must fit there."""
MORE = 0.18
"""Of the outline that has to lie on edges there and not here: of a fold, which has one colour, little does anywhere."""
REGISTER = (
    "register depth to colour when recording (RealSense: align to color), or give depth_K and T_color_depth, "
    "which ingest registers it by"
)


@dataclass(frozen=True)
class View:
    """What one camera recorded, in a few frames; the first and the last tell most, since they show no moving hand."""

    camera: Camera
    depth: Sequence[np.ndarray]
    """uint16 [H, W] each, in the camera's units, 0 for no reading."""
    color: Sequence[np.ndarray]
    """RGB uint8 [H, W, 3] each, of the same frames."""


@dataclass
class _Look:
    """A view with what was found in it."""

    view: View
    rays: Rays
    points: np.ndarray
    planes: list[Plane]
    table: Plane | None
    """The plane that lies where the table should, else the largest."""

    @classmethod
    def at(cls, view: View, table: float) -> "_Look":
        rays = Rays.over(view.camera)
        points = rays.points(view.depth[0]) * view.camera.depth_scale
        planes = find_planes(points)
        T = view.camera.T_world_camera
        best = min(planes, key=lambda plane: _badness(fault_of(plane, T, table)), default=None)
        if best is not None and _badness(fault_of(best, T, table)) > 1:
            best = planes[0]
        return cls(view, rays, points, planes, best)

    @property
    def camera(self) -> Camera:
        return self.view.camera

    def sights(self) -> list[Sight]:
        """What it sees in its first and in its last frame."""
        assert self.table is not None
        found = []
        for depth in (self.view.depth[0], self.view.depth[-1]):
            stands = standing(depth, self.camera, self.rays, self.table)
            found.append(Sight.of(self.camera, depth, stands, self.rays.points(depth) * self.camera.depth_scale))
        return found


def check_geometry(views: Sequence[View], workspace: np.ndarray, table: float = 0.0) -> list[Check]:
    """All checks of one sequence.

    `workspace` [3, 2] (m) is the box in the world where things happen, `table` the height of the table in it (m).
    """
    checks = [_check_pose(view.camera) for view in views]
    for view in views:
        checks += check_images(view.camera, view.depth, view.color)
    broken = {name for check in checks if check.verdict == "bad" for name in check.cameras}
    looks = [_Look.at(view, table) for view in views if view.camera.name not in broken]
    edges = {look.camera.name: check for look in looks if look.table and (check := _check_edges(look))}
    checks += [*_check_tables(looks, edges, workspace, table), *edges.values()]
    wrong = {name for check in checks if check.verdict == "bad" for name in check.cameras}
    # where one camera is wrong in itself, the others cannot agree with it
    right = [look for look in looks if look.table and look.camera.name not in wrong]
    pictures = [picture_of(look.camera, look.view.color[0], look.view.depth[0], workspace, table) for look in right]
    textures = check_texture([look.camera for look in right], pictures, workspace)
    checks += [*check_pairs([look.sights() for look in right], table), *textures]
    return explained_by_entries(checks, [view.camera for view in views])


def _check_pose(camera: Camera) -> Check:
    T, who = camera.T_world_camera, (camera.name,)
    off = float(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max()) if np.isfinite(T).all() else np.inf
    if off <= ORTHONORMAL and np.linalg.det(T[:3, :3]) > 0:
        return Check("pose", who, off, "1", ORTHONORMAL, "good", "the rotation is one")
    text = (
        "the rotation of T_world_camera is mirrored" if off <= ORTHONORMAL else "the rotation of T_world_camera is none"
    )
    return Check("pose", who, min(off, 1e9), "1", ORTHONORMAL, "bad", text, remedy="run `piegraph calibrate`")


def _share(fault: Fault, level: int) -> float:
    """A fault as a share of what is doubtful (level 0) or bad (1)."""
    if fault.above <= 0:
        return np.inf
    offset = max(OFFSET[level], OFFSET_SHARE[level] * fault.distance)
    return max(abs(fault.offset) / offset, fault.tilt / TILT[level])


def _badness(fault: Fault) -> float:
    return _share(fault, 1)


def _check_tables(looks: Sequence[_Look], edges: dict[str, Check], workspace: np.ndarray, table: float) -> list[Check]:
    """The table and the view of each camera; all that is bad shares the cause that explains it."""
    poses = [look.camera.T_world_camera for look in looks]
    faults = [fault_of(look.table, T, table) if look.table else None for look, T in zip(looks, poses, strict=True)]
    bad = [k for k, fault in enumerate(faults) if fault and _badness(fault) > 1]
    causes = {k: cause for k in bad if (cause := _by_edges(looks[k], faults[k], edges.get(looks[k].camera.name)))}
    left = [k for k in bad if k not in causes]
    planes, cameras = [look.planes for look in looks], [look.camera for look in looks]
    lenses, sizes = [camera.K for camera in cameras], [(camera.width, camera.height) for camera in cameras]
    while left:
        tables = Tables(planes, poses, lenses, sizes, left, table, _badness)
        cause = _by_images(looks, tables) or find_cause(
            planes,
            poses,
            [camera.depth_scale for camera in cameras],
            [fault or Fault(0, 0, 0, 0) for fault in faults],
            left,
            [k for k, fault in enumerate(faults) if k in left or (fault and _share(fault, 0) > 1 and k not in causes)],
            [camera.name for camera in cameras],
            table,
            _badness,
        )
        if not cause.tested:
            cause = find_lens(tables) or find_crop(tables) or cause
        causes |= dict.fromkeys(cause.cameras, cause)
        left = [k for k in left if k not in cause.cameras]
    checks = []
    hidden = [_in_view(look, workspace, table) < IN_VIEW for look in looks]
    nowhere = all(hidden) and len(looks) > 1
    for k, (look, fault, unseen) in enumerate(zip(looks, faults, hidden, strict=True)):
        checks.append(_table_check(look, fault, causes.get(k), unseen and not nowhere, table))
        checks.append(_view_check(look, causes.get(k), unseen))
    return checks


def _by_edges(look: _Look, fault: Fault | None, edges: Check | None) -> Cause | None:
    """Depth that lies beside colour tilts the table too: that is no fault of the pose."""
    if fault is None or edges is None or edges.verdict == "good" or fault.above <= 0:
        return None
    most = 2 * edges.figure * fault.distance / look.camera.K[0, 0]
    return Cause(edges.cause, edges.remedy, ()) if abs(fault.offset) < most else None


def _by_images(looks: Sequence[_Look], tables: Tables) -> Cause | None:
    """What was done to all of the images or the depth of cameras, where that explains their tables."""
    ranges = [find_planes(along_rays(look.points)) if k in tables.bad else look.planes for k, look in enumerate(looks)]
    return find_turned(tables) or find_ranges(replace(tables, planes=ranges))


def _in_view(look: _Look, workspace: np.ndarray, table: float) -> float:
    """Share of a camera's image in which the workspace's part of the table should be."""
    T = look.camera.T_world_camera
    rays = look.rays.rays @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (table - T[2, 3]) / rays[:, 2]
        hits = T[:2, 3] + rays[:, :2] * reach[:, None]
    inside = (hits > workspace[:2, 0]) & (hits < workspace[:2, 1])
    return float(np.mean((reach > 0) & inside.all(1)))


def _table_check(look: _Look, fault: Fault | None, cause: Cause | None, unseen: bool, table: float) -> Check:
    who = (look.camera.name,)
    if fault is None:
        text, remedy = "no table is found in depth", "check depth, or what the camera looks at"
        return Check("table", who, np.nan, "mm", 1000 * OFFSET[0], "doubtful", text, remedy=remedy)
    threshold = max(OFFSET[0], OFFSET_SHARE[0] * fault.distance)
    offset = f"{abs(1000 * fault.offset):.1f} mm {'above' if fault.offset > 0 else 'below'} z = {table:g}"
    text = f"table {offset}, tilted by {fault.tilt:.1f} deg"
    if fault.above <= 0:
        text += ", above the camera"
    verdict = "bad" if cause else judged(_share(fault, 0), 1.0)
    if cause and unseen and not cause.tested:
        # where the pose says there is no table, what is seen may be a wall
        return Check(
            "table", who, 1000 * fault.offset, "mm", 1000 * threshold, "doubtful", text, cause.text, cause.remedy
        )
    found = (cause.text, cause.remedy) if cause else ("", "")
    if verdict == "doubtful":
        found = "", "calibrate again with the board flat on the table if tracks are to be better than that"
    return Check("table", who, 1000 * fault.offset, "mm", 1000 * threshold, verdict, text, *found)


def _view_check(look: _Look, cause: Cause | None, unseen: bool) -> Check:
    down = float(np.degrees(np.arccos(np.clip(-look.camera.T_world_camera[2, 2], -1, 1))))
    who, text = (look.camera.name,), f"its axis points {down:.0f} deg from straight down"
    verdict = judged(down, *LOOKS_DOWN)
    if cause and verdict != "good":
        return Check("view", who, down, "deg", LOOKS_DOWN[0], verdict, text, cause.text, cause.remedy)
    if verdict == "good" and unseen and not cause:
        text, verdict = "hardly any of the workspace is in its view", "doubtful"
    remedy = "check its pose, and ingest.workspace" if verdict != "good" else ""
    return Check("view", who, down, "deg", LOOKS_DOWN[0], verdict, text, remedy=remedy)


def _check_edges(look: _Look) -> Check | None:
    """Depth against colour; None where nothing stands on the table whose edges could be compared."""
    assert look.table is not None
    masks = [standing(depth, look.camera, look.rays, look.table) for depth in look.view.depth]
    allowed, wrong = (share * look.camera.width for share in SHIFT)
    shift = match_outlines(masks, list(look.view.color))
    if shift is None or shift.gain > GAIN[0]:
        flip = find_flip(masks, list(look.view.color))
        if flip:
            text, cause = "edges of depth are not those of colour", f"one of them is {flip} against the other"
            remedy = "turn the images of one kind over, as the other kind is recorded"
            return Check("edges", (look.camera.name,), wrong, "px", allowed, "bad", text, cause, remedy)
    if shift is None:
        return None
    pixels = float(np.hypot(shift.x, shift.y))
    verdict = judged(pixels, allowed, wrong)
    if shift.gain < GAIN[1] and verdict == "bad":
        verdict = "doubtful"
    if shift.gain < GAIN[0] or shift.more < MORE:
        verdict = "good"
    text = f"edges of depth lie {-shift.x}, {-shift.y} px (right, down) of those of colour"
    moving = f"moving depth by {shift.x}, {shift.y} px lays its edges on those of colour"
    cause = f"depth is not registered to colour: {moving}" if verdict != "good" else ""
    remedy = "" if verdict == "good" else REGISTER
    return Check("edges", (look.camera.name,), pixels, "px", allowed, verdict, text, cause, remedy)
