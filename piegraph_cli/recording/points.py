"""Point clouds that others wrote, PLY and NPZ files, each held against its own length before its points are read.

A file that was cut off, or whose arrays contradict each other, is refused: half a cloud sends a robot elsewhere.
"""

import io
import logging
import math
import os
import zipfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.ply import AGAIN, HEADER_BYTES, read_ply

log = logging.getLogger("piegraph")

MAX_BYTES = 1 << 30
"""The largest file, and the most that all arrays of an .npz may unpack to."""
FREE, RATIO = 1 << 28, 100
"""Bytes that an .npz may unpack to whatever its size, and times its size that it may beyond."""
FARTHEST = 1e6
"""Metres beyond which a number is no place."""
EMPTY = 20
"""So many points at the origin itself are pixels without depth, as other programs write them."""

ROWS, WHOLE_ROWS, SMOOTH = 32, 100, 0.02
"""Rows and columns from which an array may be an image of points, one that lacks none, and the share of its size between
pixels."""

PER_FRAME = ("time", "mode", "contact", "end_effector", "residual", "visibility")
PER_POINT = ("colors", "normals")
"""Arrays beside the points of an .npz whose length must agree with them."""
OF_POINTS = ("points", "particles", "positions", "vertices", "cloud", "xyz")
"""What the array of an .npz that holds points is called."""
NO_POINTS = (*PER_FRAME, *PER_POINT, "color", "colours", "rgb", "normal", "faces", "triangles", "offsets")
"""And what arrays are called that are none, whatever their shapes."""


@dataclass(frozen=True)
class Clouds:
    """Clouds of several frames: points [P, 3], those of frame f from `offsets[f]` to `offsets[f + 1]`; offsets [F + 1]."""

    points: np.ndarray
    offsets: np.ndarray

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, frame: int) -> np.ndarray:
        low, high = self.offsets[frame % len(self)], self.offsets[frame % len(self) + 1]
        return self.points[low:high]


NAME_THEM = "name the array of the points: FILE:KEY"

Frames = list[np.ndarray] | np.ndarray | Clouds
Reader = Callable[[Path], Frames]


def read_points(path: Path, frame: int | None, more: Mapping[str, Reader], key: str | None = None) -> np.ndarray:
    """Points [P, 3] float32 (m, world) of a .ply or .npz file, or of a kind that a reader in `more` knows by its suffix.

    Of several frames the given one, else the last; of an .npz the array called `key`, else the one that can be points.
    Raises `DataError` for what is no regular file, is cut off, holds more than its header says, contradicts itself, or has
    no points, none that are finite, or several arrays of which each may be meant.
    """
    readers: dict[str, Reader] = {".ply": _vertices, ".npz": lambda file: _read_npz(file, key), **more}
    names = ", ".join(readers)
    if not path.is_file():
        message = "is not a regular file" if os.path.lexists(path) else "no such file"
        raise DataError(message, str(path), f"give a file of {names}")
    kind = path.suffix.lower()
    if kind not in readers:
        suffix = path.suffix or "a file without suffix"
        raise DataError(f"cannot read clouds from {suffix}", str(path), f"use {names}")
    frames = readers[kind](path) if frame is not None else _as_one(readers[kind](path), path)
    index = len(frames) - 1 if frame is None else frame
    if not -len(frames) <= index < len(frames):
        raise DataError(f"has {len(frames)} frames, no frame {index}", str(path), "use 0 for the first")
    where = f"{path}, frame {index}"
    with np.errstate(over="ignore"):
        points = np.asarray(frames[index], np.float32)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise DataError(f"holds no finite points [P, 3] but an array {points.shape}", where, "give another file")
    finite = np.isfinite(points).all(1)
    farthest = float(np.abs(points[finite]).max(initial=0))
    if farthest > FARTHEST:
        raise DataError(f"a point is {farthest:.1g} m from the origin", where, "give points in metres")
    if not finite.any():
        raise DataError(f"none of its {len(points)} points is finite", where, "give another file")
    if not finite.all():  # organised clouds have them where the camera saw nothing
        log.warning("%s: %d of %d points are not finite: left out", where, (~finite).sum(), len(points))
    empty = finite & (points == 0).all(1)
    if EMPTY <= empty.sum() < finite.sum():
        log.warning(
            "%s: %d of %d points are 0, 0, 0, as pixels without depth are: left out", where, empty.sum(), len(points)
        )
        finite &= ~empty
    return points[finite]


