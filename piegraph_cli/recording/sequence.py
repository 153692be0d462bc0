"""One recorded sequence, checked, on one clock, as arrays."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.clocks import OFF, TOLD, changes, compare_clocks, explained, moving
from piegraph_cli.recording.end_effector import at_frames
from piegraph_cli.recording.film import Film
from piegraph_cli.recording.folders import layout_of
from piegraph_cli.recording.frozen import find_frozen
from piegraph_cli.recording.images import ImageStack, encode_depth, encode_mask, join_images
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.readers import read_films, read_path
from piegraph_cli.recording.registration import register_depth
from piegraph_cli.recording.timing import FEWEST, align_frames, frame_times

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
    films = _on_one_clock(films, params.offsets, folder)
    path = read_path(folder, layout, params)
    try:
        time, source, alone = align_frames(
            {f.camera.name: f.times for f in films}, params.fps, params.max_skew, str(folder)
        )
    except DataError as error:
        raise _with_clocks(error, films) from None
    if len(time) < 2:
        raise _one_frame(films, layout, folder)
    stamps = frame_times([film.times for film in films], source)
    clock = stamps.mean(1)
    tool, gaps = at_frames(path, clock, params.tool_point) if path else ({}, [])
    images, blind, stopped = _read_images(films, source, progress)
    there = [int(source[source[:, c] >= 0, c][0]) for c in range(len(films))]
    _check_byte_order(folder, films, there)
    cameras = [film.camera for film in films]
    _check_depth(folder, cameras, blind)
    warnings += _copied(cameras, images, blind)
    warnings += _check_frozen(folder, cameras, *stopped)
    source = np.where(stopped[0] & (source >= 0), ~source, source)
    arrays = images | tool | _camera_arrays(cameras)
    arrays["time"] = time
    arrays["stamp"] = stamps - clock[0]
    numbers = [film.numbers[np.maximum(source[:, c], 0)] for c, film in enumerate(films)]
    arrays["source_frame"] = np.where(source >= 0, np.stack(numbers, 1), -1)
    warnings += alone + gaps
    if blind.any():
        frame, c = np.argwhere(blind)[0]
        warnings.append(f"{blind.sum()} depth images without a reading, first: camera {cameras[c].name}, frame {frame}")
    return arrays, warnings


def _one_frame(films: list[Film], layout: str, folder: Path) -> DataError:
    most = max(films, key=lambda film: len(film.times))
    if len(most.times) > 2 and layout != "stills":
        span = most.times[-1] - most.times[0]
        message = f"all {len(most.times)} frames of camera {most.camera.name} lie within {span:.2g} s"
        return DataError(message, str(folder), "give the time stamps in seconds, or record longer")
    hint = "piegraph look shows what is there" if layout == "stills" else "record longer, or remove this sequence"
    return DataError("one frame: nothing can be seen to move", str(folder), hint)


def _on_one_clock(films: list[Film], offsets: dict[str, float], folder: Path) -> list[Film]:
    """The films with the offsets (s) of their cameras taken off their time stamps."""
    names = [film.camera.name for film in films]
    unknown = sorted(offsets.keys() - set(names))
    if unknown:
        raise UsageError(f"ingest.offsets: no camera {unknown[0]}", str(folder), f"cameras are {', '.join(names)}")
    return [replace(film, times=film.times - offsets.get(film.camera.name, 0.0)) for film in films]


def _with_clocks(error: DataError, films: list[Film]) -> DataError:
    """An error of frames that find no partners, with how late cameras are where their images tell it."""
    starts = np.array([film.times[0] for film in films])
    apart = max(starts) > min(film.times[-1] for film in films)
    starts = starts - starts[0] if apart else np.zeros(len(films))
    seen = []
    for film in films:
        data, offsets = join_images(film.images.color(k) for k in range(len(film.times)))
        stack = ImageStack(data, offsets, 1, "colour")
        seen.append(changes(moving(stack.grey(k, 0) for k in range(len(stack)))))
    clocks = compare_clocks(seen, [film.times - start for film, start in zip(films, starts, strict=True)])
    if clocks is None or clocks.fit.min() < TOLD:
        return error
    late = clocks.late + starts
    found = {f.camera.name: float(s) for f, s in zip(films, late, strict=True) if abs(s) > OFF[1] * clocks.step / 2}
    if not found:
        return error
    causes = [explained(name, s)[0] for name, s in found.items()]
    given = ",".join(f"{name}={s:.2f}" for name, s in found.items())
    return DataError(
        f"{error.message}; what moves in the images says: {'; '.join(causes)}",
        error.where,
        f"one clock for all cameras, or ingest.offsets = {given}",
    )


def _camera_arrays(cameras: list[Camera]) -> dict[str, np.ndarray]:
    return {
        "camera_name": np.array([c.name for c in cameras]),
        "image_size": np.array([[c.width, c.height] for c in cameras]),
        "K": np.array([c.K for c in cameras]),
        "distortion": np.array([c.distortion for c in cameras]),
        "depth_scale": np.array([c.depth_scale for c in cameras]),
        "T_world_camera": np.array([c.T_world_camera for c in cameras]),
    }


def _read_images(
    films: list[Film], source: np.ndarray, progress: Progress
) -> tuple[dict[str, np.ndarray], np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Encoded images of the frames `source` [F, C], depth registered to colour, and which depth images [F, C] are empty.

    Third, which colour and which depth images [F, C] a camera that stopped repeats: depth has no reading there. Masks are
    among the images where the recording has any; those it lacks have no bytes.
    """
    color, depth, masks, blind = [], [], [], np.zeros(source.shape, bool)
    for frame in progress(range(len(source))):
        for c, film in enumerate(films):
            k = int(source[frame, c])
            if k < 0:  # the nearest picture stands for one that is lost, without a reading of depth
                color.append(film.images.color(~k))
                depth.append(encode_depth(np.zeros((film.camera.height, film.camera.width), np.uint16)))
                masks.append(b"")
                continue
            color.append(film.images.color(k))
            image, encoded = film.depth(k)
            if film.camera.depth_view is not None:
                image, encoded = register_depth(image, film.camera), None
            depth.append(encoded or encode_depth(image))
            blind[frame, c] = not image.any()
            mask = film.images.mask(k)
            masks.append(b"" if mask is None else encode_mask(mask))
    stopped = find_frozen(color, depth, source >= 0)
    for frame, c in np.argwhere(stopped[0] | stopped[1]):
        size = films[c].camera.height, films[c].camera.width
        depth[frame * len(films) + c] = encode_depth(np.zeros(size, np.uint16))
    arrays: dict[str, np.ndarray] = {}
    for name, images in [("color", color), ("depth", depth), *([("mask", masks)] if any(masks) else [])]:
        arrays[name], arrays[f"{name}_offsets"] = join_images(images)
    return arrays, blind, stopped


