"""What a workspace knows of a stage: one frozen record, whose functions say how its units are named and what they depend on.

The stages themselves are in `stages/`, each in a module of its own; nothing here knows one by name.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from piegraph_cli.params import Params
from piegraph_cli.workspace.call import Call
from piegraph_cli.workspace.progress import Item, Tell, counting, silent

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.workspace.execute import Checkpoint
    from piegraph_cli.workspace.run import Run

Unit = str | None
"""What a stage makes one artifact of, by name: a sequence, a model, a trial; None where it is the run as a whole."""

Inputs = dict[str, Unit | list[str]]
"""What a unit reads, by artifact: of one unit, or of a list of units."""


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline: what it reads and writes, its units and their settings, and where its code is."""

    name: str
    help: str
    reads: tuple[str, ...]
    """Artifacts; a stage that reads none is a source."""
    writes: str
    params: type[Params]
    version: int
    run: str
    """`module:function`, called as `function(inputs, settings of the unit, context) -> Output`."""
    unit: str = "sequence"
    """What a unit is, in a word."""
    optional: tuple[str, ...] = ()
    """Artifacts read as well where the run has them."""
    on_demand: bool = False
    """Whether a recipe has to name it."""
    units: Callable[["Run"], Sequence[Unit]] | None = None
    """The units of a run; by default those of the stage that writes what is read first."""
    settings: Callable[["Run", Any], Params] | None = None
    """The settings that one unit depends on; by default the stage's."""
    inputs: Callable[["Run", Unit], Inputs] | None = None
    """What one unit reads; by default what is read of the unit of the same name."""
    command: Callable[["Run", Unit], str] | None = None
    """The command that makes one unit, for hints; by default a run of the recipe up to this stage."""
    belongs: Callable[["Run", Any], bool] | None = None
    """Whether a unit that a run was asked for before and does not name now is one of its own still: `clean` leaves it."""
    check: Callable[["Run", Sequence[Any], int], list[str]] | None = None
    """Of the units to be made, and how many at a time: what to tell before anything is done. Raises what would fail all."""
    call: Call = field(default_factory=Call)

    def load(self) -> Callable[..., "Output"]:
        """Import the stage's function."""
        return load(self.run)


def load(place: str) -> Any:
    """Import what is named by `module:name`."""
    module, name = place.split(":")
    return getattr(importlib.import_module(module), name)


Table = Mapping[str, Stage]
"""All stages by name, in the order of the pipeline; the first source is that of a recipe that names none."""


@dataclass(frozen=True)
class Output:
    """What a stage returns: arrays by dataset name, one line on their quality, and warnings with the next step."""

    arrays: Mapping[str, "np.ndarray"]
    quality: str
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Context:
    """What a stage may use beside its inputs and settings."""

    run: "Run"
    unit: Unit
    device: str
    checkpoint: "Checkpoint"
    tell: Tell = silent
    """Told how far the work is."""

    def progress(self, items: Iterable[Item], what: str, total: int | None = None) -> Iterator[Item]:
        """The items, `what` they are counted as people see how far the work is."""
        return self.counting(len(items) if total is None else total, what)(items)  # type: ignore[arg-type]

    def counting(self, total: int, what: str) -> Callable[[Iterable[Item]], Iterator[Item]]:
        """The same for several iterables that have `total` items together."""
        return counting(partial(self.tell, self.unit or ""), total, what)
