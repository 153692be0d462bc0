"""What is told to people: tables, and counted words. How a table looks on a terminal is known in `commands/` alone."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str = ""
    width: int = 0
    """At least."""
    right: bool = False
    """Numbers stand at the right."""

    def cell(self, text: str, width: int) -> str:
        """The text with spaces around it."""
        return text.rjust(width) if self.right else text.ljust(width)


@dataclass(frozen=True)
class Table:
    """Rows of texts under columns; without names of columns there is no heading."""

    columns: Sequence[Column]
    rows: Sequence[Sequence[str]]
    gap: int = 1
    """Spaces between columns."""

    def plain(self) -> list[str]:
        """As lines, for files and pipes: nothing is cut off, and columns stay where they are unless a cell is wider."""
        heads = [[column.name for column in self.columns]] if any(column.name for column in self.columns) else []
        rows = [*heads, *self.rows]
        widths = [max(c.width, *(len(row[k]) for row in rows)) for k, c in enumerate(self.columns)] if rows else []
        cells = [[c.cell(row[k], widths[k]) for k, c in enumerate(self.columns)] for row in rows]
        return [(" " * self.gap).join(row).rstrip() for row in cells]


Line = str | Table
"""A part of what is told."""


def plain(lines: Sequence[Line]) -> list[str]:
    """All as lines."""
    return [text for line in lines for text in ([line] if isinstance(line, str) else line.plain())]


def counted(count: int, word: str) -> str:
    """`1 stroke`, `2 strokes`."""
    return f"{count} {word}" if count == 1 else f"{count} {word}s"
