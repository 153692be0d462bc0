"""Calibration of a recording: its cameras.json filled in from images of a board in one place or several."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording import layout
from piegraph_cli.recording.axes import Shown
from piegraph_cli.recording.board_trouble import check_marker, more_markers, never_seen, why_not_found
from piegraph_cli.recording.boards import Board, find_corners
from piegraph_cli.recording.calibration import (
    FEWEST_CORNERS,
    Sightings,
    Solution,
    board_pose,
    check_size,
    depth_factor,
    solve,
)
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.shots import Shots, read_shots

POOR, WRONG, WRONG_SHARE = 1.0, 2.0, 0.0025
"""Mean reprojection error (px) that is said, and that is refused; of large images the share of their width."""
ASKED = 6
"""Images that are asked why the board is not found."""


@dataclass(frozen=True)
class Located:
    """What calibrating found of one camera."""

    camera: Camera
    """Where it stands."""
    error: float
    """px."""
    frames: dict[str, float]
    """Error (px) by the image's name, of those that show the board."""
    warnings: list[str]
    shown: Shown
    """Its part of the picture."""


@dataclass(frozen=True)
class Calibration:
    """What calibrating found: cameras, the sequences that show the board, the layout of the board, its places."""

    cameras: list[Located]
    sequences: list[str]
    board: Board
    places: int
    origin: str
    """The image in which the board lies at the world's origin."""
    notes: list[str]
    file: Path
    """The cameras.json."""


def calibrate(recording: Path, sequences: Sequence[str], board: Board, lenses: bool = False) -> Calibration:
    """Locate every camera by a board in the images of some sequences (the first by default); write cameras.json.

    The world's origin is the middle of the board as it lies in the first image that shows it. Of the layouts that are
    printed under the same numbers the one that fits is taken. cameras.json is replaced once all cameras are located;
    before that nothing is written.
    """
    shots = read_shots(recording, sequences)
    board, seen = find_board(shots, board)
    found = solve(seen, board, lenses)
    located = [_located(shots, seen, found, board, c, lenses) for c in range(len(shots.cameras))]
    origin = int(np.argmax((found.place == 0) & found.used.any(0)))
    first = int(np.argmax(found.used[:, origin]))
    name = f"{shots.name(first, origin)} of {shots.cameras[first].name}"
    names = [folder.name for folder in shots.sequences]
    notes = [*shots.notes, *filter(None, [never_seen(np.asarray(seen.seen.any((0, 1))), board)])]
    path = layout.cameras_file(shots.sequences[0])
    if layout.read_cameras_file(path).T_world_robot is not None:
        notes.append("T_world_robot is taken out of cameras.json: the world is another now, calibrate the robot again")
    write_cameras(path, [one.camera for one in located], lenses, calibration_sequence=names, T_world_robot=None)
    return Calibration(located, names, board, len(found.T_world_board), name, notes, path)


def find_board(shots: Shots, board: Board, all_cameras: bool = True) -> tuple[Board, Sightings]:
    """The board in the layout that fits, and its corners in all images.

    Raises `DataError` with the likely reason where a camera, or without `all_cameras` every camera, sees too little of it.
    """
    K, distortion = (np.array([getattr(c, name) for c in shots.cameras]) for name in ("K", "distortion"))
    names = [camera.name for camera in shots.cameras]
    best: tuple[float, Board, np.ndarray] | None = None
    pixels, border = np.zeros(0), 0
    for one in board.layouts():
        if one.kind == "charuco" or one.border != border:  # tags of a grid are found without knowing more of its layout
            border = one.border
            pixels = np.array([find_corners(shots.images(c), one) for c in range(len(names))])
        off = _misfit(pixels, one, K, distortion)
        if best is None or off < best[0]:
            best = off, one, pixels
        if off < POOR and one.kind == "charuco":
            break
    assert best is not None
    seen = Sightings(names, best[2], shots.sequence, K, distortion)
    corners = seen.seen.any(1).sum(1)
    blind = np.flatnonzero(corners < FEWEST_CORNERS)
    if len(blind) and (all_cameras or len(blind) == len(names)):
        c = int(blind[0])
        where = f"{len(shots.sequence)} images from {shots.name(c, 0)} on"
        message = f"camera {names[c]} sees {corners[c]} corners of the board in {where}, {FEWEST_CORNERS} are needed"
        step = max(1, len(shots.sequence) // ASKED)
        hint = why_not_found([shots.image(c, k) for k in range(0, len(shots.sequence), step)], board)
        raise DataError(message, str(shots.files[c][0].parent), hint)
    return best[1], seen


def _misfit(pixels: np.ndarray, board: Board, K: np.ndarray, distortion: np.ndarray) -> float:
    """How far (px, median) corners lie from where a board of this layout has them, in images that show enough of it."""
    import cv2

    points, off = board.corners(), []
    for c, i in np.argwhere(np.isfinite(pixels).all(-1).sum(-1) >= FEWEST_CORNERS):
        pose = board_pose(pixels[c, i], points, K[c], distortion[c])
        if pose is not None:
            T = pose[1]
            placed = cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K[c], distortion[c])[0][:, 0]
            off.append(float(np.nanmean(np.linalg.norm(placed - pixels[c, i], axis=-1))))
    return float(np.median(off)) if off else np.inf


