"""Recordings of GBND: `camera_I/000000.jpg`, `000000_depth.png` (mm), intrinsics and world-to-camera poses as `.npy`.

The world of these recordings has z down: it is turned about x, so that z is up here. There are no time stamps.
"""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.film import Film, ImageFiles
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.layout import check_transform, image_size
from piegraph_cli.recording.numbers import by_number, frame_numbers
from piegraph_cli.recording.params import ReadParams

RATE = 30.0
"""Frames a second, which the recordings do not tell."""
TURN = np.diag([1.0, -1.0, -1.0, 1.0])
LARGEST = 1 << 16
"""Bytes of a file of intrinsics or of a pose."""


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """The films of a sequence folder, one a camera, and what was taken for granted."""
    cameras = sorted(path for path in entries_of(folder) if (path / "camera_params.npy").is_file())
    films = [_read_film(path) for path in cameras]
    notes = [
        f"no time stamps: {RATE:g} frames a second are taken for granted",
        "z points down there: the world was turned about x",
    ]
    return films, notes


def _read_film(folder: Path) -> Film:
    images = [path for path in entries_of(folder) if path.is_file() and path.suffix.lower() in (".jpg", ".png")]
    color = by_number([path for path in images if not path.stem.endswith("_depth")])
    depth = by_number([path for path in images if path.stem.endswith("_depth")])
    odd = sorted(color.keys() ^ depth.keys())
    if odd or not color:
        first = f"; first unpaired {(color.get(odd[0]) or depth[odd[0]]).name}" if odd else ""
        message = f"{len(color)} colour and {len(depth)} depth images{first}"
        raise DataError(message, str(folder), "each frame needs NNNNNN.jpg and NNNNNN_depth.png")
    files = [(path, depth[number]) for number, path in color.items()]
    fx, fy, cx, cy = _load(folder / "camera_params.npy", (4,))
    if min(fx, fy) <= 0:
        raise DataError("focal lengths must be positive", str(folder / "camera_params.npy"), "it holds fx, fy, cx, cy")
    pose = folder / "camera_extrinsics.npy"
    T = check_transform(_load(pose, (4, 4)), "the pose", str(pose), "it maps points of the world to the camera")
    width, height = image_size(files[0][0], folder.name)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    numbers = frame_numbers([path for path, _ in files])
    if (np.diff(numbers) <= 0).any():
        raise DataError("the last number in the names of images does not rise", str(folder), "number them in order")
    camera = Camera(folder.name, width, height, K, np.zeros(5), TURN @ np.linalg.inv(T))
    return Film(camera, numbers / RATE, ImageFiles(camera, files), numbers)


def _load(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Finite numbers of that shape from a `.npy` file; nothing is unpickled."""
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError("too large")
        values = np.asarray(np.load(path, allow_pickle=False), float)
    except (OSError, ValueError, TypeError, EOFError) as error:
        raise DataError(f"cannot be read: {error}", str(path), f"expected a plain array {shape}") from None
    if values.shape != shape or not np.isfinite(values).all():
        raise DataError(f"holds an array {values.shape}", str(path), f"expected finite numbers {shape}")
    return values
