"""What all settings share: their base, checks that name the wrong one, and the types that several rooms use.

Each room keeps its settings in a `params.py` of its own: the source of CLI options, recipe checks and cache keys. Nothing
heavy is imported in any of them, so that `piegraph --help` answers at once. The core takes these models as they are.
"""

import math
import os
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from piegraph_cli.errors import UsageError


def split_commas(value: object) -> object:
    """`1,2,3` on the command line means a list."""
    return [part.strip() for part in value.split(",")] if isinstance(value, str) else value


def _check_box(box: tuple[float, ...]) -> tuple[float, ...]:
    for axis, low, high in zip("xyz", box[::2], box[1::2], strict=True):
        if low >= high:
            raise ValueError(f"{axis}min {low:g} is not below {axis}max {high:g}: give xmin,xmax,ymin,ymax,zmin,zmax")
    return box


def split_boxes(value: object) -> object:
    """`0,1,0,1,0,1;2,3,2,3,0,1` on the command line means two boxes."""
    return [part for part in value.split(";") if part.strip()] if isinstance(value, str) else value


def _check_yaw(pose: tuple[float, float, float]) -> tuple[float, float, float]:
    if abs(pose[2]) > 2 * math.pi:
        radians = math.radians(pose[2])
        raise ValueError(
            f"yaw {pose[2]:g} is more than a whole turn: it is in radians, {pose[2]:g} degrees are {radians:.3f}"
        )
    return pose


STEEPEST_SLOPE = 0.6
"""Of a table; more is a world whose z does not point up."""


def _plane(value: object) -> object:
    """A height alone is a level plane."""
    parts = split_commas(value)
    if isinstance(parts, (int, float, str)):
        parts = [parts]
    return [*parts, 0.0, 0.0] if isinstance(parts, (list, tuple)) and len(parts) == 1 else parts


