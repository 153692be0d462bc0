"""Recipes: one TOML file per experiment, a section per stage. The one in force is kept as RUN/recipe.toml."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tomli_w

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.params import Params, validated
from piegraph_cli.workspace.stage import Stage, Table

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

SHIPPED = next(
    p for p in (Path(__file__).parents[1] / "pipelines", Path(__file__).parents[2] / "pipelines") if p.is_dir()
)


@dataclass(frozen=True)
class Recipe:
    """The settings given for each stage of a table; whatever is not given has its default."""

    table: Table = field(repr=False)
    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    _params: dict[str, Params] = field(default_factory=dict, init=False, repr=False, compare=False)

    def params(self, stage: Stage) -> Params:
        """The validated settings of a stage."""
        if stage.name not in self._params:
            self._params[stage.name] = _validate(stage, self.sections.get(stage.name, {}), "recipe")
        return self._params[stage.name]

    def with_values(self, stage: Stage, values: Mapping[str, Any], where: str, base: Path) -> "Recipe":
        """This recipe with some settings of a stage replaced; relative paths among them are taken from `base`.

        Raises `UsageError` for unknown or wrong ones.
        """
        replaced = set(stage.params.query) if set(stage.params.query) & set(values) else set()
        section = {k: v for k, v in self.sections.get(stage.name, {}).items() if k not in replaced}
        for name, value in values.items():
            table, dot, inner = name.partition(".")
            before = section.get(table)
            section[table] = (before if isinstance(before, dict) else {}) | {inner: value} if dot else value
        checked = _validate(stage, section, where)
        section = checked.model_dump(mode="json", by_alias=True, exclude_unset=True)
        try:
            for name, place in checked.placed(base).items():
                if name in values or name.partition(".")[0] in values:
                    section = put(section, name, place)
            for name, several in checked:
                if name in values and isinstance(several, tuple) and any(isinstance(file, Path) for file in several):
                    places = [os.path.realpath(base / file) for file in several]
                    section[name] = places if isinstance(section[name], list) else places[0]
        except ValueError as error:  # a null byte
            raise UsageError(f"{stage.name}: a path that cannot be: {error}", where, "correct it") from None
        return replace(self, sections=self.sections | {stage.name: section})

    def chain(self) -> list[Stage]:
        """The stages of this recipe, in order: its sources, and all that can be made of them and need not be named.

        Of two that write the same artifact the later one counts: tracks of a recording before those of a simulation.
        """
        sources = [stage for stage in self.table.values() if not stage.reads]
        wanted = [stage for stage in sources if stage.name in self.sections] or sources[:1]
        made: dict[str, Stage] = {}
        for stage in self.table.values():
            follows = bool(stage.reads) and all(name in made for name in stage.reads)
            if stage in wanted or (follows and (not stage.on_demand or stage.name in self.sections)):
                made[stage.writes] = stage
        return [stage for stage in self.table.values() if stage in made.values()]

    def save(self, path: Path) -> None:
        """Write the recipe as TOML."""
        plain = {name: _plain(section) for name, section in self.sections.items()}
        with atomic_file(path) as temporary:
            temporary.write_text(tomli_w.dumps(plain))


def put(section: dict[str, Any], name: str, value: Any) -> dict[str, Any]:
    """A section with one value in another's place; TABLE.NAME is one of a table in it."""
    table, dot, inner = name.partition(".")
    return section | {table: put(section.get(table, {}), inner, value) if dot else value}


def load_recipe(path: Path, table: Table) -> Recipe:
    """Read a recipe; paths in it are relative to its folder. Raises `UsageError` for unknown sections and settings."""
    if path.exists() and not path.is_file():
        raise UsageError("is not a regular file", str(path), "give a .toml file")
    try:
        sections = tomllib.loads(path.read_text("utf-8-sig"))
    except FileNotFoundError:
        raise DataError("no such recipe", str(path), f"give a .toml file, or one of {', '.join(shipped())}") from None
    except (ValueError, OSError, RecursionError) as error:  # no TOML, no text, a number of thousands of digits, a depth
        hint = "texts and paths stand in 'quotes', numbers have a point, a section is there once; save it as UTF-8"
        raise UsageError(f"not a readable TOML file: {error}", str(path), hint) from None
    recipe = Recipe(table)
    for name, section in sections.items():
        if name not in table or not isinstance(section, dict):
            raise UsageError(f"unknown section [{name}]", str(path), f"sections are the stages: {', '.join(table)}")
        recipe = recipe.with_values(table[name], section, str(path), path.parent)
    return recipe


def change_recipe(path: Path, table: Table, stage: Stage, values: Mapping[str, Any]) -> None:
    """Replace some settings of a stage in a recipe's file; all others stay. Raises `UsageError` for wrong ones."""
    load_recipe(path, table).with_values(stage, values, str(path), path.parent).save(path)


def shipped() -> list[str]:
    """Names of the recipes that come with the package."""
    return sorted(p.stem for p in SHIPPED.glob("[!.]*.toml"))


def find_recipe(name: str) -> Path:
    """The path of a recipe given as a file or by the name of a shipped one."""
    path = SHIPPED / f"{name}.toml"
    return path if name in shipped() and not Path(name).is_file() else Path(name)


def parse_setting(text: str, table: Table) -> tuple[Stage, str, Any]:
    """`stage.setting=value` with a TOML value; anything that is not TOML is text."""
    place, equals, value = text.partition("=")
    stage, dot, setting = place.strip().partition(".")
    hint = "use STAGE.SETTING=VALUE, as in --set track.stiffness=0.1 or train.piegraph.steps=500"
    if not equals or not dot or stage not in table:
        raise UsageError(f"cannot read --set {text}", hint=hint)
    try:
        return table[stage], setting, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return table[stage], setting, value.strip()
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, a depth
        raise UsageError(f"cannot read --set {text:.80}: {error}", hint=hint) from None


def _validate(stage: Stage, values: Mapping[str, Any], where: str) -> Params:
    return validated(stage.params, dict(values), stage.name, where, f"piegraph {stage.name} --help")


def _plain(section: Mapping[str, Any]) -> dict[str, Any]:
    return {k: str(v) if isinstance(v, Path) else v for k, v in section.items() if v is not None}
