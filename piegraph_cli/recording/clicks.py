"""Spots of an object that a person clicked in the images of a sequence: a table with a line per click."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.motion_csv import read_rows

COLUMNS = ("spot", "camera", "frame", "column", "row")
WRITE = f"columns {','.join(COLUMNS)}, with commas between; column and row in pixels"


@dataclass(frozen=True)
class Click:
    """One click on a spot of the object."""

    spot: str
    """Name of the spot."""
    camera: str
    frame: int
    """The image's number in the recording."""
    column: float
    """Pixels, as `row`; whole numbers are the middles of pixels."""
    row: float
    where: str = ""
    """File and line, for messages."""


def read_clicks(path: Path) -> list[Click]:
    """The clicks of a table. Raises `DataError` naming the line that is none, or that says again what another said."""
    rows = read_rows(path, WRITE)
    header = [name.strip() for name in rows[0]] if rows else []
    if sorted(header) != sorted(COLUMNS):
        raise DataError(f"has the columns {','.join(header) or '(none)'}", f"{path}, line 1", f"write {WRITE}")
    clicks: list[Click] = []
    first: dict[tuple[str, str, int], Click] = {}
    for number, row in enumerate(rows[1:], 2):
        where = f"{path}, line {number}"
        if len(row) != len(header):
            raise DataError(f"has {len(row)} values, the header {len(header)}", where, f"write {WRITE}")
        click = _click(dict(zip(header, (value.strip() for value in row), strict=True)), where)
        before = first.setdefault((click.spot, click.camera, click.frame), click)
        if before is not click:
            message = f"spot {click.spot} was clicked in frame {click.frame} of camera {click.camera} already"
            raise DataError(message, where, f"keep one of the two; the other is in {before.where}")
        clicks.append(click)
    return clicks


def _click(values: dict[str, str], where: str) -> Click:
    try:
        column, row, frame = float(values["column"]), float(values["row"]), int(values["frame"])
        whole = abs(column) < 1e6 and abs(row) < 1e6 and frame >= 0  # NaN is not
    except ValueError:
        whole = False
    if not whole or not values["spot"] or not values["camera"]:
        raise DataError(f"is no click: {','.join(values.values())}", where, f"write {WRITE}; frame is a whole number")
    return Click(values["spot"], values["camera"], frame, column, row, where)


def write_clicks(path: Path, clicks: Sequence[Click]) -> None:
    """Write a table that `read_clicks` reads. Raises `DataError` where it cannot be written."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows([c.spot, c.camera, c.frame, f"{c.column:g}", f"{c.row:g}"] for c in clicks)
    with atomic_file(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")