def _check_slopes(table: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(abs(table[1]), abs(table[2])) > STEEPEST_SLOPE:
        raise ValueError("a table that steep is a world whose z does not point up: give HEIGHT [m],SLOPE_X,SLOPE_Y")
    return table


def split_pairs(value: object) -> object:
    """`young=3e4,goal=crumpled` on the command line means a table of settings."""
    if not isinstance(value, str):
        return value
    pairs = [part.partition("=") for part in value.split(",") if part.strip()]
    if any(not equals for _, equals, _ in pairs):
        raise ValueError("give NAME=VALUE,NAME=VALUE")
    return {name.strip(): text.strip() for name, _, text in pairs}


Mode = Literal["push", "pick"]
"""What a stroke does, as people write it; arrays hold its number."""
PUSH, PICK = 0, 1
Pose2 = Annotated[tuple[float, float, float], BeforeValidator(split_commas), AfterValidator(_check_yaw)]
Box = Annotated[
    tuple[float, float, float, float, float, float], BeforeValidator(split_commas), AfterValidator(_check_box)
]
Boxes = Annotated[tuple[Box, ...], BeforeValidator(split_boxes), Field(max_length=100)]
"""Boxes one after the other; on the command line with a semicolon between them."""
Table = Annotated[tuple[float, float, float], BeforeValidator(_plane), AfterValidator(_check_slopes)]
"""The plane z = height [m] + a x + b y in which a table lies; the height alone where it is level."""
Counts = Annotated[tuple[Annotated[int, Field(ge=1)], ...], BeforeValidator(split_commas), Field(min_length=1)]
Lengths = Annotated[
    tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(split_commas), Field(min_length=1, max_length=3)
]
Thresholds = Annotated[tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(split_commas), Field(min_length=1)]
Modes = Annotated[tuple[Mode, ...], BeforeValidator(split_commas)]


def mode_number(word: str) -> int:
    """`PUSH` or `PICK`."""
    return get_args(Mode).index(word)


def mode_word(number: int) -> str:
    """`push` or `pick`; `mode 7` where there is no such mode."""
    words = get_args(Mode)
    return words[number] if 0 <= number < len(words) else f"mode {number}"


LARGEST = 2**63 - 1
"""Of whole numbers: what TOML and arrays can hold; Python refuses to write down one of thousands of digits."""


def _unfit(value: object) -> str:
    """Why a value can stand in no recipe, or nothing."""
    if isinstance(value, dict):
        return next(filter(None, map(_unfit, (*value, *value.values()))), "")
    if isinstance(value, (list, tuple)):
        return next(filter(None, map(_unfit, value)), "")
    if isinstance(value, (str, Path)) and not str(value).isascii():
        return (
            "" if str(value).encode(errors="ignore").decode() == str(value) else f"{str(value)!a:.80} is no UTF-8 text"
        )
    return f"more than {LARGEST}" if isinstance(value, int) and abs(value) > LARGEST else ""


MOST = {"m": 1.0, "s": 30.0}
"""Lengths and times by their unit beyond which a setting is thousands of what is meant, unless its default is more."""
NUMBERS = (int, float, int | None, float | None)
FARTHEST = 10.0
"""Metres (seconds) of a place, one number of several."""


def _numbers(value: object) -> list[float]:
    if isinstance(value, tuple):
        return [number for part in value for number in _numbers(part)]
    return [value] if isinstance(value, float) else []


class Params(BaseModel):
    """Base of all settings: frozen, unknown keys refused, no NaN or infinity, nothing that no recipe can hold."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _no_words_for_numbers(cls, values: Any) -> Any:
        """Refuse true and false for numbers: they would count as 1 and 0."""
        for name, value in values.items() if isinstance(values, dict) else ():
            field = cls.model_fields.get(name)
            if isinstance(value, bool) and field is not None and field.annotation in NUMBERS:
                raise ValueError(f"{name} is {str(value).lower()}: give a number")
        return values

    @model_validator(mode="after")
    def _check_units(self) -> "Params":
        """Refuse lengths, places and times that are thousands of what is meant: millimetres and milliseconds."""
        for name, field in type(self).model_fields.items():
            unit = next((u for u in MOST if f"[{u}]" in (field.description or "")), None)
            value, usual = getattr(self, name), field.default
            if unit is None or not isinstance(value, (float, tuple)):
                continue
            most = MOST[unit] if field.annotation is float else FARTHEST
            far = next((x for x in _numbers(value) if abs(x) > most), None)
            if far is not None and not (isinstance(usual, float) and usual > most):
                raise ValueError(f"{name} is in {unit}: {far:g} m{unit} are {far / 1000:g}")
        return self

    query: ClassVar[tuple[str, ...]] = ()
    """Settings that belong together: giving one forgets the others."""

    later: ClassVar[tuple[str, ...]] = ()
    """Settings that came later: at their defaults they are in no key, so that what was made before stays fresh."""

    @model_validator(mode="after")
    def _all_fit(self) -> "Params":
        for name, value in self:
            if why := _unfit(value):
                raise ValueError(f"{name}: {why}")
        return self

    def content(self) -> dict[str, Any]:
        """What results depend on, as plain values: these settings without what only says how results are come by."""
        unused = {name for name in self.later if getattr(self, name) == type(self).model_fields[name].default}
        return self.model_dump(mode="json", exclude=unused)

    def files(self) -> dict[str, Path]:
        """Files and folders these settings name; their content, not their path, enters the cache key.

        Those in a table of settings are called TABLE.NAME.
        """
        own = {name: value for name, value in self if isinstance(value, Path)}
        tables = {type(self).model_fields[name].alias or name: of for name, of in self if isinstance(of, Params)}
        return own | {f"{name}.{inner}": file for name, of in tables.items() for inner, file in of.files().items()}

    def placed(self, base: Path) -> dict[str, str]:
        """The settings that name files, with paths that are taken from `base` made absolute."""
        return {name: os.path.realpath(base / file) for name, file in self.files().items()}

    def artifacts(self) -> dict[str, tuple[Path, str]]:
        """Artifacts of other runs that these settings name: path and what it is; their keys enter the cache key."""
        return {}


Settings = TypeVar("Settings", bound=Params)


def validated(params: type[Settings], values: Any, name: str, where: str, hint: str) -> Settings:
    """Settings of that type. Raises `UsageError` that names the first wrong one, as a part of `name`."""
    try:
        return params.model_validate(values)
    except ValidationError as error:
        problem = error.errors()[0]
        setting = ".".join([name, *(str(part) for part in problem["loc"])])
        if problem["type"] == "missing" and problem["loc"] and isinstance(problem["loc"][-1], int):
            setting, few = setting.rpartition(".")[0], f"has {problem['loc'][-1]} numbers, more are needed"
            raise UsageError(f"{setting}: {few}", where, hint) from None
        if problem["type"] != "extra_forbidden":
            message = problem["msg"].removeprefix("Value error, ")
            raise UsageError(f"{setting}: {message}", where, hint) from None
        table: type[BaseModel] = params
        for part in problem["loc"][:-1]:
            inner = next((f.annotation for n, f in table.model_fields.items() if part in (n, f.alias)), None)
            table = inner if isinstance(inner, type) and issubclass(inner, BaseModel) else table
        known = ", ".join(field.alias or field_name for field_name, field in table.model_fields.items())
        of = setting.rpartition(".")[0]
        hint = f"settings of {of}: {known}" if known else f"{of} has no settings: leave it out"
        raise UsageError(f"{setting}: unknown setting", where, hint) from None
