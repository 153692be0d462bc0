"""Bags written out in the layout of docs/formats.md: what `calibrate` needs, and a look at what is in them."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.files import MAKE_ROOM, atomic_file
from piegraph_cli.recording import layout
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.images import encode_depth
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.readers import ros

PNG = b"\x89PNG"


def unpack(bag: Path, out: Path) -> tuple[str, int, list[str]]:
    """Write the sequence in a bag, or in a folder of bags, below `out`: its name there, images of a camera, and warnings.

    A sequence is there whole or not at all. Its cameras go to `out`/cameras.json, with poses where `tf` tells them all; one
    that is there already stays, and must have the same cameras. Raises `DataError` for what cannot be read, and what is there.
    """
    films, notes = ros.read(bag, ReadParams(), posed=False)
    sequence = out / (bag.stem if bag.is_file() else bag.name)
    if sequence.exists():
        raise DataError("is there already", str(sequence), "remove it, or choose another --out")
    cameras = [film.camera for film in films]
    text = _cameras_text(cameras)
    _check_cameras(out / "cameras.json", cameras)
    partial = out / f".{sequence.name}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    try:
        for film in films:
            for k in range(len(film.times)):
                color, (depth, _) = film.images.color(k), film.images.depth(k)
                suffix = ".png" if color.startswith(PNG) else ".jpg"
                _write(partial / film.camera.name / "color" / f"{k:06d}{suffix}", color)
                _write(partial / film.camera.name / "depth" / f"{k:06d}.png", encode_depth(depth))
            layout.write_times(partial, film.camera, film.times)
        if not (out / "cameras.json").exists():
            with atomic_file(out / "cameras.json") as temporary:
                temporary.write_text(text)
        partial.rename(sequence)
    except OSError as error:
        raise DataError(f"cannot be written: {error}", str(sequence), MAKE_ROOM) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return sequence.name, max(len(film.times) for film in films), notes


def _cameras_text(cameras: list[Camera]) -> str:
    """The text of a cameras.json, without poses where one of them is unknown."""
    known = all(np.isfinite(camera.T_world_camera).all() for camera in cameras)
    posed = cameras if known else [replace(camera, T_world_camera=np.eye(4)) for camera in cameras]
    entries = {camera.name: layout.CameraEntry.model_validate(layout.entry_of(camera)) for camera in posed}
    if not known:
        entries = {name: entry.model_copy(update={"T_world_camera": None}) for name, entry in entries.items()}
    return layout.cameras_file_text(layout.CamerasFile(cameras=entries))


def _check_cameras(path: Path, cameras: list[Camera]) -> None:
    """Refuse a cameras.json of other cameras, by names and sizes."""
    if not path.exists():
        return
    entries = layout.read_cameras_file(path).cameras
    there = {name: (entry.width, entry.height) for name, entry in entries.items()}
    if there != {camera.name: (camera.width, camera.height) for camera in cameras}:
        names = ", ".join(sorted(camera.name for camera in cameras))
        raise DataError(f"is of other cameras than the bag, which has {names}", str(path), "choose another --out")


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