def _as_one(frames: Frames, path: Path) -> Frames:
    """The frames of a file, of which those that are an image's rows are one cloud."""
    if not isinstance(frames, np.ndarray) or not is_organised(frames):
        return frames
    log.warning("%s: %s is taken for one organised cloud, a point per pixel", path, list(frames.shape))
    return [frames.reshape(-1, 3)]


def is_organised(points: np.ndarray) -> bool:
    """Whether points [A, B, 3] are those of an image's pixels, not frames of one cloud.

    Pixels without depth are NaN or 0, which no frame's particles are; or points lie beside those of the pixels around.
    """
    if min(points.shape[:2]) < ROWS:
        return False
    zero = (points == 0).all(-1)
    empty = ~np.isfinite(points).all(-1) | (zero if zero.sum() >= EMPTY else False)
    if empty.any():
        return not (empty.all(1) | ~empty.any(1)).all()  # frames are there or lost as a whole
    if min(points.shape[:2]) < WHOLE_ROWS:
        return False
    size = float(np.ptp(points.reshape(-1, 3), axis=0).max())
    steps = [float(np.quantile(np.linalg.norm(np.diff(points, axis=axis), axis=-1), 0.9)) for axis in (0, 1)]
    travels = float(np.linalg.norm(points[-1].mean(0) - points[0].mean(0)))
    return max(steps) < SMOOTH * size and travels > size / 4


def check_size(path: Path) -> int:
    """The size of a file. Raises `DataError` for one that is too large to be read, and for what is no file."""
    if not path.is_file():
        message = "is not a regular file" if os.path.lexists(path) else "no such file"
        raise DataError(message, str(path), "give a file")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise DataError(
            f"has {size} bytes, clouds of at most {MAX_BYTES} are read",
            str(path),
            "thin the cloud out before writing it",
        )
    return size


def _vertices(path: Path) -> Frames:
    return [read_ply(path, check_size(path))]


def _read_npz(path: Path, key: str | None = None) -> Frames:
    """An array of an .npz file: [P, 3], with integer `offsets` [F + 1] several clouds, or [F, P, 3]."""
    check_size(path)
    try:
        with zipfile.ZipFile(path) as file:
            arrays = _npz_headers(file, path)
            name = _chosen(arrays, path) if key is None else key
            if name not in arrays:
                raise DataError(f"has no array {name}", str(path), f"it has {', '.join(list(arrays)[:8])}")
            if not arrays[name].may_be_points:
                message = f"its array {name} is {arrays[name].dtype} {list(arrays[name].shape)}, not points"
                raise DataError(f"{message} [P, 3] or [F, P, 3]", str(path), NAME_THEM)
            points = _npz_array(file, name)
            offsets = _npz_array(file, "offsets") if "offsets" in arrays else None
    except DataError:
        raise
    except Exception as error:  # whatever zip, deflate and .npy readers raise for broken files
        raise DataError(f"not a readable .npz file: {error}", str(path), AGAIN) from None
    if offsets is not None:
        _check_offsets(offsets, points, f"{path}, array offsets")
    frames: Frames = Clouds(points, offsets) if offsets is not None else [points] if points.ndim == 2 else points
    _check_lengths({other: array.shape for other, array in arrays.items() if other != name}, frames, points, path)
    return frames


@dataclass(frozen=True)
class _Array:
    """What the header of a .npy member says."""

    shape: tuple[int, ...]
    dtype: np.dtype

    @property
    def may_be_points(self) -> bool:
        numbers = self.dtype.kind in "fiu" and self.dtype != np.uint8
        return numbers and len(self.shape) in (2, 3) and self.shape[-1] == 3


def _chosen(arrays: Mapping[str, _Array], path: Path) -> str:
    """The name of the array that holds the points: the only one that can, or else the one that is called so.

    Raises `DataError` where several can and none, or more than one, is called so: colours, normals and matrices have the
    shape of points too.
    """
    able = [name for name, array in arrays.items() if array.may_be_points and name.lower() not in NO_POINTS]
    called = [name for name in able if name.lower() in OF_POINTS]
    if sorted(called) == ["particles", "points"]:  # what `look --out` writes
        called = ["points"]
    if len(able) > 1 and len(called) != 1:
        message = f"which of its arrays are the points: {', '.join(able[:8])}?"
        raise DataError(message, str(path), NAME_THEM)
    return (called or able or list(arrays))[0]


