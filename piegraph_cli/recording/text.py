"""Text files of others, and the numbers in them: read here alone, with bounds, and the number of the line in messages."""

import codecs
import io
import math
import os
import re
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError

MOST_BYTES = 1 << 27
"""Of a text file."""
LARGEST = 1e20
"""No number is larger, in whatever unit: nanoseconds since 1970 are 2e18."""
_NUMBER = re.compile(r"[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|nan|inf|infinity)", re.ASCII | re.IGNORECASE)


def read_text(path: Path, hint: str) -> str:
    """The text of a regular file in UTF-8, or in UTF-16 where it says so itself.

    Raises `DataError` for pipes, devices, files too large, and what is no text.
    """
    try:
        if not path.is_file():
            if not os.path.lexists(path):
                raise DataError("cannot be read: it is missing", str(path), hint)
            raise DataError("cannot be read: no regular file", str(path), hint)
        if path.stat().st_size > MOST_BYTES:
            raise DataError(f"has more than {MOST_BYTES} bytes", str(path), hint)
        data = path.read_bytes()
        wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return io.TextIOWrapper(io.BytesIO(data), "utf-16" if wide else "utf-8-sig").read()
    except (OSError, UnicodeError) as error:
        raise DataError(f"cannot be read: {error}", str(path), hint) from None


def parse_number(word: str, bounded: bool = True) -> float:
    """A number; with `bounded` False also nan, inf and those that are too large. Raises `ValueError` that says why not."""
    text = word.strip()
    if not _NUMBER.fullmatch(text):
        comma = ": its decimal comma has to be a point" if _NUMBER.fullmatch(text.replace(",", ".")) else ""
        raise ValueError(f"{_short(text)} is no number{comma}")
    value = float(text)
    if not bounded:
        return value
    if not math.isfinite(value):
        raise ValueError(f"{_short(text)} is not a finite number")
    if abs(value) > LARGEST:
        raise ValueError(f"{_short(text)} is too large")
    return value


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:40]}...")


def read_lines(path: Path, hint: str) -> list[tuple[int, str]]:
    """The lines of a text file with their numbers from 1, but for empty ones and those that begin with #."""
    lines = enumerate(read_text(path, hint).splitlines(), 1)
    return [(n, line) for n, line in lines if line.strip() and not line.lstrip().startswith("#")]


def read_rows(path: Path, hint: str, *, bounded: bool = True, commas: bool = False) -> list[tuple[int, list[float]]]:
    """Numbers with spaces between, or `commas` too, by line: its number from 1, and what it holds.

    Empty lines and those that begin with # are left out. Raises `DataError` naming the line.
    """
    rows = []
    for n, line in read_lines(path, hint):
        words = line.replace(",", " ").split() if commas else line.split()
        try:
            rows.append((n, [parse_number(word, bounded) for word in words]))
        except ValueError as error:
            raise DataError(str(error), f"{path}, line {n}", hint) from None
    return rows


def read_table(
    path: Path, hint: str, columns: int | None = None, *, bounded: bool = True, commas: bool = False
) -> np.ndarray:
    """Numbers [line, column] of a text file, as many in each line. Raises `DataError` naming the line."""
    rows = read_rows(path, hint, bounded=bounded, commas=commas)
    count = columns or (len(rows[0][1]) if rows else 0)
    odd = next(((n, row) for n, row in rows if len(row) != count), None)
    if odd is not None:
        raise DataError(f"has {len(odd[1])} numbers, expected {count}", f"{path}, line {odd[0]}", hint)
    return np.array([row for _, row in rows], float).reshape(len(rows), count)


def read_numbers(path: Path, hint: str, *, bounded: bool = True, commas: bool = False) -> np.ndarray:
    """All numbers of a text file, one after the other. Raises `DataError` naming the line."""
    rows = read_rows(path, hint, bounded=bounded, commas=commas)
    return np.array([value for _, row in rows for value in row], float)
