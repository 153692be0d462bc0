"""Recordings of GBND: `camera_I/000000.jpg`, `000000_depth.png` (mm), intrinsics and world-to-camera poses as `.npy`.

The world of these recordings has z down: it is turned about x, so that z is up here. There are no time stamps.
"""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, check_transform
from piegraph_cli.recording.film import Film, ImageFiles
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.layout import image_size
from piegraph_cli.recording.numbers import by_number, frame_gaps, frame_numbers
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.plain import load_numbers

RATE = 30.0
"""Frames a second, which the recordings do not tell."""
TURN = np.diag([1.0, -1.0, -1.0, 1.0])


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """The films of a sequence folder, one a camera, and what was taken for granted."""
    named = (path for path in entries_of(folder) if path.is_dir())
    cameras = sorted(p for p in named if p.name.startswith("camera_") or (p / "camera_params.npy").is_file())
    films = [_read_film(path) for path in cameras]
    notes = [
        f"no time stamps: {RATE:g} frames a second are taken for granted",
        "z points down there: the world was turned about x",
    ]
    return [film for film, _ in films], notes + [gap for _, gaps in films for gap in gaps]


def _read_film(folder: Path) -> tuple[Film, list[str]]:
    images = [path for path in entries_of(folder) if path.is_file() and path.suffix.lower() in (".jpg", ".png")]
    color = by_number([path for path in images if not path.stem.endswith("_depth")])
    depth = by_number([path for path in images if path.stem.endswith("_depth")])
    odd = sorted(color.keys() ^ depth.keys())
    if odd or not color:
        first = f"; first unpaired {(color.get(odd[0]) or depth[odd[0]]).name}" if odd else ""
        message = f"{len(color)} colour and {len(depth)} depth images{first}"
        raise DataError(message, str(folder), "each frame needs NNNNNN.jpg and NNNNNN_depth.png")
    files = [(path, depth[number]) for number, path in color.items()]
    fx, fy, cx, cy = load_numbers(folder / "camera_params.npy", (4,))
    if min(fx, fy) <= 0:
        raise DataError("focal lengths must be positive", str(folder / "camera_params.npy"), "it holds fx, fy, cx, cy")
    pose = folder / "camera_extrinsics.npy"
    T = check_transform(load_numbers(pose, (4, 4)), "the pose", str(pose), "it maps points of the world to the camera")
    width, height = image_size(files[0][0], folder.name)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    numbers, gaps = frame_numbers(list(color.values())), frame_gaps(list(color.values()), str(folder))
    if (np.diff(numbers) <= 0).any():
        raise DataError("the last number in the names of images does not rise", str(folder), "number them in order")
    camera = Camera(folder.name, width, height, K, np.zeros(5), TURN @ np.linalg.inv(T))
    return Film(camera, numbers / RATE, ImageFiles(camera, files), numbers), gaps