def _located(shots: Shots, seen: Sightings, found: Solution, board: Board, c: int, lenses: bool) -> Located:
    """One camera's pose, errors and warnings. Raises `DataError` where it cannot be right."""
    given, error, used = shots.cameras[c], found.error(c), np.flatnonzero(found.used[c]).tolist()
    camera = replace(given, K=found.K[c], distortion=found.distortion[c], T_world_camera=found.T_world_camera[c])
    if error > max(WRONG, WRONG_SHARE * given.width):
        raise DataError(
            f"camera {given.name}: corners are {error:.1f} px from where they should be",
            str(shots.files[c][used[0]]),
            "check K and distortion in cameras.json, or find them with --intrinsics; --columns, --rows and a flat board",
        )
    check_marker(shots.image(c, used[0]), board, given.name)
    warnings = [] if error <= POOR else ["poor: check K and distortion" if not lenses else "poor: is the board flat?"]
    sighted = np.flatnonzero(np.isfinite(found.errors[c])).tolist()
    left = [k for k in sighted if k not in used]
    if left:
        first = shots.name(c, left[0])
        warnings.append(
            f"{len(left)} of {len(sighted)} images left out, first {first}: blurred, or the board moved between cameras"
        )
    depths = {int(k): depth for k in used if (depth := shots.depth(c, k)) is not None}
    if depths:
        factor = depth_factor(found, seen, c, depths, given.depth_scale, board)
        warnings += filter(None, [check_size(factor, board, given.name)])
    warnings += filter(None, [more_markers(shots.image(c, used[0]), board)])
    k = int(used[0])
    T = found.T_world_board[found.place[k]]
    points = board.corners() @ T[:3, :3].T + T[:3, 3]
    text = f"{given.name}  {error:.2f} px  {shots.name(c, k)}"
    shown = Shown(camera, shots.image(c, k), text, seen.pixels[c, k], points)
    return Located(camera, error, {shots.name(c, i): float(found.errors[c, i]) for i in sighted}, warnings, shown)


def write_cameras(path: Path, cameras: Sequence[Camera], lenses: bool = False, **noted: Any) -> None:
    """Put poses, with `lenses` K and distortion too, and other fields into a cameras.json."""
    file = layout.read_cameras_file(path)
    entries = dict(file.cameras)
    for camera in cameras:
        changed: dict[str, Any] = {"T_world_camera": camera.T_world_camera.tolist()}
        if lenses:
            changed |= {"K": camera.K.tolist(), "distortion": camera.distortion.tolist()}
        entries[camera.name] = entries[camera.name].model_copy(update=changed)
    sequences = noted.get("calibration_sequence")
    if sequences and len(sequences) == 1:
        noted["calibration_sequence"] = sequences[0]
    with atomic_file(path) as temporary:
        temporary.write_text(layout.cameras_file_text(file.model_copy(update={"cameras": entries, **noted})))
