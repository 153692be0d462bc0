"""The path of an end-effector that others measured, a robot or a marker: read from a table, checked, at times of frames.

A table is `end_effector.csv` beside a sequence's cameras: time, x, y, z[, qx, qy, qz, qw][, opening], seconds on the
cameras' clock and metres in the world. Readers of layouts that hold such a path make an `EndEffectorPath` of it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.motion_csv import read_rows
from piegraph_cli.recording.text import parse_number
from piegraph_cli.recording.timing import FASTEST, SLOWEST, UNITS

NAME = "end_effector.csv"
FIXED, TURN, OPENING = ("time", "x", "y", "z"), ("qx", "qy", "qz", "qw"), "opening"
COLUMNS = "columns time, x, y, z[, qx, qy, qz, qw][, opening], with commas between"
FARTHEST = 20.0
"""Metres from the world's origin beyond which positions are not in metres."""
LATEST = 1e11
"""Seconds that no clock shows."""
FASTEST_MOVE = 5.0
"""Metres a second beyond which a path jumps."""
LONGEST_GAP = 0.5
"""Seconds between two lines across which nothing is interpolated."""


@dataclass(frozen=True)
class EndEffectorPath:
    """Where an end-effector was."""

    times: np.ndarray
    """[T] s, on the cameras' clock."""
    positions: np.ndarray
    """[T, 3] m, in the world."""
    turns: np.ndarray | None = None
    """[T, 4] quaternion x, y, z, w of the end-effector's frame in the world, where that is known."""
    opening: np.ndarray | None = None
    """[T] how far a gripper is open, where there is one: metres, or any number that is less when it is closed."""
    where: str = ""
    """File it is from."""
    item: str = "sample"
    """What its entries are called in messages."""
    first: int = 0
    """The number of the first of them."""


def read_end_effector(path: Path) -> EndEffectorPath:
    """The path in an `end_effector.csv`, checked. Raises `DataError` naming line and column."""
    rows = read_rows(path, COLUMNS)
    if len(rows) < 3:
        raise DataError(
            f"has {max(len(rows) - 1, 0)} lines of numbers", str(path), f"write {COLUMNS}, then a line per time"
        )
    header = [name.strip() for name in rows[0]]
    _check_header(header, path)
    values = np.array([_numbers(row, header, f"{path}, line {n}") for n, row in enumerate(rows[1:], 2)])
    column = {name: values[:, k] for k, name in enumerate(header)}
    turns = np.stack([column[name] for name in TURN], 1) if TURN[0] in column else None
    positions = np.stack([column[name] for name in "xyz"], 1)
    return checked(EndEffectorPath(column["time"], positions, turns, column.get(OPENING), str(path), "line", 2))


def _check_header(header: list[str], path: Path) -> None:
    where = f"{path}, line 1"
    wanted = FIXED + TURN if set(TURN) & set(header) else FIXED
    missing = [name for name in wanted if name not in header]
    if missing:
        raise DataError(f"has no column {missing[0]}", where, f"write {COLUMNS}")
    wrong = [name for k, name in enumerate(header) if name not in (*wanted, OPENING) or name in header[:k]]
    if wrong:
        why = "is there twice" if header.count(wrong[0]) > 1 else "is not known"
        raise DataError(f"column {wrong[0]!r} {why}", where, f"write {COLUMNS}")


def _numbers(row: list[str], header: list[str], where: str) -> list[float]:
    if len(row) != len(header):
        raise DataError(f"has {len(row)} columns, the first line has {len(header)}", where, f"write {COLUMNS}")
    numbers = []
    for text, name in zip(row, header, strict=True):
        try:
            numbers.append(parse_number(text, bounded=False))
        except ValueError as error:
            what = str(error) if text.strip() else "is empty"
            raise DataError(f"column {name}: {what}", where, "leave lines of lost samples out") from None
    return numbers


