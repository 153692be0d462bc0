"""The recording folder layout (docs/formats.md): reading it with checks that name file, camera and frame, and writing it.

RECORDING/cameras.json                    intrinsics, distortion, depth scale, T_world_camera per camera
RECORDING/SEQUENCE/cameras.json           optional, in place of the one above
RECORDING/SEQUENCE/CAMERA/timestamps.txt  one time stamp in seconds per line, one line per frame
RECORDING/SEQUENCE/CAMERA/color/000000.jpg (or .png), depth/000000.png (16 bit), by the number in their names
RECORDING/SEQUENCE/truth.h5               simulated recordings only; read by scoring, never by a stage
"""

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.camera import Camera, DepthView, check_intrinsics, check_lens, check_transform
from piegraph_cli.recording.encoded import MOST_BYTES, MOST_PIXELS, decode_image
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.forms import FORMS, once
from piegraph_cli.recording.numbers import Number, by_number, number_of, pair_files
from piegraph_cli.recording.text import read_rows, read_text

LAYOUT_VERSION = 1
COEFFICIENTS = (4, 5, 8, 12, 14)
"""How many numbers of distortion OpenCV knows; the first of each are the same."""
LONGEST_NAME = 100
"""Bytes of a camera's name."""
SUFFIXES = {"color": (".jpg", ".jpeg", ".png"), "depth": (".png",)}


class CameraEntry(BaseModel):
    """One camera of cameras.json."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    width: int = Field(gt=0, le=MOST_PIXELS)
    height: int = Field(gt=0, le=MOST_PIXELS)
    K: list[list[float]]
    distortion: list[float] = [0.0] * 5
    depth_scale: float = Field(0.001, gt=0)
    T_world_camera: list[list[float]] | None = None
    depth_width: int | None = Field(None, gt=0, le=MOST_PIXELS)
    depth_height: int | None = Field(None, gt=0, le=MOST_PIXELS)
    depth_K: list[list[float]] | None = None
    depth_distortion: list[float] | None = None
    T_color_depth: list[list[float]] | None = None
    serial: str | None = None
    """Of the device, by which `record` knows it again."""


class CamerasFile(BaseModel):
    """cameras.json."""

    model_config = ConfigDict(extra="forbid")

    version: int = LAYOUT_VERSION
    cameras: dict[str, CameraEntry] = Field(min_length=1)
    calibration_sequence: str | list[str] | None = None
    """The sequences that show the board, left out of runs."""
    T_world_robot: list[list[float]] | None = None


def cameras_file(sequence: Path) -> Path:
    """The cameras.json of a sequence: its own, or else its recording's. Raises `DataError` where there is neither."""
    path = next((p for p in (sequence / "cameras.json", sequence.parent / "cameras.json") if p.is_file()), None)
    if path is None:
        hint = "write it by hand or with `piegraph calibrate`"
        raise DataError("cameras.json is missing", str(sequence.parent), hint)
    return path


def read_cameras_file(path: Path) -> CamerasFile:
    """A cameras.json. Raises `DataError` naming the field that is wrong."""
    text = read_text(path, "copy or write it again, as UTF-8")
    try:
        entries = CamerasFile.model_validate_json(text)
        json.loads(text, object_pairs_hook=once)
    except ValidationError as error:
        problem = error.errors()[0]
        place = ".".join(str(p) for p in problem["loc"])
        message = f"{place}: {problem['msg']}" if place else problem["msg"]
        field = next((part for part in reversed(problem["loc"]) if isinstance(part, str)), "")
        raise DataError(message, str(path), FORMS.get(field, "see docs/formats.md for the fields")) from None
    except KeyError as error:
        raise DataError(f"{error.args[0]} is there twice", str(path), "leave the right one") from None
    if entries.version != LAYOUT_VERSION:
        message = f"layout version {entries.version}, this piegraph reads version {LAYOUT_VERSION}"
        raise DataError(message, str(path), "update piegraph")
    if entries.T_world_robot is not None:
        _transform(entries.T_world_robot, "T_world_robot", str(path), "remove it, and calibrate the robot again")
    return entries


