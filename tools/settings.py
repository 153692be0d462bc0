"""docs/settings.md, made from the settings' models: what `python -m tools.settings` writes, and a test compares."""

import types
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo

from piegraph_cli.params import Params
from piegraph_cli.stages import STAGES

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"
SIGNS = {annotated_types.Gt: ">", annotated_types.Ge: "≥", annotated_types.Lt: "<", annotated_types.Le: "≤"}
KINDS = {int: "whole number", float: "number", bool: "true or false", str: "text", Path: "path", dict: "table"}
HEAD = """# Settings

Every setting of every stage, made from the models that check them (`make tables` writes this page). A setting is given
as an option, `piegraph STAGE --name VALUE`, with dashes for underscores; or for any stage of a recipe
as `--set STAGE.name=VALUE`; or in the recipe, under `[STAGE]`. Those of `train.MODEL` and other tables are given by
`--set` or in the recipe. Lists are `1,2,3` on the command line.
"""


def bounds(metadata: list[Any]) -> str:
    """`> 0, ≤ 1`."""
    return ", ".join(f"{SIGNS[type(m)]} {getattr(m, type(m).__name__.lower()):g}" for m in metadata if type(m) in SIGNS)


def kind_of(kind: Any, metadata: list[Any]) -> str:
    """What a setting takes, for people: `number > 0`, `soft or nearest`, `whole numbers ≥ 1`."""
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return kind_of(inside[0], [*inside[1:], *metadata])
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(kind_of(part, metadata) for part in inside if part is not type(None)))
    if origin is Literal:
        return ", ".join(f"`{word}`" for word in inside)
    if origin is tuple and inside[-1] is not Ellipsis:
        return f"{len(inside)} numbers"
    if origin is tuple:
        return f"list: {kind_of(inside[0], [])}"
    return f"{KINDS.get(origin or kind, 'table')} {bounds(unfolded(metadata))}".strip()


def unfolded(metadata: list[Any]) -> list[Any]:
    """Bounds, those inside of a `Field` too."""
    return [m for item in metadata for m in (item.metadata if isinstance(item, FieldInfo) else [item])]


def default_of(info: FieldInfo) -> str:
    """The default as it would be given; nothing where there is none."""
    value = info.get_default(call_default_factory=True)
    if value is None or value == () or value == {}:
        return ""
    if isinstance(value, tuple):
        return f"`{','.join(map(str, value))}`"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def table(params: type[Params]) -> list[str]:
    """The settings of one table, a line each."""
    lines = ["| setting | takes | default | what |", "|---|---|---|---|"]
    for name, info in params.model_fields.items():
        if not isinstance(info.annotation, type) or not issubclass(info.annotation, Params):
            cells = (f"`{info.alias or name}`", kind_of(info.annotation, info.metadata), default_of(info))
            meaning = str(info.description).replace("|", "\\|")
            lines.append(f"| {' | '.join(cells)} | {meaning} |".replace("|  |", "| |"))
    return lines


def tables(name: str, params: type[Params], depth: int) -> list[str]:
    """The settings of a stage and of the tables within, each under its heading."""
    if not params.model_fields:
        return []
    lines = ["", f"{'#' * depth} `{name}`", "", *table(params)]
    for field, info in params.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Params):
            lines += tables(f"{name}.{info.alias or field}", info.annotation, depth + 1)
    return lines


def page() -> str:
    """The whole page."""
    parts = [line for stage in STAGES.values() for line in tables(stage.name, stage.params, 2)]
    return HEAD + "\n".join(parts) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
