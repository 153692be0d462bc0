"""The recording folder layout (docs/formats.md): reading it with checks that name file, camera and frame, and writing it.

RECORDING/cameras.json                    intrinsics, distortion, depth scale, T_world_camera per camera
RECORDING/SEQUENCE/cameras.json           optional, in place of the one above
RECORDING/SEQUENCE/CAMERA/timestamps.txt  one time stamp in seconds per line, one line per frame
RECORDING/SEQUENCE/CAMERA/color/000000.jpg (or .png), depth/000000.png (16 bit)
RECORDING/SEQUENCE/truth.h5               simulated recordings only; read by scoring, never by a stage
"""

import json
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera

LAYOUT_VERSION = 1
COLOR_SUFFIXES = (".jpg", ".jpeg", ".png")


class CameraEntry(BaseModel):
    """One camera of cameras.json."""

    model_config = ConfigDict(extra="forbid")

    width: int = Field(gt=0)
    height: int = Field(gt=0)
    K: list[list[float]]
    distortion: list[float] = [0.0] * 5
    depth_scale: float = Field(0.001, gt=0)
    T_world_camera: list[list[float]] | None = None


class CamerasFile(BaseModel):
    """cameras.json."""

    model_config = ConfigDict(extra="forbid")

    version: int = LAYOUT_VERSION
    cameras: dict[str, CameraEntry] = Field(min_length=1)


def read_cameras(sequence: Path, posed: bool = True) -> list[Camera]:
    """Cameras of a sequence, sorted by name, from its own cameras.json or else its recording's.

    Without `posed` a missing `T_world_camera` is the identity. Raises `DataError` naming file, camera and field.
    """
    path = next((p for p in (sequence / "cameras.json", sequence.parent / "cameras.json") if p.is_file()), None)
    if path is None:
        raise DataError(
            "cameras.json is missing", str(sequence.parent), "write it by hand or with `piegraph calibrate`"
        )
    try:
        entries = CamerasFile.model_validate_json(path.read_text())
    except ValidationError as error:
        problem = error.errors()[0]
        place = ".".join(str(p) for p in problem["loc"])
        message = f"{place}: {problem['msg']}" if place else problem["msg"]
        raise DataError(message, str(path), "see docs/formats.md for the fields") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"cannot be read: {error}", str(path)) from None
    if entries.version != LAYOUT_VERSION:
        raise DataError(
            f"layout version {entries.version}, this piegraph reads version {LAYOUT_VERSION}",
            str(path),
            "update piegraph",
        )
    unposed = [name for name, entry in entries.cameras.items() if entry.T_world_camera is None]
    if posed and unposed:
        raise DataError("T_world_camera is missing", f"{path}, camera {unposed[0]}", "run `piegraph calibrate`")
    return [_camera(name, entry, path) for name, entry in sorted(entries.cameras.items())]


def _camera(name: str, entry: CameraEntry, path: Path) -> Camera:
    where = f"{path}, camera {name}"
    if Path(name).name != name or name.startswith("."):
        raise DataError("camera names must be plain folder names", where)
    try:
        K, T = np.array(entry.K, float), np.array(entry.T_world_camera or np.eye(4), float)
    except ValueError:
        raise DataError("K and T_world_camera must be rectangular", where, "see docs/formats.md") from None
    if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise DataError("K must be a finite 3 x 3 matrix with positive focal lengths", where, "see docs/formats.md")
    distortion = np.array(entry.distortion, float)
    if distortion.shape != (5,) or not np.isfinite(distortion).all():
        raise DataError("distortion must be five finite numbers k1 k2 p1 p2 k3", where, "use zeros for none")
    if T.shape != (4, 4) or not np.isfinite(T).all() or not np.allclose(T[3], [0, 0, 0, 1]):
        raise DataError("T_world_camera must be a finite 4 x 4 rigid transform", where, "run `piegraph calibrate`")
    if not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3) or np.linalg.det(T[:3, :3]) < 0:
        raise DataError(
            "the rotation in T_world_camera is singular or not a rotation", where, "run `piegraph calibrate`"
        )
    return Camera(name, entry.width, entry.height, K, distortion, T, entry.depth_scale)