def read_cameras(sequence: Path, posed: bool = True) -> list[Camera]:
    """Cameras of a sequence, sorted by name, from its own cameras.json or else its recording's.

    Without `posed` a missing `T_world_camera` is the identity. Raises `DataError` naming file, camera and field.
    """
    path = cameras_file(sequence)
    entries = read_cameras_file(path).cameras
    unposed = [name for name, entry in entries.items() if entry.T_world_camera is None]
    if posed and unposed:
        raise DataError("T_world_camera is missing", f"{path}, camera {unposed[0]}", "run `piegraph calibrate`")
    given = {len(entry.distortion) for entry in entries.values()}
    longest = max({5} | given & set(COEFFICIENTS))  # another number is its camera's error, not the others'
    return [_camera(name, entry, longest, path) for name, entry in sorted(entries.items())]


def _camera(name: str, entry: CameraEntry, coefficients: int, path: Path) -> Camera:
    where = f"{path}, camera {name}"
    if Path(name).name != name or name.startswith(".") or len(name.encode()) > LONGEST_NAME:
        where = f"{path}, camera {name[:40]}"
        raise DataError(f"camera names must be plain folder names of at most {LONGEST_NAME} bytes", where, "rename it")
    K = _intrinsics(entry.K, "K", where)
    distortion = _distortion(entry.distortion, "distortion", where)
    distortion = np.pad(distortion, (0, coefficients - len(distortion)))
    check_lens(K, distortion, (entry.width, entry.height), "distortion", where)
    pose = np.eye(4).tolist() if entry.T_world_camera is None else entry.T_world_camera
    T = _transform(pose, "T_world_camera", where, "run `piegraph calibrate`")
    view = _depth_view(entry, where)
    return Camera(name, entry.width, entry.height, K, distortion, T, entry.depth_scale, view)


def _depth_view(entry: CameraEntry, where: str) -> DepthView | None:
    names = ("depth_width", "depth_height", "depth_K", "depth_distortion", "T_color_depth")
    given = [name for name in names if getattr(entry, name) is not None]
    if not given:
        return None
    if entry.depth_K is None or entry.T_color_depth is None:
        raise DataError(
            f"{', '.join(given)} without {'depth_K' if entry.depth_K is None else 'T_color_depth'}",
            where,
            "depth that is not registered to colour needs depth_K and T_color_depth",
        )
    size = entry.depth_width or entry.width, entry.depth_height or entry.height
    K = _intrinsics(entry.depth_K, "depth_K", where)
    distortion = np.pad(_distortion(entry.depth_distortion or [0.0] * 5, "depth_distortion", where), (0, 14))[:14]
    check_lens(K, distortion, size, "depth_distortion", where)
    return DepthView(
        *size,
        K,
        distortion,
        _transform(entry.T_color_depth, "T_color_depth", where, "it maps points of the depth camera to the colour one"),
    )


def _matrix(values: list[list[float]], size: int, name: str, where: str) -> np.ndarray:
    try:
        matrix = np.array(values, float)
    except ValueError:
        raise DataError(f"{name} must be rectangular", where, "see docs/formats.md") from None
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        raise DataError(
            f"{name} must be a finite {size} x {size} matrix", where, FORMS.get(name, "see docs/formats.md")
        )
    return matrix


def _intrinsics(values: list[list[float]], name: str, where: str) -> np.ndarray:
    return check_intrinsics(_matrix(values, 3, name, where), name, where)


def _distortion(values: list[float], name: str, where: str) -> np.ndarray:
    distortion = np.array(values, float)
    if len(distortion) not in COEFFICIENTS or not np.isfinite(distortion).all():
        raise DataError(
            f"{name} must be 4, 5, 8, 12 or 14 finite numbers k1 k2 p1 p2 k3 ..., got {len(distortion)}",
            where,
            "give them in OpenCV's order, or zeros for images that are undistorted",
        )
    return np.pad(distortion, (0, max(0, 5 - len(distortion))))


