"""One recorded sequence, checked, on one clock, as arrays."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.end_effector import at_frames
from piegraph_cli.recording.film import Film
from piegraph_cli.recording.folders import layout_of
from piegraph_cli.recording.images import encode_depth, encode_mask, join_images
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.readers import read_films, read_path
from piegraph_cli.recording.registration import register_depth
from piegraph_cli.recording.timing import align_frames

SMOOTHER = 8
"""Times that depth is smoother with its bytes exchanged where they were exchanged before."""
Progress = Callable[[Iterable[int]], Iterable[int]]


def read_sequence(
    folder: Path, params: ReadParams, progress: Progress = iter
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Cameras, times and encoded images of one sequence folder as the datasets of a frames artifact, and warnings.

    Raises `DataError` naming file, camera and frame.
    """
    layout = layout_of(folder, params.layout)
    films, warnings = read_films(folder, layout, params)
    path = read_path(folder, layout, params)
    time, source, alone = align_frames(
        {f.camera.name: f.times for f in films}, params.fps, params.max_skew, str(folder)
    )
    if len(time) < 2:
        hint = "piegraph look shows what is there" if layout == "stills" else "record longer, or remove this sequence"
        raise DataError("one frame: nothing can be seen to move", str(folder), hint)
    clock = np.mean([film.times[source[:, c]] for c, film in enumerate(films)], axis=0)
    tool, gaps = at_frames(path, clock, params.tool_point) if path else ({}, [])
    images, blind = _read_images(films, source, progress)
    _check_byte_order(folder, films, source[0])
    cameras = [film.camera for film in films]
    _check_depth(folder, cameras, blind)
    arrays = images | tool | _camera_arrays(cameras)
    arrays["time"] = time
    arrays["source_frame"] = np.stack([film.numbers[source[:, c]] for c, film in enumerate(films)], 1)
    warnings += alone + gaps
    if blind.any():
        frame, c = np.argwhere(blind)[0]
        warnings.append(f"{blind.sum()} depth images without a reading, first: camera {cameras[c].name}, frame {frame}")
    return arrays, warnings


def _camera_arrays(cameras: list[Camera]) -> dict[str, np.ndarray]:
    return {
        "camera_name": np.array([c.name for c in cameras]),
        "image_size": np.array([[c.width, c.height] for c in cameras]),
        "K": np.array([c.K for c in cameras]),
        "distortion": np.array([c.distortion for c in cameras]),
        "depth_scale": np.array([c.depth_scale for c in cameras]),
        "T_world_camera": np.array([c.T_world_camera for c in cameras]),
    }


def _read_images(films: list[Film], source: np.ndarray, progress: Progress) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Encoded images of the frames `source` [F, C], depth registered to colour; which depth images [F, C] are empty.

    Masks are among them where the recording has any; those it lacks have no bytes.
    """
    color, depth, masks, blind = [], [], [], np.zeros(source.shape, bool)
    for frame in progress(range(len(source))):
        for c, film in enumerate(films):
            k = int(source[frame, c])
            color.append(film.images.color(k))
            image, encoded = film.images.depth(k)
            if film.camera.depth_view is not None:
                image, encoded = register_depth(image, film.camera), None
            depth.append(encoded or encode_depth(image))
            blind[frame, c] = not image.any()
            mask = film.images.mask(k)
            masks.append(b"" if mask is None else encode_mask(mask))
    arrays: dict[str, np.ndarray] = {}
    for name, images in [("color", color), ("depth", depth), *([("mask", masks)] if any(masks) else [])]:
        arrays[name], arrays[f"{name}_offsets"] = join_images(images)
    return arrays, blind


def _check_byte_order(folder: Path, films: list[Film], first: np.ndarray) -> None:
    """Refuse depth whose two bytes are exchanged: neighbours then differ by hundreds of times as much."""

    def roughness(image: np.ndarray) -> float:
        steps = np.abs(np.diff(image.astype(np.int32), axis=1))[(image[:, 1:] > 0) & (image[:, :-1] > 0)]
        return float(steps.mean()) if len(steps) else 0.0

    for film, k in zip(films, first, strict=True):
        image = film.images.depth(int(k))[0]
        if roughness(image.byteswap()) * SMOOTHER < roughness(image):
            message = f"the two bytes of depth are exchanged (big-endian), frame {film.numbers[k]}"
            raise DataError(
                message, f"{folder}, camera {film.camera.name}", "write each value's bytes the other way round"
            )


def _check_depth(folder: Path, cameras: list[Camera], blind: np.ndarray) -> None:
    for c in np.flatnonzero(blind.all(0)):
        raise DataError(
            f"every depth image of camera {cameras[c].name} is zero, from frame 0 on",
            str(folder / cameras[c].name / "depth"),
            "check that depth was recorded, or leave the camera out: its folder, and what cameras.json has of it",
        )
