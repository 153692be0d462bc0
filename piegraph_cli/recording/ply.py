"""PLY files that others wrote: the header is held against the file's length before a vertex is read."""

import io
import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.encoded import POINTER

HEADER_BYTES = 1 << 16
"""A header ends within these first bytes."""

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"} | {
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
WHOLE = re.compile(r"[0-9]{1,18}")

AGAIN = "copy or write the file again"


@dataclass(frozen=True)
class _Element:
    """One element of a PLY header; a property has one type, or for a list those of its length and of its items."""

    name: str
    count: int
    properties: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def lists(self) -> bool:
        return any(len(types) == 2 for types in self.properties.values())

    def least_bytes(self, order: str) -> int:
        """What its rows need if every list is empty; of text, a character and a space or line end for each number."""
        return self.count * sum(np.dtype(types[0]).itemsize if order else 2 for types in self.properties.values())


@dataclass(frozen=True)
class _Header:
    """A PLY header: byte order ("" for text), line end, its length in bytes, the elements in their order."""

    order: str
    line_end: bytes
    length: int
    elements: dict[str, _Element]


def read_ply(path: Path, size: int) -> np.ndarray:
    """The vertices [P, 3] of a PLY file of `size` bytes, text or binary in either byte order; all else is skipped.

    Raises `DataError` where header and length do not agree.
    """
    try:
        with path.open("rb") as file:
            header = _ply_header(file.read(HEADER_BYTES), path)
            vertex = header.elements["vertex"]
            needed = header.length + sum(e.least_bytes(header.order) for e in header.elements.values())
            if needed > size:
                counts = ", ".join(f"{e.count} of {e.name}" for e in header.elements.values())
                raise _cut(path, f"the header's {counts} need {needed} bytes or more, it has {size}")
            read = _binary_vertices if header.order else _text_vertices
            columns = read(file, size, header, path)
    except OSError as error:
        raise DataError(f"cannot be read: {error}", str(path)) from None
    return np.stack([columns[axis] for axis in "xyz"], 1) if vertex.count else np.zeros((0, 3))


def _cut(path: Path, why: str) -> DataError:
    return DataError(f"is cut off: {why}", str(path), AGAIN)


def _ply_header(head: bytes, path: Path) -> _Header:
    start = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    if head.startswith(POINTER):
        raise DataError("is a pointer of Git LFS in place of the file", str(path), "git lfs pull")
    if start is None:
        raise DataError("is no PLY file: its first line is not ply", str(path), AGAIN)
    line_end = start[1]
    end = re.compile(line_end + rb"end_header[ \t]*" + line_end).search(head, start.start(1))
    if end is None and len(head) < HEADER_BYTES:
        raise _cut(path, "its header has no end")
    if end is None:
        raise DataError(
            f"its header does not end within {HEADER_BYTES} bytes", str(path), "write it with fewer comments"
        )
    lines = head[start.end() : end.start()].decode("latin-1").split(line_end.decode())
    order, elements = _parse_header(lines, path)
    vertex = elements.get("vertex")
    if vertex is None:
        raise DataError("has no vertices: its header has no element vertex", str(path), "write it as a point cloud")
    if vertex.lists:
        raise DataError("its vertices have list properties", str(path), "write it with x, y, z alone")
    lacking = [axis for axis in "xyz" if vertex.properties.get(axis) not in (("f4",), ("f8",))]
    if vertex.count and lacking:
        raise DataError(
            f"its vertices have no {lacking[0]} of type float or double", str(path), "write x, y, z as float"
        )
    return _Header(order, line_end, end.end(), elements)