def _transform(values: list[list[float]], name: str, where: str, hint: str) -> np.ndarray:
    return check_transform(_matrix(values, 4, name, where), name, where, hint)


def read_times(sequence: Path, camera: Camera) -> np.ndarray:
    """Time stamps [frame] of one camera in seconds, as they are in its file."""
    path = sequence / camera.name / "timestamps.txt"
    if not path.parent.is_dir():
        raise DataError(
            f"camera {camera.name} is in cameras.json but has no folder", str(sequence), "add it or remove the camera"
        )
    rows = read_rows(path, "one time stamp in seconds per line")
    if len(rows) > 1 and all(len(row) == len(rows[0][1]) > 1 for _, row in rows):
        line = f"{path}, line {rows[0][0]}"
        raise DataError(
            f"has {len(rows[0][1])} numbers", line, "one time stamp in seconds per line, and nothing beside it"
        )
    return np.array([value for _, row in rows for value in row], float)


def frame_files(sequence: Path, camera: Camera) -> list[tuple[Path, Path]]:
    """(colour, depth) image paths of one camera in the order of the numbers in their names; each has its partner."""
    color, depth = image_files(sequence, camera, "color"), image_files(sequence, camera, "depth")
    partner = pair_files(color, depth)
    odd = [path for path in color.values() if path not in partner]
    odd += [path for path in depth.values() if path not in partner.values()]
    if odd:
        first = min(odd, key=number_of)
        raise DataError(
            f"{len(color)} colour and {len(depth)} depth images; "
            f"first unpaired frame {first.stem} of {first.parent.name}",
            str(sequence / camera.name),
            "each frame needs color/NNNNNN.jpg and depth/NNNNNN.png",
        )
    return [(path, partner[path]) for path in color.values()]


def image_files(sequence: Path, camera: Camera, kind: Literal["color", "depth"]) -> dict[Number, Path]:
    """The colour or depth images of one camera by the numbers in their names, in their order."""
    folder = sequence / camera.name / kind
    if not folder.is_dir():
        raise DataError("folder is missing", str(folder), "see docs/formats.md for the layout")
    files = [p for p in entries_of(folder) if p.is_file()]
    found = by_number([p for p in files if p.suffix.lower() in SUFFIXES[kind]])
    if files and not found:
        hint = "write 16-bit PNG, whole millimetres" if kind == "depth" else "write .jpg or .png"
        raise DataError(f"holds {min(files).name}, and no {' or '.join(SUFFIXES[kind])} files", str(folder), hint)
    return found


def read_color(path: Path, camera: Camera) -> bytes:
    """The encoded bytes of a colour image, after decoding it once to check it against the camera's size."""
    import cv2

    data, image = _decoded(path, cv2.IMREAD_COLOR, camera.name)
    if image.shape[:2] != (camera.height, camera.width):
        hint = "correct width, height and K in cameras.json"
        if image.shape[:2] == (camera.width, camera.height):
            hint = "turn the images back (their EXIF orientation counts), or calibrate with them as they are"
        raise DataError(
            f"image is {image.shape[1]} x {image.shape[0]}, cameras.json says {camera.width} x {camera.height}",
            str(path),
            hint,
        )
    return data


def read_depth(path: Path, camera: Camera) -> np.ndarray:
    """A depth image as it was recorded, uint16 [H, W] in units of the camera's depth scale; 0 is no reading."""
    import cv2

    _, image = _decoded(path, cv2.IMREAD_UNCHANGED, camera.name)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(
            f"depth must be a one-channel 16-bit PNG, got {image.dtype} {image.shape}", str(path), "export it again"
        )
    view = camera.depth_view or camera
    if image.shape != (view.height, view.width):
        size = f"{image.shape[1]} x {image.shape[0]}"
        if camera.depth_view:
            message = f"depth image is {size}, cameras.json says {view.width} x {view.height}"
            raise DataError(message, str(path), "correct depth_width, depth_height and depth_K in cameras.json")
        raise DataError(
            f"depth image is {size}, colour {camera.width} x {camera.height}: depth must be registered to colour",
            str(path),
            "align depth to colour when recording, or give depth_width, depth_height, depth_K and T_color_depth",
        )
    return image