def checked(path: EndEffectorPath) -> EndEffectorPath:
    """A path of two or more entries, if it is finite, in seconds and metres, runs forward and does not jump.

    Raises `DataError` naming the entry where it is not.
    """

    def refuse(k: int, message: str, hint: str) -> DataError:
        return DataError(f"{path.item} {path.first + k} {message}", path.where, hint)

    numbers = [path.times[:, None], path.positions]
    numbers += [path.turns] if path.turns is not None else []
    numbers += [path.opening[:, None]] if path.opening is not None else []
    wrong = np.flatnonzero(~np.isfinite(np.concatenate(numbers, axis=1)).all(axis=1))
    if len(wrong):
        more = f", and {len(wrong) - 1} more are not" if len(wrong) > 1 else ""
        raise refuse(wrong[0], f"is not finite{more}", f"leave out each {path.item} of a lost sample")
    steps = np.diff(path.times)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        raise refuse(back[0] + 1, "is not later than the one before it", "times must rise: sort or repair the file")
    _check_units(path)
    far = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    fast = np.flatnonzero(far > FASTEST_MOVE * steps)
    if len(fast):
        message = f"is {far[fast[0]]:.2f} m from the one {steps[fast[0]]:.3f} s before it"
        raise refuse(
            fast[0] + 1, message, "leave samples out in which the tracking jumps; check that times are seconds"
        )
    if path.turns is not None:
        odd = np.flatnonzero(np.abs(np.linalg.norm(path.turns, axis=1) - 1) > 0.02)
        if len(odd):
            raise refuse(odd[0], "has a quaternion that is not of length 1", "write qx, qy, qz, qw of a rotation")
    return path


def _check_units(path: EndEffectorPath) -> None:
    usual = min(float(np.median(np.diff(path.times))), 1e300)
    if 1 / usual < SLOWEST:
        _, in_second, unit = next(row for row in UNITS if usual < row[0])
        hint = f"times are seconds on the cameras' clock: divide by {in_second:.0f}"
        raise DataError(f"{1 / usual:.2g} {path.item}s a second: are these {unit}?", path.where, hint)
    if 1 / usual > FASTEST:
        raise DataError(f"{1 / usual:.2g} {path.item}s a second", path.where, "times are seconds on the cameras' clock")
    late = int(np.abs(path.times).argmax())
    if abs(path.times[late]) > LATEST:
        message = f"{path.item} {path.first + late} is at {path.times[late]:.3g} s"
        raise DataError(message, path.where, "times are seconds on the cameras' clock")
    far = np.abs(path.positions).max(axis=1)
    k = int(far.argmax())
    if far[k] > FARTHEST:
        message = f"{path.item} {path.first + k} is {far[k]:.0f} m from the world's origin: are these millimetres?"
        raise DataError(message, path.where, "positions are metres: divide x, y and z by 1000")


def at_frames(
    path: EndEffectorPath, times: np.ndarray, tool_point: tuple[float, float, float]
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The path at `times` [F] (s) as datasets `end_effector` [F, 3] (m), `opening` [F] where it has one, and warnings.

    `tool_point` (m) is where the tip is in the end-effector's frame. NaN where the path does not cover a time; raises
    `DataError` where it covers none, and for a tool point without rotations.
    """
    tips = _tips(path, tool_point)
    after = np.searchsorted(path.times, times).clip(1, len(path.times) - 1)
    known = (times >= path.times[0]) & (times <= path.times[-1])
    if not known.any():
        spans = (
            f"it covers {path.times[0]:.2f} to {path.times[-1]:.2f} s, the cameras {times[0]:.2f} to {times[-1]:.2f} s"
        )
        raise DataError(f"no frame has an end-effector: {spans}", path.where, "give it the cameras' clock")
    known &= path.times[after] - path.times[after - 1] <= max(LONGEST_GAP, 2 * float(np.median(np.diff(path.times))))
    found = {"end_effector": np.stack([np.interp(times, path.times, axis) for axis in tips.T], 1)}
    if path.opening is not None:
        found["opening"] = np.interp(times, path.times, path.opening)
    for values in found.values():
        values[~known] = np.nan
    lost = np.flatnonzero(~known)
    if not len(lost):
        return found, []
    parts = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
    told = ", ".join(f"{part[0]} to {part[-1]}" for part in parts[:3]) + (" and more" if len(parts) > 3 else "")
    return found, [f"{path.where} does not cover {len(lost)} of {len(times)} frames: {told}"]


def _tips(path: EndEffectorPath, tool_point: tuple[float, float, float]) -> np.ndarray:
    if not any(tool_point):
        return path.positions
    if path.turns is None:
        raise DataError(
            "ingest.tool_point needs rotations", path.where, "add columns qx, qy, qz, qw, or write where the tip is"
        )
    from scipy.spatial.transform import Rotation

    return path.positions + Rotation.from_quat(path.turns).apply(tool_point)
