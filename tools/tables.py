"""The tables of measured figures in README.md and docs/, made from the pieces of experiments and the files in results/.

Tables of experiments are made from their pieces in results/pieces/ (`tools.measured`), as soon as there is one of them. Others,
and those of which nothing is measured with this version, are files.

A file is one table: `title`, `machine`, `date`, `seeds`, `command` and `note` as far as they are known, `columns` and
`rows`. A cell is a text, a number, or a list of numbers that its column's `form` puts together; a list that begins
with a text has that as its form. Numbers are printed with the digits that they have in the file. A page holds
`<!-- table: NAME -->` and `<!-- end -->`; what stands between them is written by `python -m tools.tables`.
"""

import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

from piegraph_cli.errors import DataError
from tools import measured

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).parents[1]
RESULTS = REPOSITORY / "results"
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
PLACE = re.compile(r"(<!-- table: ([\w-]+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
NEEDED = {"title", "columns", "rows"}
KNOWN = NEEDED | {"machine", "date", "seeds", "command", "note"}


class Figure(float):
    """A number that is printed as it was written: 5.60 is not 5.6."""

    text: str

    def __new__(cls, text: str) -> "Figure":
        figure = super().__new__(cls, text)
        figure.text = text
        return figure

    def __str__(self) -> str:
        return self.text


def read(path: Path) -> dict[str, Any]:
    """A table. Raises ValueError where a key is missing or not known, or a row is shorter or longer than the columns."""
    table = tomllib.loads(path.read_text(encoding="utf-8"), parse_float=Figure)
    if wrong := (set(table) - KNOWN) | (NEEDED - set(table)):
        raise ValueError(f"{path.name}: {', '.join(sorted(wrong))} is missing or not known")
    for row in table["rows"]:
        if len(row) != len(table["columns"]):
            raise ValueError(f"{path.name}: {len(row)} cells in place of {len(table['columns'])} at {row[0]!r}")
    return table


def cell_text(cell: Any, form: str) -> str:
    """What a cell shows. Raises ValueError where its form asks for another number of figures."""
    if isinstance(cell, str):
        return cell
    figures = cell if isinstance(cell, list) else [cell]
    if isinstance(figures[0], str):
        form, *figures = figures
    if form.count("{}") != len(figures):
        raise ValueError(f"{form!r} does not take {len(figures)} figures: {cell}")
    return form.format(*map(str, figures))


def cells(table: dict[str, Any]) -> list[list[str]]:
    """The rows as texts, after one of the columns' names."""
    forms = [column.get("form", "{}") for column in table["columns"]]
    rows = [[cell_text(cell, form) for cell, form in zip(row, forms, strict=True)] for row in table["rows"]]
    return [[column["name"] for column in table["columns"]], *rows]


def markdown(table: dict[str, Any]) -> str:
    """A table of Markdown, or a block of columns as wide as `width` says where all columns have widths."""
    head, *rows = cells(table)
    widths = [column.get("width") for column in table["columns"]]
    if all(widths):
        lines = [row[0].ljust(widths[0]) + "".join(map(str.rjust, row[1:], widths[1:])) for row in (head, *rows)]
        return "\n".join(["```", *map(str.rstrip, lines), "```"]) + "\n"
    lines = ["|" + "".join(f" {text} |" if text else " |" for text in row) for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]]) + "\n"


@cache
def of_pieces(folder: Path) -> measured.Measured:
    """The pieces of a folder, read once."""
    return measured.Measured(folder)


def table(name: str, results: Path) -> str:
    """A table by its name. Raises ValueError where nothing makes it."""
    made = of_pieces(results / "pieces").table(name) if name in measured.NAMES else None
    if made is not None:
        return made
    if (results / f"{name}.toml").is_file():
        return markdown(read(results / f"{name}.toml"))
    if name in measured.NAMES:
        return f"{measured.NOT_MEASURED}\n"
    raise ValueError(f"no {name}.toml in {results.name}/")


def filled(page: str, results: Path = RESULTS) -> str:
    """A page with its tables as they are made. Raises ValueError where nothing makes one, or a mark has no end."""
    places = PLACE.findall(page)
    if len(places) != page.count("<!-- table:") or len(places) != page.count("<!-- end -->"):
        raise ValueError("a `<!-- table: NAME -->` without its `<!-- end -->`, or the other way")
    return PLACE.sub(lambda place: place[1] + table(place[2], results) + place[4], page)


def main() -> None:
    for path in PAGES:
        page = path.read_text(encoding="utf-8")
        try:
            new = filled(page)
        except DataError as error:
            sys.exit(str(error))
        if new != page:
            path.write_text(new, encoding="utf-8")
            print(f"{path.relative_to(REPOSITORY)}: tables written")
    for name in measured.NAMES:
        if (old := RESULTS / f"{name}.toml").is_file() and of_pieces(RESULTS / "pieces").table(name) is not None:
            print(f"{old.relative_to(REPOSITORY)}: pieces make this table now, remove the file")


if __name__ == "__main__":
    main()
