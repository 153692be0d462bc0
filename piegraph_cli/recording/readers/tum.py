"""TUM RGB-D: `rgb.txt` and `depth.txt` list images by time, `groundtruth.txt` has the pose; one camera, at rest here.

Intrinsics are not part of the layout: `calibration.txt` (fx fy cx cy, then distortion) is read where there is one, and
those that were published are known of folders named after the three cameras of the data set's authors.
"""

import re
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, check_lens, check_transform
from piegraph_cli.recording.film import Film, ImageFiles
from piegraph_cli.recording.layout import image_size
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.text import parse_number, read_lines, read_numbers, read_table
from piegraph_cli.recording.timing import check_times, matched

LAYOUT = "see docs/formats.md for the layout"
DEPTH_SCALE = 1 / 5000
SKEW = 0.02
"""Seconds that colour and depth of a frame may be apart."""
LARGEST = 1e12
"""Times and metres that are none; such lines are left out, as those without numbers."""
AT_REST, TURNED = 0.01, 1.0
"""Metres and degrees that the camera may move in a sequence."""
PUBLISHED = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6, 0.0, 0.0, 0.0, 0.0, 0.0),
}


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """The film of a sequence folder, and warnings."""
    (times, color), (depth_times, depth) = _read_list(folder / "rgb.txt"), _read_list(folder / "depth.txt")
    gaps = check_times(times, str(folder / "rgb.txt"))
    check_times(depth_times, str(folder / "depth.txt"))
    paired, partner = matched(times, depth_times, SKEW)
    if len(paired) < len(times) / 2:
        message = f"{len(paired)} of {len(times)} colour images have a depth image within {SKEW:g} s"
        raise DataError(message, str(folder), "check the times in rgb.txt and depth.txt")
    if len(paired) < len(times):
        gaps.append(f"{len(times) - len(paired)} colour images without a depth image within {SKEW:g} s left out")
    files = [(color[k], depth[n]) for k, n in zip(paired, partner, strict=True)]
    K, distortion = _intrinsics(folder)
    width, height = image_size(files[0][0], "rgb")
    check_lens(K, distortion, (width, height), "the distortion", str(folder / "calibration.txt"))
    camera = Camera("rgb", width, height, K, distortion, _pose(folder, times[paired]), DEPTH_SCALE)
    return [Film(camera, times[paired], ImageFiles(camera, files), paired.astype(np.int64))], gaps


def _read_list(path: Path) -> tuple[np.ndarray, list[Path]]:
    """Times [image] (s) and image files of a list."""
    rows = [(n, line.split()) for n, line in read_lines(path, LAYOUT)]
    if not rows or any(len(words) != 2 for _, words in rows):
        raise DataError("lines must be: time file", str(path), "lists of the TUM RGB-D layout have two columns")
    files = [path.parent / words[1] for _, words in rows]
    missing = next((f for f in files if not f.is_file()), None)
    missing = missing or next((f for f in files if not f.resolve().is_relative_to(path.parent.resolve())), None)
    if missing:
        raise DataError(f"image {missing.name} is not in the sequence", str(path), "copy rgb/ and depth/ as a whole")
    return np.array([_time(words[0], f"{path}, line {n}") for n, words in rows]), files


def _time(word: str, where: str) -> float:
    try:
        return parse_number(word)
    except ValueError as error:
        raise DataError(str(error), where, LAYOUT) from None


def _intrinsics(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    path = folder / "calibration.txt"
    known = re.search("freiburg[123]", folder.name)
    if path.is_file():
        values = read_numbers(path, LAYOUT)
    elif known:
        values = np.array(PUBLISHED[known.group()])
    else:
        raise DataError("the camera's intrinsics are missing", str(folder), "write calibration.txt: fx fy cx cy")
    if len(values) not in (4, 8, 9, 12) or not np.isfinite(values).all() or min(values[:2]) <= 0:
        message = "must hold fx fy cx cy, and 4, 5 or 8 numbers of distortion"
        raise DataError(message, str(path), "write them in one line, with spaces between")
    fx, fy, cx, cy = values[:4]
    distortion = np.pad(values[4:], (0, max(0, 9 - len(values))))
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), distortion


def _pose(folder: Path, times: np.ndarray) -> np.ndarray:
    """`T_world_camera` [4, 4], the median of those at `times` (s). Raises `DataError` where the camera moves."""
    from scipy.spatial.transform import Rotation

    path = folder / "groundtruth.txt"
    rows = read_table(path, LAYOUT, 8, bounded=False)
    rows = rows[(np.abs(rows) < LARGEST).all(1)]
    during = rows[(rows[:, 0] >= times[0] - 1) & (rows[:, 0] <= times[-1] + 1)]
    if not len(during) or (np.abs(np.log2(np.linalg.norm(during[:, 4:], axis=1))) > 1).any():
        raise DataError("has no pose at the time of the images", str(path), "lines are: time tx ty tz qx qy qz qw")
    turns = Rotation.from_quat(during[:, 4:])
    middle = len(during) // 2
    shift = np.linalg.norm(during[:, 1:4] - np.median(during[:, 1:4], axis=0), axis=1).max()
    angle = np.degrees((turns[middle].inv() * turns).magnitude().max())
    if shift > AT_REST or angle > TURNED:
        message = f"the camera moves by {shift * 1000:.0f} mm and {angle:.1f} degrees"
        raise DataError(message, str(path), "only cameras at rest can be used")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turns.mean().as_matrix(), np.median(during[:, 1:4], axis=0)
    return check_transform(T, "the pose", str(path), "lines are: time tx ty tz qx qy qz qw")
