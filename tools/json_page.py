"""docs/json.md: what every command prints with `--json`, made from the models of the results.

What stands between `<!-- json -->` and `<!-- end of json -->` is written by `python -m tools.json_page`.
"""

import re
import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, RootModel

from piegraph_cli.commands.program import GROUPS
from piegraph_cli.commands.results import Envelope, results_of
from tools.tables import REPOSITORY

PAGE = REPOSITORY / "docs" / "json.md"
PLACE = re.compile(r"(<!-- json -->\n)(.*)(<!-- end of json -->)", re.DOTALL)
WORDS = {
    **{str: "text", float: "number", int: "integer", bool: "true or false", type(None): "null"},
    Any: "anything",
}
WITHOUT = {"view": "it serves until it is interrupted"}
"""Commands that have no `--json`, and why."""


def kind_text(kind: Any) -> str:
    """A type for readers; a model is a link to its table."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind in WORDS:
        return WORDS[kind]
    if origin is Literal:
        return ", ".join(f'`"{word}"`' for word in inner)
    if origin is list:
        return f"list of {kind_text(inner[0])}"
    if origin is tuple:
        return f"[{', '.join(map(kind_text, inner))}]"
    if origin is dict:
        return "object" if inner[1] is Any else f"object of {kind_text(inner[1])} by name"
    if origin in (Union, types.UnionType):
        return " or ".join(map(kind_text, inner))
    return f"[{kind.__name__}](#{kind.__name__.lower()})"


def models_in(kind: Any) -> Iterator[type[BaseModel]]:
    """The models that a type names, outermost first."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
        for field in kind.model_fields.values():
            yield from models_in(field.annotation)
    for inner in get_args(kind):
        yield from models_in(inner)


def table(model: type[BaseModel]) -> list[str]:
    """The keys of a model as a table of Markdown."""
    lines = ["| key | is | |", "|---|---|---|"]
    for name, field in model.model_fields.items():
        meaning = " ".join((field.description or "").split())
        optional = not field.is_required()
        kind = kind_text(field.annotation)
        kind = f"{kind.removesuffix(' or null')}, optional" if optional else kind
        lines.append(f"| `{field.alias or name}` | {kind} |{f' {meaning}' if meaning else ''} |")
    return [*lines, ""]


def section(model: type[BaseModel], heading: str) -> list[str]:
    """A model under its heading."""
    said = [heading, "", " ".join(str(model.__doc__).split()), ""]
    if issubclass(model, RootModel):
        return [*said, f"{kind_text(model.model_fields['root'].annotation).capitalize()}.", ""]
    return [*said, *table(model)]


def commands() -> list[str]:
    """All commands, in the order of `piegraph --help`."""
    return [name for group in GROUPS.values() for name in group]


def body() -> str:
    """Envelope, a table of commands, then every model."""
    lines = [*table(Envelope), "## Results by command", "", "| command | `result` |", "|---|---|"]
    models: list[type[BaseModel]] = list(models_in(Envelope))[1:]
    for name in commands():
        if name in WITHOUT:
            lines.append(f"| `{name}` | has no `--json`: {WITHOUT[name]} |")
            continue
        kinds = results_of(name)
        lines.append(f"| `{name}` | {' or '.join(map(kind_text, kinds))} |")
        models += [model for kind in kinds for model in models_in(kind)]
    lines += ["", "## Objects", ""]
    for model in dict.fromkeys(models):
        lines += section(model, f"### {model.__name__}")
    return "\n".join(lines)


def filled(page: str) -> str:
    """The page as the models make it. Raises ValueError where the marks are missing."""
    if not PLACE.search(page):
        raise ValueError("`<!-- json -->` and `<!-- end of json -->` are missing")
    return PLACE.sub(lambda place: place[1] + body() + place[3], page)


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    if (new := filled(page)) != page:
        PAGE.write_text(new, encoding="utf-8")
        print(f"{PAGE.relative_to(REPOSITORY)}: written")


if __name__ == "__main__":
    main()