def _check_byte_order(folder: Path, films: list[Film], first: list[int]) -> None:
    """Refuse depth whose two bytes are exchanged: neighbours then differ by hundreds of times as much."""

    def roughness(image: np.ndarray) -> float:
        steps = np.abs(np.diff(image.astype(np.int32), axis=1))[(image[:, 1:] > 0) & (image[:, :-1] > 0)]
        return float(steps.mean()) if len(steps) else 0.0

    for film, k in zip(films, first, strict=True):
        image = film.depth(k)[0]
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


def _copied(cameras: list[Camera], images: dict[str, np.ndarray], blind: np.ndarray) -> list[str]:
    """A word on two cameras whose images are the same byte for byte: one folder was copied over, or given twice."""
    kinds = [np.split(images[kind], images[f"{kind}_offsets"][1:-1]) for kind in ("color", "depth")]  # views, no copies
    warnings = []
    for one, other in combinations(range(len(cameras)), 2):
        seen = np.flatnonzero(~blind[:, [one, other]].any(1)) * len(cameras)
        if len(seen) and all(np.array_equal(of[f + one], of[f + other]) for of in kinds for f in seen):
            warnings.append(
                f"cameras {cameras[one].name} and {cameras[other].name} have the same images: one of the folders is a copy; "
                "bring back its own images, or leave the camera out"
            )
    return warnings


def _check_frozen(folder: Path, cameras: list[Camera], color: np.ndarray, depth: np.ndarray) -> list[str]:
    """Warnings of cameras whose colour or depth images [F, C] are repeated. Raises `DataError` where most of them are."""
    warnings = []
    for c, camera in enumerate(cameras):
        for kind, repeated in (("colour", color[:, c]), ("depth", depth[:, c])):
            frames = np.flatnonzero(repeated)
            if not len(frames):
                continue
            text = f"camera {camera.name} stopped: its {kind} repeats one picture from frame {frames[0]} on"
            text += f", in {len(frames)} of {len(repeated)} frames"
            if len(frames) > (1 - FEWEST) * len(repeated):
                hint = "record again, or leave the camera out: its folder, and what cameras.json has of it"
                raise DataError(text, str(folder / camera.name), hint)
            warnings.append(f"{text}; its depth counts for nothing there")
    return warnings
