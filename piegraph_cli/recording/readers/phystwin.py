"""PhysTwin cases, raw recordings and processed ones: colour by camera as images or a video, depth as `.npy`, poses pickled.

`color/CAM/STEP.png` or `color/CAM.mp4`, `depth/CAM/STEP.npy` (uint16 mm, aligned to colour), `metadata.json`
(`intrinsics`, `WH`, `fps`, and of raw recordings the time of each step under `recording`), `calibrate.pkl` (camera to
world, z down: the world is turned about x), and of processed cases masks: `mask/mask_info_CAM.json`, `mask/CAM/ID/STEP.png`.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, check_intrinsics, check_transform
from piegraph_cli.recording.film import Film
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.layout import image_size, read_color, read_mask
from piegraph_cli.recording.numbers import by_number, frame_gaps
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.plain import load_depth, load_pickle
from piegraph_cli.recording.timing import check_times
from piegraph_cli.recording.video import VideoFrames

TURN = np.diag([1.0, -1.0, -1.0, 1.0])
HANDLERS = re.compile("hand|arm|finger|gripper|robot|controller|human|person", re.IGNORECASE)
"""In the names of masks that are not the object's."""
LAST = 2**62
"""No step is so late."""


@dataclass(frozen=True)
class _Images:
    """One camera's images, by step."""

    camera: Camera
    steps: list[int]
    depths: Mapping[int, Path]
    colors: Mapping[int, Path] | VideoFrames
    masks: list[Mapping[int, Path]]

    def color(self, k: int) -> bytes:
        if isinstance(self.colors, VideoFrames):
            return self.colors.encoded(self.steps[k])
        return read_color(self.colors[self.steps[k]], self.camera)

    def depth(self, k: int) -> tuple[np.ndarray, bytes | None]:
        return load_depth(self.depths[self.steps[k]], self.camera.name, (self.camera.height, self.camera.width)), None

    def mask(self, k: int) -> np.ndarray | None:
        files = [masks[self.steps[k]] for masks in self.masks if self.steps[k] in masks]
        return np.any([read_mask(file, self.camera) for file in files], axis=0) if files else None


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """The films of a case, one a camera, and what was taken for granted."""
    about = _Metadata(folder / "metadata.json")
    names = sorted((path.name for path in entries_of(folder / "depth") if path.is_dir()), key=lambda n: (len(n), n))
    poses = _poses(folder / "calibrate.pkl", len(about.intrinsics))
    wanted = [str(c) for c in range(len(poses))]
    if names != wanted:
        odd = sorted(set(names) ^ set(wanted))[0]
        what = "has depth, but no pose" if odd in names else "has a pose, but no folder of depth"
        raise DataError(f"camera {odd} {what}", str(folder), "copy depth/ and calibrate.pkl of one recording")
    films, notes = [], ["z points down there: the world was turned about x"]
    for c, T in enumerate(poses):
        camera = Camera(str(c), about.width, about.height, about.intrinsics[c], np.zeros(5), TURN @ T)
        film, gaps = _film(folder, camera, about)
        films.append(film)
        notes += gaps
    bare = [film.camera.name for film in films if not film.images.masks]  # type: ignore[attr-defined]
    if 0 < len(bare) < len(films):
        notes.append(f"mask/ has no mask of an object for camera {', '.join(bare)}: it will show nothing")
    return films, notes


def _film(folder: Path, camera: Camera, about: "_Metadata") -> tuple[Film, list[str]]:
    name, where = camera.name, str(folder / "depth" / camera.name)
    depths = _by_step(folder / "depth" / name, (".npy",), name)
    video = folder / "color" / f"{name}.mp4"
    colors: Mapping[int, Path] | VideoFrames
    size = camera.width, camera.height
    if (folder / "color" / name).is_dir():
        colors = _by_step(folder / "color" / name, (".png", ".jpg"), name)
        odd = sorted(colors.keys() ^ depths.keys())
        if odd:
            message = f"{len(colors)} colour and {len(depths)} depth images; first unpaired frame {odd[0]}"
            raise DataError(message, f"{folder}, camera {name}", "each step needs a colour and a depth image")
        first = next(iter(colors.values()))
        _check_size(image_size(first, name), size, f"{first}, camera {name}")
    elif video.is_file():
        colors = VideoFrames(video, name)
        _check_size(colors.size, size, f"{video}, camera {name}")
    else:
        raise DataError(f"camera {name} has no colour", str(folder / "color"), f"expected color/{name}/ or {name}.mp4")
    steps = sorted(depths)
    times, gaps = about.times(name, steps), frame_gaps([depths[step] for step in steps], where)
    gaps += check_times(times, f"{folder / 'metadata.json'}, camera {name}")
    images = _Images(camera, steps, depths, colors, _object_masks(folder / "mask", name))
    return Film(camera, times, images, np.array(steps, np.int64)), gaps


