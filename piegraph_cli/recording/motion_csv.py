"""Tables of particles over time: a line per frame, columns time, ee_x, ee_y, ee_z[, contact][, mode], p0_x, p0_y, p0_z, ..."""

import csv
import io
import re
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.points import check_size
from piegraph_cli.recording.text import parse_number

FIXED = ("time", "ee_x", "ee_y", "ee_z")
OPTIONAL = ("contact", "mode")
COLUMNS = "columns time, ee_x, ee_y, ee_z[, contact][, mode], p0_x, p0_y, p0_z, p1_x, ..., with commas between"
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?\s*")
_PARTICLE = re.compile(r"p(0|[1-9][0-9]*)_([xyz])")


def read_rows(path: Path, columns: str) -> list[list[str]]:
    """The rows of a .csv without empty ones at its end. Raises `DataError`, which names the `columns` to write.

    Semicolons and tabs are read too, where the first line has no comma, with commas in numbers, as spreadsheets of many
    countries write them.
    """
    check_size(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            text = file.read().replace("\r\r\n", "\r\n")  # of two programs that each end the line
        head = text.split("\n", 2)[:2]
        mark = next((mark for mark in ";\t" if all(mark in line for line in head)), ",") if "," not in head[0] else ","
        rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=mark, strict=True))
    except UnicodeDecodeError as error:
        raise DataError(f"is no text in UTF-8: {error}", str(path), "save it as UTF-8") from None
    except (OSError, csv.Error) as error:
        raise DataError(f"not a readable table: {error}", str(path), f"write {columns}") from None
    if mark != ",":
        rows = [[w.replace(",", ".") if _DECIMAL_COMMA.fullmatch(w) else w for w in row] for row in rows]
    while rows and not "".join(rows[-1]).strip():
        rows.pop()
    return rows


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """particles [T, N, 3], end_effector [T, 3], times [T], and contact and mode [T] where it has them.

    Raises `DataError` naming the line and the column.
    """
    rows = read_rows(path, COLUMNS)
    if len(rows) < 2:
        raise DataError("has no line of numbers", str(path), f"write {COLUMNS}, then a line per frame")
    header = [name.strip() for name in rows[0]]
    count = _check_header(header, path)
    numbers = [k for k, name in enumerate(header) if name != "mode"]
    values = np.array([_numbers(row, numbers, header, f"{path}, line {n}") for n, row in enumerate(rows[1:], 2)])
    column = {header[k]: values[:, i] for i, k in enumerate(numbers)}
    found = {
        "particles": np.stack([[column[f"p{k}_{axis}"] for axis in "xyz"] for k in range(count)]).transpose(2, 0, 1),
        "end_effector": np.stack([column[f"ee_{axis}"] for axis in "xyz"], 1),
        "times": column["time"],
    }
    if "contact" in column:
        found["contact"] = column["contact"]
    if "mode" in header:
        found["mode"] = np.array([row[header.index("mode")] for row in rows[1:]])
    return found


def _check_header(header: list[str], path: Path) -> int:
    """The number of particles that the columns are of."""
    where = f"{path}, line 1"
    particles = {name for name in header if _PARTICLE.fullmatch(name)}
    count = len({name.partition("_")[0] for name in particles})
    wanted = [*FIXED, *(f"p{k}_{axis}" for k in range(max(count, 1)) for axis in "xyz")]
    missing = [name for name in wanted if name not in header]
    if missing:
        raise DataError(f"has no column {missing[0]}", where, f"write {COLUMNS}")
    wrong = [name for k, name in enumerate(header) if name not in (*wanted, *OPTIONAL) or name in header[:k]]
    if wrong:
        why = "is there twice" if header.count(wrong[0]) > 1 else "is not known"
        raise DataError(f"column {wrong[0]!r} {why}", where, f"write {COLUMNS}")
    return count


def _numbers(row: list[str], columns: list[int], header: list[str], where: str) -> list[float]:
    if len(row) != len(header):
        message = f"has {len(row)} columns, the first line has {len(header)}"
        raise DataError(message, where, "every line has all particles: they may not change in number")
    numbers = []
    for k in columns:
        try:
            numbers.append(parse_number(row[k], bounded=False))
        except ValueError as error:
            what = str(error) if row[k].strip() else "is empty"
            hint = "write numbers with a point; fill gaps of lost markers in, or leave these frames out"
            raise DataError(f"column {header[k]}: {what}", where, hint) from None
    return numbers
