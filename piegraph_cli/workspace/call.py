"""How a stage is called: what its command takes beside its settings, what that means, and what the command then tells."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from piegraph_cli.params import Params
from piegraph_cli.text import Line

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from piegraph_cli.workspace.run import Run

Given = Mapping[str, Any]
"""Options that were given, by the names of the settings."""

Told = tuple[dict[str, Any], list[Line]]
"""What a command tells: one object, and the same as lines for people."""


@dataclass(frozen=True)
class Option:
    """A setting that can be given in one word."""

    kind: Any
    """`int`, `float`, `bool`, `Path`, `str`, or a `Literal`."""
    meaning: str
    default: str = ""
    """As it is shown; empty where there is none."""


@dataclass(frozen=True)
class Folder:
    """The option that names the folder to work in."""

    option: str = "run"
    help: str = "run folder"
    default: Callable[[Given], Path] | None = None
    """From the other options; None: it has to be given."""


@dataclass(frozen=True)
class Instead:
    """Something else that is made with the same settings where a flag says so, and is no artifact of a run."""

    flag: str
    help: str
    make: Callable[[Path, Any, int, bool], Told]
    """`make(folder, settings, jobs, force)`."""


@dataclass(frozen=True)
class Call:
    """How a stage is called, where that is more than its settings as options."""

    more: str = ""
    """What to say beside the stage's help."""
    argument: str = ""
    """The setting that is given first, without its name."""
    first: tuple[str, ...] = ()
    """The options that people set first."""
    folder: Folder = Folder()
    options: Callable[[], dict[str, Option]] | None = None
    """The options, by name; by default the stage's settings."""
    apply: Callable[["Run", Given], tuple[dict[str, Any], tuple[str, ...]]] | None = None
    """The settings that given options mean, and the units they are about (none: all); by default themselves, and all."""
    remembers: bool = True
    """Whether the run keeps settings that worked."""
    describe: str = ""
    """`module:function` that tells what a run has, as `function(run)`; by default every unit is told in a line."""
    refuses: str = ""
    """`module:function` that says, as `function(run)`, what error ends the command though the run's only unit is kept."""
    counts: str = ""
    """A setting that counts what one unit has; then the command tells how many of it were made in a second."""
    instead: Instead | None = None
    out: bool = False
    """Whether its artifact, the run's only one, may be written elsewhere: the run is then read alone."""


def options_of(params: type[Params]) -> dict[str, Option]:
    """The settings that can be given in one word: all but tables."""
    found = {name: _option(info) for name, info in params.model_fields.items()}
    return {name: option for name, option in found.items() if option is not None}


def _option(info: "FieldInfo") -> Option | None:
    kind: Any = info.annotation
    if type(None) in get_args(kind):
        kind = next(a for a in get_args(kind) if a is not type(None))
    table = get_origin(kind) is dict or (isinstance(kind, type) and issubclass(kind, Params))
    if table and not info.metadata:  # what else a table may be given as, in one word
        return None
    if kind not in (int, float, bool, Path) and get_origin(kind) is not Literal:
        kind = str
    shown = ",".join(map(str, info.default)) if isinstance(info.default, tuple) else str(info.default)
    return Option(kind, str(info.description), "" if table or info.default in (None, (), {}) else shown)