def _npz_headers(file: zipfile.ZipFile, path: Path) -> dict[str, _Array]:
    """The arrays of an .npz by name, each header held against the size that the zip directory states."""
    members = file.infolist()
    total = sum(member.file_size for member in members)
    most = min(MAX_BYTES, max(FREE, RATIO * path.stat().st_size))
    if total > most:
        raise DataError(f"unpacks to {total} bytes, at most {most} are read", str(path), "thin the clouds out")
    arrays: dict[str, _Array] = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        if name == member.filename or name in arrays:
            raise DataError(f"holds {member.filename} twice or as no array", str(path), "write it with numpy.savez")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise DataError(f"array {name} is packed in an unknown way", str(path), "write it with numpy.savez")
        with file.open(member) as stream:
            head = io.BytesIO(stream.read(HEADER_BYTES))
        version = np.lib.format.read_magic(head)
        if version not in ((1, 0), (2, 0)):
            raise DataError(f"array {name} has the unknown version {version}", str(path), "write numbers alone")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(head)
        if dtype.hasobject:
            raise DataError(f"array {name} holds Python objects, which are not read", str(path), "write numbers alone")
        needed = head.tell() + math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or needed != member.file_size:
            message = f"array {name} of {dtype} {list(shape)} needs {needed} bytes, it has {member.file_size}"
            raise DataError(message, str(path), AGAIN)
        arrays[name] = _Array(shape, dtype)
    if not arrays:
        raise DataError("holds no array", str(path), "write the points with numpy.savez")
    return arrays


def _npz_array(file: zipfile.ZipFile, name: str) -> np.ndarray:
    with file.open(f"{name}.npy") as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _check_offsets(offsets: np.ndarray, points: np.ndarray, where: str) -> None:
    if points.ndim != 2 or offsets.ndim != 1 or offsets.dtype.kind not in "iu" or len(offsets) < 2:
        raise DataError(
            "offsets must be integers [F + 1] beside points [P, 3]", where, "leave offsets out, or write both again"
        )
    if offsets[0] != 0 or offsets[-1] != len(points) or (offsets[1:] < offsets[:-1]).any():
        message = f"offsets must rise from 0 to the {len(points)} points, they go from {offsets[0]} to {offsets[-1]}"
        raise DataError(message, where, "write points and offsets again, of the same clouds")


def _check_lengths(others: Mapping[str, tuple[int, ...]], frames: Frames, points: np.ndarray, path: Path) -> None:
    """Refuse arrays of frames, beside several clouds, and of points whose length is another."""
    expected = dict.fromkeys(PER_FRAME, len(frames)) if not isinstance(frames, list) else {}
    expected |= dict.fromkeys(PER_POINT, len(points)) if points.ndim == 2 else {}
    for name, shape in others.items():
        if name in expected and shape[:1] != (expected[name],):
            message = f"array {name} {list(shape)} contradicts the points {list(points.shape)}"
            hint = f"expected length {expected[name]}: write both again, of the same clouds"
            raise DataError(message, str(path), hint)


def read_arrays(path: Path, wanted: Collection[str]) -> dict[str, np.ndarray]:
    """The arrays of an .npz file that have one of these names, each held against its length; none is unpickled.

    Raises `DataError` for a file that is cut off, too large, or holds anything but plain arrays.
    """
    check_size(path)
    try:
        with zipfile.ZipFile(path) as file:
            return {name: _npz_array(file, name) for name in _npz_headers(file, path) if name in wanted}
    except DataError:
        raise
    except Exception as error:  # whatever zip, deflate and .npy readers raise for broken files
        raise DataError(f"not a readable .npz file: {error}", str(path), AGAIN) from None


def check_points_file(path: Path) -> None:
    """Raise `UsageError` for a file that `write_points` has no format for."""
    if path.suffix not in (".ply", ".npz"):
        raise UsageError(
            f"cannot write clouds as {path.suffix or 'a file without suffix'}", str(path), "use .ply or .npz"
        )


def write_points(path: Path, points: np.ndarray, **more: np.ndarray) -> None:
    """Write points [P, 3] (m) as .ply (binary, float), or as .npz under `points`, with further arrays behind them.

    `read_points` reads the file back. Raises `DataError` where it cannot be written.
    """
    check_points_file(path)
    points = np.ascontiguousarray(points, "<f4")
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        if path.suffix == ".npz":
            np.savez(file, points=points, **more)  # type: ignore[arg-type]
        else:
            head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
            lines = [*head, *(f"property float {axis}" for axis in "xyz"), "end_header", ""]
            file.write("\n".join(lines).encode() + points.tobytes())