def read_mask(path: Path, camera: Camera) -> np.ndarray:
    """A mask, bool [H, W] of the colour image's size: what is not black."""
    import cv2

    _, image = _decoded(path, cv2.IMREAD_GRAYSCALE, camera.name)
    if image.shape != (camera.height, camera.width):
        size = f"{image.shape[1]} x {image.shape[0]}, colour {camera.width} x {camera.height}"
        raise DataError(f"mask of camera {camera.name}, frame {path.stem} is {size}", str(path), "remove the masks")
    return image > 0


def image_size(path: Path, camera: str) -> tuple[int, int]:
    """Width and height of an image, px."""
    import cv2

    height, width = _decoded(path, cv2.IMREAD_COLOR, camera)[1].shape[:2]
    return width, height


def _decoded(path: Path, flag: int, camera: str) -> tuple[bytes, np.ndarray]:
    """The bytes of an image file, and the image. Raises `DataError` for what is none, or promises too many pixels."""
    try:
        if not path.is_file():
            raise ValueError("no regular file")
        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES} bytes")
        data = path.read_bytes()
        return data, decode_image(data, flag)
    except (OSError, ValueError) as error:
        reason = str(error).strip().splitlines()[0]
        hint = "record it again, or remove this frame from every camera and from timestamps.txt"
        message = f"image of camera {camera}, frame {path.stem} cannot be decoded: {reason}"
        raise DataError(message, str(path), hint) from None


def cameras_text(cameras: list[Camera]) -> str:
    """The text of a cameras.json."""
    entries = {c.name: CameraEntry.model_validate(entry_of(c)) for c in cameras}
    return cameras_file_text(CamerasFile(cameras=entries))


def cameras_file_text(file: CamerasFile) -> str:
    """The text of a cameras.json."""
    return json.dumps(file.model_dump(exclude_none=True), indent=1) + "\n"


def entry_of(camera: Camera) -> dict[str, Any]:
    """The fields of a camera in cameras.json."""
    entry = {name: getattr(camera, name) for name in ("width", "height", "depth_scale")}
    entry |= {name: getattr(camera, name).tolist() for name in ("K", "distortion", "T_world_camera")}
    if camera.depth_view:
        view = camera.depth_view
        entry |= {"depth_width": view.width, "depth_height": view.height, "depth_K": view.K.tolist()}
        entry |= {"depth_distortion": view.distortion.tolist(), "T_color_depth": view.T_color_depth.tolist()}
    return entry


def write_cameras(folder: Path, cameras: list[Camera]) -> None:
    """Write cameras.json."""
    with atomic_file(folder / "cameras.json") as temporary:
        temporary.write_text(cameras_text(cameras))


def write_frame(sequence: Path, camera: Camera, frame: int, color: np.ndarray, depth: np.ndarray, quality: int) -> None:
    """Write one frame of one camera: RGB uint8 [H, W, 3] as JPEG, depth uint16 [H, W] in the camera's units as PNG."""
    import cv2

    for kind, suffix, image, flags in (
        ("color", ".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]),
        ("depth", ".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, 3]),
    ):
        path = sequence / camera.name / kind / f"{frame:06d}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(suffix, image, flags)[1].tobytes())


def write_times(sequence: Path, camera: Camera, times: np.ndarray) -> None:
    """Write timestamps.txt of one camera; times [frame] in seconds."""
    (sequence / camera.name / "timestamps.txt").write_text("".join(f"{t:.6f}\n" for t in times))
