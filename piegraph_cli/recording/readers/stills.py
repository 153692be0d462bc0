"""One image of each camera, for a look at a scene: a folder of `NAME_color.png` and `NAME_depth.png` with the cameras.

Cameras are in `cameras.json`; or, for views of one camera, its intrinsics are in `intrinsics.txt` (3 x 3, or fx fy cx cy;
a longer name will do) and each view's pose, camera to world, in `NAME_pose.txt`. A dot or a dash may stand in place of
the underscore.
"""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, check_intrinsics, check_transform
from piegraph_cli.recording.film import Film, ImageFiles
from piegraph_cli.recording.folders import STILL, entries_of
from piegraph_cli.recording.layout import image_size, read_cameras
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.text import read_numbers


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """A film of one image for each camera, and what was taken for granted."""
    found: dict[str, dict[str, Path]] = {}
    for path in sorted(p for p in entries_of(folder) if p.is_file()):
        if told := STILL.fullmatch(path.name):
            kind = "color" if told["kind"] in ("color", "colour", "rgb") else told["kind"]
            other = found.setdefault(told["name"], {}).setdefault(kind, path)
            if other != path:
                raise DataError(f"{other.name} and {path.name} are the same image", str(folder), "remove one of them")
    views = {name: files for name, files in found.items() if "depth" in files}
    for name, files in found.items():
        lacking = next((kind for kind in ("color", "depth") if kind not in files), None)
        if lacking:
            hint = f"expected {name}_color.png and {name}_depth.png"
            raise DataError(f"camera {name} has no {lacking} image", str(folder), hint)
    cameras, notes = _cameras(folder, views)
    images = {c.name: ImageFiles(c, [(views[c.name]["color"], views[c.name]["depth"])]) for c in cameras}
    return [Film(c, np.zeros(1), images[c.name], np.zeros(1, np.int64)) for c in cameras], notes


def _cameras(folder: Path, views: dict[str, dict[str, Path]]) -> tuple[list[Camera], list[str]]:
    plain = next((p for p in sorted(entries_of(folder)) if "intrinsics" in p.name and p.suffix == ".txt"), None)
    if (folder / "cameras.json").is_file() or plain is None:
        cameras = read_cameras(folder)
        odd = sorted({c.name for c in cameras} ^ views.keys())
        if odd:
            what = (
                "has images, but is not in cameras.json" if odd[0] in views else "is in cameras.json but has no image"
            )
            raise DataError(f"camera {odd[0]} {what}", str(folder), "add it, or remove what there is of it")
        return cameras, []
    K = _intrinsics(plain)
    cameras = []
    for name, files in sorted(views.items()):
        pose, hint = files.get("pose"), f"write {name}_pose.txt: 4 x 4, camera to world; or cameras.json"
        if pose is None:
            raise DataError(f"camera {name} has no pose", str(folder), hint)
        numbers = read_numbers(pose, hint, commas=True)
        if len(numbers) != 16:
            raise DataError(f"holds {len(numbers)} numbers", str(pose), hint)
        T = check_transform(numbers.reshape(4, 4), "the pose", str(pose), hint)
        cameras.append(Camera(name, *image_size(files["color"], name), K, np.zeros(5), T))
    return cameras, ["depth is taken to be in millimetres, and z to point up"]


def _intrinsics(path: Path) -> np.ndarray:
    values = read_numbers(path, "numbers with spaces between", commas=True)
    if len(values) == 4:
        values = np.array([values[0], 0, values[2], 0, values[1], values[3], 0, 0, 1])
    if len(values) != 9:
        raise DataError("must hold a 3 x 3 matrix, or fx fy cx cy", str(path), "focal lengths are positive pixels")
    return check_intrinsics(values.reshape(3, 3), "the matrix", str(path))