def _parse_header(lines: Iterable[str], path: Path) -> tuple[str, dict[str, _Element]]:
    """Byte order and elements from the lines between the first and the last of a PLY header."""
    order: str | None = None
    elements: dict[str, _Element] = {}
    properties: dict[str, tuple[str, ...]] | None = None
    for number, line in enumerate(lines, 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", kind, "1.0"] if kind in ORDERS and order is None:
                order = ORDERS[kind]
            case ["element", name, count] if WHOLE.fullmatch(count) and name not in elements:
                properties = {}
                elements[name] = _Element(name, int(count), properties)
            case ["property", "list", length, item, name] if (
                properties is not None
                and name not in properties
                and item in TYPES
                and TYPES.get(length, "f")[0] in "iu"
            ):
                properties[name] = (TYPES[length], TYPES[item])
            case ["property", kind, name] if properties is not None and name not in properties and kind in TYPES:
                properties[name] = (TYPES[kind],)
            case _:
                raise DataError(f"line {number} of its header cannot be understood: {line[:80]!r}", str(path), AGAIN)
    if order is None:
        raise DataError("its header has no line format", str(path), AGAIN)
    empty = [element.name for element in elements.values() if element.count and not element.properties]
    if empty:
        raise DataError(f"its header names no property of {empty[0]}", str(path), AGAIN)
    return order, elements


def _binary_vertices(file: BinaryIO, size: int, header: _Header, path: Path) -> np.ndarray:
    """The vertices by property, after all elements were measured."""
    file.seek(0)
    data = file.read(size)
    begin, end = 0, header.length
    for element in header.elements.values():
        if element.name == "vertex":
            begin = end
        end = _end_of_rows(element, data, end, header.order, path)
        if end > len(data):
            raise _cut(path, f"the rows of {element.name} do not end within its {len(data)} bytes")
    if data[end : end + 3] not in (b"", b"\n", b"\r\n"):
        raise DataError(f"holds {len(data) - end} bytes more than its header says", str(path), AGAIN)
    vertex = header.elements["vertex"]
    row = np.dtype([(name, header.order + types[0]) for name, types in vertex.properties.items()])
    return np.frombuffer(data, row, vertex.count, begin) if vertex.count else np.zeros(0)


def _end_of_rows(element: _Element, data: bytes, place: int, order: str, path: Path) -> int:
    """Where the rows of an element that begin at `place` end: beyond the data if they are cut off."""
    if not element.lists:
        return place + element.least_bytes(order)
    sizes = [[np.dtype(kind).itemsize for kind in types] for types in element.properties.values()]
    signed = [types[0][0] == "i" for types in element.properties.values()]
    byteorder = "little" if order == "<" else "big"
    for row in range(element.count):
        for (size, *item), sign in zip(sizes, signed, strict=True):
            length = int.from_bytes(data[place : place + size], byteorder, signed=sign) if item else 0  # type: ignore[arg-type]
            if length < 0:
                raise DataError(f"a list of {element.name} {row} has the length {length}", str(path), AGAIN)
            place += size + length * sum(item)
    return place


def _text_vertices(file: BinaryIO, size: int, header: _Header, path: Path) -> dict[str, np.ndarray]:
    """The vertices by property; every row of every element is counted, and each must end: half a number is a number too."""
    file.seek(size - 1)
    if file.read(1) != header.line_end[-1:]:
        raise DataError(
            "its last line has no end, it may be cut off",
            str(path),
            f"{AGAIN}, or end it with a new line if it is whole",
        )
    file.seek(header.length)
    lines = (line for line in io.TextIOWrapper(file, "latin-1") if not line.isspace())
    columns: dict[str, np.ndarray] = {}
    for element in header.elements.values():
        rows = itertools.islice(lines, element.count)
        if element.name == "vertex" and element.count:
            columns, count = _text_columns(rows, element, path)
        else:
            count = _count_rows(rows, element, path)
        if count < element.count:
            raise _cut(path, f"its header says {element.count} of {element.name}, it has {count}")
    if next(lines, None) is not None:
        raise DataError("holds more lines than its header says", str(path), AGAIN)
    return columns


def _text_columns(rows: Iterator[str], vertex: _Element, path: Path) -> tuple[dict[str, np.ndarray], int]:
    first = list(itertools.islice(rows, 1))
    if not first:
        return {}, 0
    try:
        table = np.loadtxt(itertools.chain(first, rows), np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise DataError(f"its vertices cannot be read: {str(error).partition(';')[0]}", str(path), AGAIN) from None
    if table.shape[1] != len(vertex.properties):
        message = f"its vertices have {table.shape[1]} numbers each, {len(vertex.properties)} by its header"
        raise DataError(message, str(path), AGAIN)
    return dict(zip(vertex.properties, table.T, strict=True)), len(table)


def _count_rows(rows: Iterable[str], element: _Element, path: Path) -> int:
    count = 0
    for row in rows:
        words, place = row.split(), 0
        for types in element.properties.values():
            word = words[place] if place < len(words) else ""
            place += 1
            if len(types) == 2:
                place += int(word) if WHOLE.fullmatch(word) else len(words)
        if place != len(words):
            raise DataError(f"row {count} of {element.name} does not fit its header", str(path), AGAIN)
        count += 1
    return count
