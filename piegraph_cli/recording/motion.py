"""Particles over time that others measured: motion capture, another tracker, a simulator. Reading and checking them.

What is wrong with a file is said before anything is computed on it: millimetres, milliseconds, swapped or lost markers and
a z axis that points down all give models that look trained.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.params import Mode, mode_number
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.motion_csv import read_csv
from piegraph_cli.recording.motion_doubts import find_doubts, find_exchanged, find_lost, find_torn
from piegraph_cli.recording.motion_episode import is_episode, read_episode
from piegraph_cli.recording.points import read_arrays

NAMES = {
    "positions": ("particles", "positions"),
    "end_effector": ("end_effector",),
    "time": ("times", "time"),
    "contact": ("contact",),
    "mode": ("modes", "mode"),
    "visibility": ("visibility",),
}
"""What arrays of a file may be called, by the name they have in tracks."""
ALL_NAMES = tuple(name for names in NAMES.values() for name in names)
FLAGS = {"contact", "mode", "visibility"}
"""Arrays of values from 0 to 1."""
NEEDED = "particles [T, N, 3] and end_effector [T, 3] in metres, times [T] in seconds"

FEWEST, MOST = 4, 2000
"""Particles."""
LARGEST, SMALLEST = 5.0, 1e-3
"""Metres: an object beyond these is in millimetres or in kilometres."""
JUMP = 0.5
"""Metres that no particle moves between two frames."""
BELOW = -0.003
"""Metres: half of the particles below this are below the table."""
SLOWEST, LONGEST = 1e-3, 60.0
"""A hand slower than this (m/s) at steps of a second and more, or steps longer than this (s), are not in seconds."""
HIGH = 0.05
"""Metres above z = 0 at which an object does not lie on the table."""
FLAT = 5.0
"""Times that an object is higher than it is wide in a direction that may be up."""
LOST = "fill gaps of lost markers in, or leave these frames out"
ANEW = "a particle keeps its index and is the same point throughout; a new file where tracking begins anew"

Reader = Callable[[Path], Mapping[str, np.ndarray]]


@dataclass(frozen=True)
class Motion:
    """Particles over time, checked."""

    positions: np.ndarray
    """[T, N, 3] float32, metres, z up, table at z = 0."""
    end_effector: np.ndarray
    """[T, 3] float32, metres."""
    time: np.ndarray
    """[T] float64, seconds."""
    contact: np.ndarray
    """[T] bool."""
    mode: np.ndarray
    """[T] 0 push, 1 pick."""
    visibility: np.ndarray
    """[T, N] float32, 0 unseen to 1 seen."""
    contact_given: bool
    """Whether the file has contact; else it was found by distance."""
    opening: np.ndarray | None
    """[T] how far a gripper is open, where there is one."""
    warnings: list[str]


def list_files(source: Path, more: Mapping[str, Reader]) -> list[Path]:
    """The files of a source, itself or what a folder holds of .npz, .csv, `more` and episodes, which are folders.

    Raises `DataError` where there is none, or the file is of another kind.
    """
    suffixes = (".npz", ".csv", *more)
    kinds = ", ".join(suffixes)
    if is_episode(source):
        return [source]
    if source.is_dir():
        inside = entries_of(source)
        found = [p for p in inside if (p.is_file() and p.suffix.lower() in suffixes) or is_episode(p)]
        if not found:
            raise DataError("no file to import in this folder", str(source), f"put {kinds} files there")
        return sorted(found, key=lambda path: [part.zfill(20) for part in re.split(r"([0-9]+)", path.name)])
    if not source.exists():
        raise DataError("no such file or folder", str(source), f"give a file of {kinds}, or a folder of them")
    if not source.is_file():
        raise DataError("is not a regular file", str(source), f"give a file of {kinds}")
    if source.suffix.lower() not in suffixes:
        raise DataError(f"cannot import {source.suffix or 'a file without suffix'}", str(source), f"use {kinds}")
    return [source]


def read_motion(
    path: Path,
    radius: float,
    mode: Mode,
    more: Mapping[str, Reader],
    choose: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Motion:
    """The particles over time of a file, checked. `radius` (m) and `mode`: see the settings of `import`.

    `choose` gives the indices of those to keep of a frame's particles [N, 3]; by default all are. Raises `DataError` that
    names the file, the frame (in a CSV file the line too) and what to do.
    """
    readers: dict[str, Reader] = {".npz": lambda p: read_arrays(p, ALL_NAMES), ".csv": read_csv, **more}
    raw, notes = read_episode(path) if path.is_dir() else (readers[path.suffix.lower()](path), [])
    place = _Place(path)
    arrays: dict[str, np.ndarray] = {}
    for name, known in NAMES.items():
        given = [k for k in known if k in raw]
        if len(given) > 1:
            raise DataError(f"has both {given[0]} and {given[1]}", str(path), "leave one of them out")
        if given:
            arrays[name] = raw[given[0]]
    for name in ("positions", "end_effector", "time"):
        if name not in arrays:
            held = ", ".join(raw) or "none of them"
            raise DataError(f"has no array {NAMES[name][0]}, but {held}", str(path), f"write {NEEDED}")
    if choose:
        _thin(arrays, choose, place)
    _check_shapes(arrays, place)
    _check_numbers(arrays, place)
    _check_units(arrays, place)
    _check_motion(arrays, place)
    return _completed(arrays, radius, mode, place, notes, raw.get("opening"))


def _thin(arrays: dict[str, np.ndarray], choose: Callable[[np.ndarray], np.ndarray], place: "_Place") -> None:
    """Keep those of the particles that `choose` gives for the first frame."""
    first = arrays["positions"][:1]
    if first.ndim != 3 or first.shape[2:] != (3,) or first.dtype.kind not in "fiu" or not np.isfinite(first).all():
        return  # what is wrong with them is said by the checks
    try:
        kept = choose(first[0])
    except DataError as error:
        raise DataError(error.message, place(0), "keep fewer particles, or all of them") from None
    for name in {"positions", "visibility"} & arrays.keys():
        arrays[name] = arrays[name][:, kept]


@dataclass(frozen=True)
class _Place:
    path: Path

    def __call__(self, frame: int) -> str:
        line = f" (line {frame + 2})" if self.path.suffix.lower() == ".csv" else ""
        return f"{self.path}, frame {frame}{line}"


def _check_shapes(arrays: Mapping[str, np.ndarray], place: _Place) -> None:
    frames, count = (*arrays["positions"].shape, 0, 0)[:2]
    shapes: dict[str, tuple[int, ...]] = {
        "positions": (frames, count, 3),
        "end_effector": (frames, 3),
        "visibility": (frames, count),
    }
    for name, value in arrays.items():
        expected, shown = shapes.get(name, (frames,)), NAMES[name][0]
        words = name == "mode" and value.dtype.kind in "US"
        if value.dtype.kind not in "fiub" and not words:
            raise DataError(f"{shown} is {value.dtype}, not numbers", str(place.path), f"write {NEEDED}")
        if value.shape != expected:
            message = f"{shown} is {list(value.shape)}, expected {list(expected)} beside {frames} frames of particles"
            raise DataError(message, str(place.path), f"write {NEEDED}, a row per frame in each")
    if frames < 2:
        raise DataError(f"has {frames} frames", str(place.path), "a stroke needs two at least: before and after")
    if not FEWEST <= count <= MOST:
        hint = f"give {FEWEST} to {MOST} points of the object, the same in each frame, or keep fewer with --particles"
        raise DataError(f"has {count} particles", str(place.path), hint)


def _check_numbers(arrays: Mapping[str, np.ndarray], place: _Place) -> None:
    """Refuse what is not finite, and flags that are none."""
    for name, value in arrays.items():
        missing = ~np.isfinite(value) if value.dtype.kind == "f" else np.zeros(value.shape, bool)
        if name == "end_effector" and (~missing.all(1)).sum() > 1:
            missing[np.isnan(value).all(1)] = False  # nobody saw it there
        if missing.any():
            frame, *rest = (int(i) for i in np.argwhere(missing)[0])
            which = f"particle {rest[0]}" if name in ("positions", "visibility") else NAMES[name][0]
            raise DataError(f"{which} is not finite", place(frame), LOST)
    for name in FLAGS & arrays.keys():
        value = arrays[name]
        if value.dtype.kind in "US":
            continue
        wrong = (value < 0) | (value > 1) | ((value % 1 != 0) if name != "visibility" else False)
        if wrong.any():
            frame = int(np.argwhere(wrong)[0][0])
            meaning = {"mode": "0 push or 1 pick", "contact": "0 or 1"}.get(name, "from 0 to 1")
            raise DataError(f"{name} is {value[frame].max():g}", place(frame), f"write {meaning}")


def _check_units(arrays: Mapping[str, np.ndarray], place: _Place) -> None:
    """Refuse millimetres and milliseconds, and times that do not rise."""
    time, hand = arrays["time"].astype(float), arrays["end_effector"].astype(float)
    size = float(np.linalg.norm(np.ptp(arrays["positions"][0].astype(float), axis=0)))
    if size > LARGEST or size < SMALLEST:
        unit = "in millimetres? divide by 1000" if size > LARGEST else "in kilometres, or one point many times?"
        raise DataError(f"the object is {size:.3g} m large", place(0), f"write metres ({unit})")
    away = np.nan_to_num(np.linalg.norm(hand - arrays["positions"].mean(1), axis=1))
    if away.max() > LARGEST:
        frame = int(away.argmax())
        message = f"the end-effector is {away[frame]:.3g} m away from the object"
        raise DataError(message, place(frame), "write both in metres, in one frame of reference")
    steps = np.diff(time)
    if (steps <= 0).any():
        frame = int((steps <= 0).argmax()) + 1
        message = f"time goes from {time[frame - 1]:.10g} to {time[frame]:.10g} s"
        if (steps == 0).sum() > len(steps) / 5:
            message += ": were times rounded, or written with single precision?"
        raise DataError(message, place(frame), "write rising times, a frame only once; a new file for each recording")
    usual, speeds = float(np.median(steps)), np.linalg.norm(np.diff(hand, axis=0), axis=1) / steps
    speed = float(np.nan_to_num(np.nanquantile([*speeds, 0.0] if np.isnan(speeds).all() else speeds, 0.95)))
    if usual > LONGEST or (usual >= 1 and 0 < speed < SLOWEST):
        message = f"frames are {usual:g} s apart, and the hand moves {speed * 1000:.2g} mm/s"
        raise DataError(message, place(1), "write seconds (in milliseconds? divide by 1000)")


def _check_motion(arrays: Mapping[str, np.ndarray], place: _Place) -> None:
    """Refuse particles that jump, are lost, exchange places or lie below the table."""
    for name in ("positions", "end_effector"):
        lost = find_lost(arrays[name])
        if lost:
            which = f"particle {lost[1]}" if name == "positions" else NAMES[name][0]
            raise DataError(f"{which} is at 0, 0, 0: was it lost?", place(lost[0]), LOST)
    moved = np.linalg.norm(np.diff(arrays["positions"].astype(float), axis=0), axis=2)
    if moved.max() > JUMP:
        frame, particle = (int(i) for i in np.argwhere(moved > JUMP)[0])
        message = f"particle {particle} jumps by {moved[frame, particle]:.2g} m"
        raise DataError(message, place(frame + 1), ANEW)
    exchanged = find_exchanged(arrays["positions"].astype(float))
    if exchanged:
        frame, taken = exchanged
        named = ", ".join(map(str, taken[:5])) + (" and more" if len(taken) > 5 else "")
        raise DataError(f"{len(taken)} particles take each other's places: {named}", place(frame), ANEW)
    torn = find_torn(arrays["positions"].astype(float))
    if torn:
        raise DataError(f"{torn[1]} particles leave those beside them at once", place(torn[0]), ANEW)
    height = float(np.median(arrays["positions"][..., 2]))
    if height < BELOW:
        message = f"half of the particles lie more than {-height * 1000:.0f} mm below the table z = 0"
        raise DataError(message, place(0), "z points up: where it points down, negate y and z; or shift the table to 0")


def _completed(
    arrays: Mapping[str, np.ndarray],
    radius: float,
    mode: Mode,
    place: _Place,
    notes: list[str],
    opening: np.ndarray | None,
) -> Motion:
    """The motion with what the file left out."""
    positions, hand = (np.asarray(arrays[name], np.float32) for name in ("positions", "end_effector"))
    modes, warnings = _modes(arrays.get("mode"), len(hand), mode, place), list(notes)
    contact, unknown = arrays.get("contact"), np.isnan(hand).any(1)
    if contact is None:
        contact = np.linalg.norm(positions - hand[:, None], axis=2).min(1) <= radius
        if not contact.any():
            warnings.append(f"no contact given, and the hand is never within {radius:g} m of a particle: raise radius")
    if unknown.any():
        if contact.astype(bool)[unknown].any():
            frame = int((contact.astype(bool) & unknown).argmax())
            raise DataError("end_effector is not finite where it touches", place(frame), LOST)
        warnings.append(
            f"end_effector is not known in {unknown.sum()} of {len(hand)} frames, which count as no contact"
        )
    low = float(positions[0, :, 2].min())
    if low > HIGH:
        warnings.append(f"the object lies {low:.2g} m above z = 0: shift z so that the table is 0")
    y, z = np.ptp(positions.reshape(-1, 3), axis=0)[1:]
    if z > HIGH and y < z / FLAT:
        warnings.append(f"the object moves {z:.2g} m in z and {y:.2g} m in y: is y up? z has to point up")
    wide, _, high = np.ptp(positions[0], axis=0)
    if high > HIGH and np.ptp(positions[..., 0]) < high / FLAT:
        warnings.append(f"the object is {high:.2g} m high and {wide:.2g} m wide in x: is x up? z has to point up")
    visibility = np.asarray(arrays.get("visibility", np.ones(positions.shape[:2])), np.float32)
    time, contact = arrays["time"].astype(float), contact.astype(bool)
    warnings += find_doubts(positions, hand, time, contact)
    return Motion(positions, hand, time, contact, modes, visibility, "contact" in arrays, opening, warnings)


def _modes(given: np.ndarray | None, frames: int, mode: Mode, place: _Place) -> np.ndarray:
    if given is None:
        return np.full(frames, mode_number(mode), np.uint8)
    if given.dtype.kind not in "US":
        return given.astype(np.uint8)
    words = [word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word) for word in given]
    numbers = {"push": 0, "pick": 1, "0": 0, "1": 1}
    wrong = [k for k, word in enumerate(words) if word.strip() not in numbers]
    if wrong:
        raise DataError(f"mode is {words[wrong[0]]!r}", place(wrong[0]), "write push or pick, or 0 or 1")
    return np.array([numbers[word.strip()] for word in words], np.uint8)
