"""A small pipeline of four stages that need nothing: stones are gathered, polished one by one, and piled up.

What a workspace does is the same for these as for the real stages, and takes milliseconds.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import Field as Setting

from piegraph_cli.errors import DataError
from piegraph_cli.params import Params
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.schema import SCHEMAS, Field
from piegraph_cli.workspace.stage import Context, Output, Stage

CALLS: list[tuple[str, Any]] = []
"""Stage and unit of every call of a stage's function, in order."""
SEEN: dict[str, Any] = {}
"""The last context, inputs and settings of each stage."""


class One(Params):
    weight: float = 1.0
    source: Path | None = None


class Stone(One):
    """What one stone depends on: of the source the part that is named like it, if there is one."""

    unit: str

    def content(self) -> dict[str, Any]:
        return {name: value for name, value in super().content().items() if name != "unit"}

    def files(self) -> dict[str, Path]:
        return {"source": self.source / self.unit if self.source.is_dir() else self.source} if self.source else {}


class Gather(One):
    count: int = Setting(3, ge=1)


class Polish(Params):
    shine: float = 2.0
    breaks: str = ""
    """The stone that breaks."""


class Pile(Params):
    steps: int = 3
    stops: int = 0
    """The step at which it falls over; 0: never."""


class Paint(Params):
    colour: str = "red"


def gather(inputs: dict[str, Any], params: One, context: Context) -> Output:
    _note("gather", inputs, params, context)
    weight = params.weight * (int(str(context.unit)[1:]) + 1)
    return Output({"weight": np.full(2, weight)}, f"{weight:g} kg", ["heavy"] if weight > 9 else [])


def polish(inputs: dict[str, Any], params: Polish, context: Context) -> Output:
    _note("polish", inputs, params, context)
    if context.unit == params.breaks:
        raise DataError("the stone broke", str(context.unit), "take another")
    if params.shine < 0:
        raise ValueError("no shine")
    return Output({"shine": inputs["stones"]["weight"] * params.shine}, f"shines {params.shine:g}")


def pile(inputs: dict[str, Any], params: Pile, context: Context) -> Output:
    _note("pile", inputs, params, context)
    saved = context.checkpoint.load()
    done, total = (int(saved["done"]), float(saved["total"])) if saved else (0, 0.0)
    CALLS.append(("pile from", done))
    height = sum(float(inputs["pebbles"][name]["shine"].sum()) for name in inputs["pebbles"])
    for step in range(done + 1, params.steps + 1):
        if step == params.stops:
            raise DataError("the pile fell over")
        total += height
        context.checkpoint.save({"done": np.array(step), "total": np.array(total)})
    return Output({"height": np.array(total)}, f"{len(inputs['pebbles'])} pebbles")


def paint(inputs: dict[str, Any], params: Paint, context: Context) -> Output:
    _note("paint", inputs, params, context)
    return Output({"paint": inputs["heap"]["height"]}, params.colour)


def _note(stage: str, inputs: dict[str, Any], params: Params, context: Context) -> None:
    CALLS.append((stage, context.unit))
    SEEN[stage] = (inputs, params, context)


def _one(run: Run, unit: str) -> Stone:
    return Stone(unit=unit, **run.params("gather").model_dump(exclude={"count"}))


HERE = "tests.workspace.toy"
TABLE: dict[str, Stage] = {
    stage.name: stage
    for stage in (
        Stage(
            "gather",
            "gather stones",
            (),
            "stones",
            Gather,
            version=1,
            run=f"{HERE}:gather",
            unit="stone",
            units=lambda run: [f"s{k}" for k in range(run.params("gather").count)],
            settings=_one,
        ),
        Stage(
            "quarry",
            "gather them elsewhere",
            (),
            "stones",
            Gather,
            version=1,
            run=f"{HERE}:gather",
            units=lambda run: ["s0"],
            settings=_one,
        ),
        Stage(
            "polish", "polish a stone", ("stones",), "pebbles", Polish, version=3, run=f"{HERE}:polish", unit="stone"
        ),
        Stage(
            "pile",
            "pile up pebbles",
            ("pebbles",),
            "heap",
            Pile,
            version=1,
            run=f"{HERE}:pile",
            unit="run",
            units=lambda run: [None],
            inputs=lambda run, unit: {"pebbles": run.made("pebbles")},
            command=lambda run, unit: f"pile it in {run.folder.name}",
        ),
        Stage(
            "paint",
            "paint the pile",
            ("heap",),
            "picture",
            Paint,
            version=1,
            run=f"{HERE}:paint",
            unit="run",
            on_demand=True,
            units=lambda run: [None],
        ),
    )
}
ARTIFACTS = {
    "stones": {"weight": Field("stone", "kg", "float64")},
    "pebbles": {"shine": Field("stone", "1", "float64")},
    "heap": {"height": Field("", "mm", "float64")},
    "picture": {"paint": Field("", "1", "float64")},
}


def prepare(patch: pytest.MonkeyPatch) -> None:
    """Let the workspace know what these artifacts hold, and forget earlier calls."""
    for name, fields in ARTIFACTS.items():
        patch.setitem(SCHEMAS, name, fields)
    CALLS.clear()
    SEEN.clear()


def open_toy(folder: Path, **sections: dict[str, Any]) -> Run:
    """The run in a folder, as it is found there; with settings for some stages, or those it keeps."""
    return Run.open(folder, TABLE, Recipe(TABLE, sections) if sections else None)
