"""The command `calibrate`: fills T_world_camera of a recording's cameras.json from a sequence that shows a ChArUco board."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.calibration import Board, locate_camera
from piegraph_cli.recording.folders import list_sequences
from piegraph_cli.recording.images import decode_color
from piegraph_cli.recording.layout import cameras_text, frame_files, read_cameras, read_color

POOR = 1.0
"""Reprojection error in pixels above which the user is warned."""


def calibrate(recording: Path, sequence: str | None, board: Board, frames: int = 10) -> list[tuple[str, float, bool]]:
    """Locate every camera from up to `frames` images of one sequence (the first by default); (name, error px, poor) each.

    cameras.json is replaced once all cameras are located; before that nothing is written.
    """
    folders = {folder.name: folder for folder in list_sequences(recording)}
    if sequence is not None and sequence not in folders:
        raise DataError(f"no sequence {sequence}", str(recording), f"one of {', '.join(folders)}")
    folder = folders[sequence] if sequence is not None else next(iter(folders.values()))
    located, results = [], []
    for camera in read_cameras(folder, posed=False):
        files = frame_files(folder, camera)[:frames]
        images = (decode_color(np.frombuffer(read_color(color, camera), np.uint8)) for color, _ in files)
        T, error = locate_camera(images, camera.K, camera.distortion, board, camera.name)
        located.append(replace(camera, T_world_camera=T))
        results.append((camera.name, error, error > POOR))
    own = folder / "cameras.json"
    with atomic_file(own if own.is_file() else recording / "cameras.json") as temporary:
        temporary.write_text(cameras_text(located))
    return results