def _check_size(found: tuple[int, int], wanted: tuple[int, int], where: str) -> None:
    if found != wanted:
        message = f"is {found[0]} x {found[1]}, metadata.json says {wanted[0]} x {wanted[1]}"
        raise DataError(message, where, "correct WH and intrinsics in metadata.json")


def _by_step(folder: Path, suffixes: tuple[str, ...], camera: str) -> dict[int, Path]:
    """The files of a folder by the number that is their name."""
    found = by_number([path for path in entries_of(folder) if path.suffix.lower() in suffixes])
    odd = next(
        (
            path.name
            for number, path in found.items()
            if len(number) > 1 or number[0] != int(number[0]) or number[0] >= LAST
        ),
        None,
    )
    if odd or not found:
        what = f"{odd} is not named by a number" if odd else f"no {' or '.join(suffixes)} files"
        raise DataError(f"camera {camera}: {what}", str(folder), "images are named STEP")
    return {int(number[0]): path for number, path in found.items()}


def _object_masks(folder: Path, name: str) -> list[Mapping[int, Path]]:
    """The files of each mask that is not a hand's, by step; none where the case has no masks."""
    path = folder / f"mask_info_{name}.json"
    if not path.is_file():
        return []
    found = _read_json(path)
    ids = [str(key) for key, value in found.items() if not HANDLERS.search(str(value)) and str(key).isdigit()]
    return [_by_step(folder / name / key, (".png",), name) for key in ids if (folder / name / key).is_dir()]


class _Metadata:
    """`metadata.json`, checked."""

    def __init__(self, path: Path):
        self.path, self.fields = path, _read_json(path)
        self.intrinsics = self._numbers("intrinsics", (-1, 3, 3))
        self.width, self.height = (int(n) for n in self._numbers("WH", (2,)))
        for c, K in enumerate(self.intrinsics):
            check_intrinsics(K, f"intrinsics of camera {c}", str(path))
        if min(self.width, self.height) <= 0:
            raise DataError("sizes must be positive", str(path), "it holds intrinsics [N, 3, 3] and WH")

    def _numbers(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        hint = "copy it from the recording again"
        try:
            values = np.array(self.fields[name], float)
        except KeyError:
            raise DataError(f"has no {name}", str(self.path), hint) from None
        except (ValueError, TypeError, OverflowError):
            raise DataError(f"{name} are not numbers", str(self.path), hint) from None
        fits = values.ndim == len(shape) and all(w in (-1, n) for n, w in zip(values.shape, shape, strict=True))
        if not fits or not np.isfinite(values).all():
            raise DataError(f"{name} are {list(values.shape)}, expected finite {list(shape)}", str(self.path), hint)
        return values

    def times(self, camera: str, steps: list[int]) -> np.ndarray:
        """Seconds of a camera's steps: as recorded, or at the rate of a processed case."""
        if "recording" not in self.fields:
            rate = float(self._numbers("fps", ()))
            if rate <= 0:
                raise DataError(f"fps is {rate:g}", str(self.path), "frames a second")
            return np.array(steps) / rate
        recording = self.fields["recording"]
        of_camera: Any = recording.get(camera) if isinstance(recording, dict) else None
        times = []
        for step in steps:
            try:
                times.append(float(of_camera[str(step)]))
            except (KeyError, TypeError, ValueError, OverflowError):
                hint = "copy it from the recording again, or remove the images of that frame"
                message = f"recording has no time of camera {camera}, frame {step}"
                raise DataError(message, str(self.path), hint) from None
        return np.array(times)


def _poses(path: Path, count: int) -> list[np.ndarray]:
    """`T_world_camera` of each camera, the world as it is there."""
    found = load_pickle(path)
    hint = "it holds a list of a 4 x 4 matrix per camera, camera to world"
    try:
        poses = np.array(found, float)
    except (ValueError, TypeError, OverflowError):
        raise DataError("does not hold matrices", str(path), hint) from None
    if poses.shape != (count, 4, 4) or not np.isfinite(poses).all():
        message = f"holds {list(poses.shape)}, and metadata.json has intrinsics of {count} cameras"
        raise DataError(message, str(path), hint)
    return [check_transform(T, "the pose", f"{path}, camera {c}", hint) for c, T in enumerate(poses)]


def _read_json(path: Path) -> dict[str, Any]:
    try:
        if not path.is_file():
            raise ValueError("no regular file")
        found = json.loads(path.read_text())
        if not isinstance(found, dict):
            raise ValueError("not an object")
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"cannot be read: {error}", str(path), "copy it from the recording again") from None
    return found
