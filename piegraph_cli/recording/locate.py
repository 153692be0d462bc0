"""The command `calibrate`: fills T_world_camera of a recording's cameras.json from a sequence that shows a ChArUco board."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording import layout
from piegraph_cli.recording.calibration import Board, Pose, check_size, depth_factor, find_corners, locate_camera
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.folders import list_sequences
from piegraph_cli.recording.images import decode_color
from piegraph_cli.recording.numbers import number_of
from piegraph_cli.recording.registration import register_depth

POOR = 1.0
"""Reprojection error in pixels above which the user is warned."""
FRAMES = 10
"""Frames that are looked at, spread over the sequence."""


@dataclass(frozen=True)
class Located:
    """What calibrating found of one camera."""

    name: str
    error: float
    """px."""
    frames: dict[str, float]
    """Error (px) by the image's name, of those that show the board."""
    warnings: list[str]


@dataclass(frozen=True)
class Calibration:
    """What calibrating found: cameras, the sequence that shows the board, and the layout of the board."""

    cameras: list[Located]
    sequence: str
    board: Board


@dataclass(frozen=True)
class _Seen:
    """One camera's images of the board."""

    camera: Camera
    files: list[Path]
    images: list[np.ndarray]
    """RGB."""


def calibrate(recording: Path, sequence: str | None, board: Board) -> Calibration:
    """Locate every camera from images of one sequence (the first by default), and note which sequence it was.

    Where a board is not found or fits badly, its layout before OpenCV 4.6 is tried as well. cameras.json is replaced
    once all cameras are located; before that nothing is written.
    """
    folders = {folder.name: folder for folder in list_sequences(recording, "piegraph")}
    if sequence is not None and sequence not in folders:
        raise DataError(f"no sequence {sequence}", str(recording), f"one of {', '.join(folders)}")
    folder = folders[sequence] if sequence is not None else next(iter(folders.values()))
    seen = [_look(folder, camera) for camera in layout.read_cameras(folder, posed=False)]
    board, corners, poses = _locate(seen, board)
    located = []
    for of, found, pose in zip(seen, corners, poses, strict=True):
        warnings = _warnings(of, found, pose, board, folder)
        frames = {f.stem: float(e) for f, e in zip(of.files, pose.errors, strict=True) if np.isfinite(e)}
        located.append(Located(of.camera.name, pose.error, frames, warnings))
    _write(layout.cameras_file(folder), {s.camera.name: pose for s, pose in zip(seen, poses, strict=True)}, folder.name)
    return Calibration(located, folder.name, board)


def _look(folder: Path, camera: Camera) -> _Seen:
    files = list(layout.image_files(folder, camera, "color").values())
    if not files:
        raise DataError(f"camera {camera.name} has no images", str(folder), "see docs/formats.md for the layout")
    chosen = np.unique(np.linspace(0, len(files) - 1, min(FRAMES, len(files))).round().astype(int))
    files = [files[k] for k in chosen]
    images = [decode_color(np.frombuffer(layout.read_color(file, camera), np.uint8)) for file in files]
    return _Seen(camera, files, images)


def _locate(seen: list[_Seen], board: Board) -> tuple[Board, list[np.ndarray], list[Pose]]:
    """The board's layout, the corners found and the poses: of both layouts the one that fits better."""
    tried: list[tuple[float, Board, list[np.ndarray], list[Pose]]] = []
    problem: DataError | None = None
    for one in (board, replace(board, legacy=True)):
        if one.legacy and (board.rows % 2 or (tried and tried[0][0] <= POOR)):
            continue  # the layouts of odd rows are the same
        corners = [find_corners(of.images, one) for of in seen]
        try:
            poses = [
                locate_camera(found, of.camera.K, of.camera.distortion, one, of.camera.name)
                for of, found in zip(seen, corners, strict=True)
            ]
        except DataError as error:
            problem = problem or error
            continue
        tried.append((max(pose.error for pose in poses), one, corners, poses))
    if not tried:
        assert problem is not None
        raise problem
    return min(tried, key=lambda row: row[0])[1:]


def _warnings(of: _Seen, found: np.ndarray, pose: Pose, board: Board, folder: Path) -> list[str]:
    warnings = []
    if pose.error > POOR:
        warnings.append("poor: check K and distortion")
    left = [
        file.stem
        for file, error, used in zip(of.files, pose.errors, pose.used, strict=True)
        if error == error and not used
    ]
    if left:
        warnings.append(
            f"{len(left)} of {len(of.files)} images left out, first {left[0]}: the board or the camera moved"
        )
    depths = list(_depths(of, pose, folder))
    if depths:
        factor = depth_factor(found, depths, of.camera.depth_scale, pose, board)
        warnings += filter(None, [check_size(factor, board, of.camera.name)])
    return warnings


def _depths(of: _Seen, pose: Pose, folder: Path) -> Iterator[np.ndarray]:
    """Depth of the images that were used, or nothing: where there is none, or it cannot be read, it says nothing."""
    images = []
    try:
        files = layout.image_files(folder, of.camera, "depth")
        for color, used in zip(of.files, pose.used, strict=True):
            if used:
                depth = layout.read_depth(files[number_of(color)], of.camera)
                images.append(register_depth(depth, of.camera) if of.camera.depth_view else depth)
    except (DataError, LookupError):
        return
    yield from images


def _write(path: Path, poses: dict[str, Pose], sequence: str) -> None:
    """Put the poses, and the name of the sequence that shows the board, into a cameras.json."""
    file = layout.read_cameras_file(path)
    cameras = {
        name: entry.model_copy(update={"T_world_camera": poses[name].T_world_camera.tolist()})
        for name, entry in file.cameras.items()
    }
    with atomic_file(path) as temporary:
        changed = file.model_copy(update={"cameras": cameras, "calibration_sequence": sequence})
        temporary.write_text(layout.cameras_file_text(changed))
