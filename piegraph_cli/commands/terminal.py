"""Tables on a terminal, by rich; imported only where stdout is one. NO_COLOR and the width are rich's to know."""

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from piegraph_cli.text import Line, Table

STYLES = {
    **dict.fromkeys(("ok", "done", "fresh", "good"), "green"),
    **dict.fromkeys(("stale", "missing", "doubtful", "accepted"), "yellow"),
    **dict.fromkeys(("MISSING", "failed", "bad"), "red"),
    **dict.fromkeys(("cached", "-"), "dim"),
}
"""Of cells that are one of these words."""


def show(lines: Sequence[Line]) -> None:
    """Print lines and tables to stdout; cells that are too wide go on in a further line."""
    console = Console(highlight=False)
    for line in lines:
        if isinstance(line, str):
            console.out(line, highlight=False)
        elif line.rows:
            console.print(_rich(line))


def _rich(table: Table) -> RichTable:
    heads = any(column.name for column in table.columns)
    made = RichTable(box=box.SIMPLE_HEAD if heads else None, show_header=heads, pad_edge=False)
    for column in table.columns:
        made.add_column(Text(column.name), justify="right" if column.right else "left", overflow="fold")
    for row in table.rows:
        made.add_row(*(Text(cell, STYLES.get(cell.strip(), "")) for cell in row))
    return made