def read_times(sequence: Path, camera: Camera) -> np.ndarray:
    """Time stamps [frame] of one camera in seconds, strictly increasing."""
    path = sequence / camera.name / "timestamps.txt"
    if not path.parent.is_dir():
        raise DataError(
            f"camera {camera.name} is in cameras.json but has no folder", str(sequence), "add it or remove the camera"
        )
    try:
        times = np.array([float(line) for line in path.read_text().split()])
    except FileNotFoundError:
        raise DataError("timestamps.txt is missing", str(path.parent), "one time stamp in seconds per line") from None
    except (ValueError, UnicodeDecodeError):
        raise DataError("a line is not a number", str(path), "one time stamp in seconds per line") from None
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        bad = int(np.argmax(np.diff(times) <= 0)) + 1 if (np.diff(times) <= 0).any() else 0
        raise DataError(f"time stamps must increase: line {bad + 1} does not", str(path), "sort or repair the file")
    return times


def frame_files(sequence: Path, camera: Camera) -> list[tuple[Path, Path]]:
    """(colour, depth) image paths of one camera in frame order; equal, gapless numbering is checked."""
    folder = sequence / camera.name
    color = sorted(p for p in _files(folder / "color") if p.suffix.lower() in COLOR_SUFFIXES)
    depth = sorted(p for p in _files(folder / "depth") if p.suffix.lower() == ".png")
    if [p.stem for p in color] != [p.stem for p in depth]:
        odd = sorted({p.stem for p in color} ^ {p.stem for p in depth})
        raise DataError(
            f"{len(color)} colour and {len(depth)} depth images; first unpaired frame {odd[0] if odd else 'repeated'}",
            str(folder),
            "each frame needs color/NNNNNN.jpg and depth/NNNNNN.png",
        )
    return list(zip(color, depth, strict=True))


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise DataError("folder is missing", str(folder), "see docs/formats.md for the layout")
    return [p for p in folder.iterdir() if p.is_file()]


def read_color(path: Path, camera: Camera) -> bytes:
    """The encoded bytes of a colour image, after decoding it once to check it against the camera's size."""
    import cv2

    data = path.read_bytes()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    _check_image(image, path, camera)
    return data


def read_depth(path: Path, camera: Camera) -> np.ndarray:
    """A depth image, uint16 [H, W] in units of the camera's depth scale; 0 is no reading."""
    import cv2

    data = path.read_bytes()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    image = _check_image(image, path, camera)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(f"depth must be a one-channel 16-bit PNG, got {image.dtype} {image.shape}", str(path))
    return image


def _check_image(image: np.ndarray | None, path: Path, camera: Camera) -> np.ndarray:
    if image is None:
        raise DataError(
            f"image of camera {camera.name}, frame {path.stem} cannot be decoded",
            str(path),
            "record it again, or remove this frame from every camera and from timestamps.txt",
        )
    if image.shape[:2] != (camera.height, camera.width):
        raise DataError(
            f"image is {image.shape[1]} x {image.shape[0]}, cameras.json says {camera.width} x {camera.height}",
            str(path),
            "correct width, height and K in cameras.json",
        )
    return image


def cameras_text(cameras: list[Camera]) -> str:
    """The text of a cameras.json."""
    entries = {
        c.name: CameraEntry(
            width=c.width,
            height=c.height,
            K=c.K.tolist(),
            distortion=c.distortion.tolist(),
            depth_scale=c.depth_scale,
            T_world_camera=c.T_world_camera.tolist(),
        )
        for c in cameras
    }
    return json.dumps(CamerasFile(cameras=entries).model_dump(), indent=1) + "\n"


def write_cameras(folder: Path, cameras: list[Camera]) -> None:
    """Write cameras.json."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.json").write_text(cameras_text(cameras))


def write_frame(sequence: Path, camera: Camera, frame: int, color: np.ndarray, depth: np.ndarray, quality: int) -> None:
    """Write one frame of one camera: RGB uint8 [H, W, 3] as JPEG, depth uint16 [H, W] in the camera's units as PNG."""
    import cv2

    for kind, suffix, image, flags in (
        ("color", ".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]),
        ("depth", ".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, 9]),
    ):
        path = sequence / camera.name / kind / f"{frame:06d}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(suffix, image, flags)[1].tobytes())


def write_times(sequence: Path, camera: Camera, times: np.ndarray) -> None:
    """Write timestamps.txt of one camera; times [frame] in seconds."""
    (sequence / camera.name / "timestamps.txt").write_text("".join(f"{t:.6f}\n" for t in times))
