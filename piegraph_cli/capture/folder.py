"""The recording that is recorded into: its cameras.json with poses of an earlier calibration, and names for new takes."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from piegraph_cli.errors import UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.folders import entries_of, sequences_in
from piegraph_cli.recording.layout import CameraEntry, CamerasFile, cameras_file_text, read_cameras_file

SAME = 0.01
"""Share by which focal lengths and centres may differ from those of an earlier time."""


def known_cameras(recording: Path) -> CamerasFile | None:
    """The cameras.json of a recording, if there is one. Raises `UsageError` for a folder that is something else."""
    if recording.exists() and not recording.is_dir():
        raise UsageError("is a file", str(recording), "give a folder")
    if (recording / "cameras.json").is_file():
        return read_cameras_file(recording / "cameras.json")
    if recording.is_dir() and entries_of(recording):
        raise UsageError("is no recording, and not empty", str(recording), "give a new folder")
    return None


def names_of(known: CamerasFile | None) -> dict[str, str]:
    """Names of cameras by serial number."""
    return {entry.serial: name for name, entry in known.cameras.items() if entry.serial} if known else {}


def update_cameras(recording: Path, known: CamerasFile | None, now: Mapping[str, Camera]) -> list[str]:
    """Write cameras.json for the cameras as they are now, by name; poses of those that are as they were stay.

    Returns what a user should know.
    Raises `UsageError` where sequences that are there already were recorded otherwise: one file describes them all.
    """
    notes, entries = [], {}
    if known is not None and sequences_in(recording):
        _check_same(recording, known, now)
    for name, camera in now.items():
        entry = CameraEntry(
            width=camera.width,
            height=camera.height,
            K=camera.K.tolist(),
            distortion=camera.distortion.tolist(),
            depth_scale=camera.depth_scale,
            serial=camera.name,
        )
        before = known.cameras.get(name) if known else None
        if before is not None and before.T_world_camera is not None:
            if _is(before, camera):
                entry = before.model_copy(update={"serial": camera.name, "depth_scale": camera.depth_scale})
            else:
                notes.append(f"{name} is another camera or size than before: its pose is dropped, calibrate again")
        entries[name] = entry
    file = CamerasFile(cameras=entries, calibration_sequence=known.calibration_sequence if known else None)
    recording.mkdir(parents=True, exist_ok=True)
    with atomic_file(recording / "cameras.json") as temporary:
        temporary.write_text(cameras_file_text(file))
    return notes


def _is(entry: CameraEntry, camera: Camera) -> bool:
    """Whether a camera is the one of an entry, as far as can be told."""
    same_size = (entry.width, entry.height) == (camera.width, camera.height)
    return same_size and entry.serial in (None, camera.name) and bool(np.allclose(entry.K, camera.K, rtol=SAME, atol=1))


def _check_same(recording: Path, known: CamerasFile, now: Mapping[str, Camera]) -> None:
    hint = "record into another folder"
    if set(known.cameras) != set(now):
        before, after = ", ".join(sorted(known.cameras)), ", ".join(sorted(now))
        raise UsageError(f"its sequences have the cameras {before}, now there are {after}", str(recording), hint)
    for name, camera in now.items():
        entry = known.cameras[name]
        if not _is(entry, camera):
            was = f"{entry.serial or 'unknown'}, {entry.width} x {entry.height}"
            text = f"its sequences have {name} as {was}; now it is {camera.name}, {camera.width} x {camera.height}"
            raise UsageError(text, str(recording), hint)


def next_name(recording: Path) -> str:
    """The name of the next take."""
    taken = {path.name for path in entries_of(recording)} if recording.is_dir() else set()
    taken |= {name[1:].removesuffix(".part") for name in unfinished(recording)}
    return next(name for n in range(len(taken) + 1) if (name := f"sequence_{n:04d}") not in taken)


def unfinished(recording: Path) -> list[str]:
    """What takes left that were killed."""
    return sorted(path.name for path in recording.glob(".*.part"))
