"""The stages, a module each, and their table: the command line, recipes and runs are made from it."""

from pathlib import Path
from typing import TYPE_CHECKING

from piegraph_cli.stages import (
    dataset,
    evaluate,
    fuse,
    hands,
    import_tracks,
    ingest,
    plan,
    score,
    segment,
    simulate,
    track,
    train,
    trials,
)
from piegraph_cli.workspace.stage import Stage

if TYPE_CHECKING:
    from piegraph_cli.workspace.recipe import Recipe
    from piegraph_cli.workspace.run import Run

_ORDER = (ingest, simulate, import_tracks, hands, segment, fuse, track, score, dataset, train, evaluate, plan, trials)

STAGES: dict[str, Stage] = {module.STAGE.name: module.STAGE for module in _ORDER}
"""All stages by name, in the order of the pipeline."""


def open_run(folder: Path | str, recipe: "Recipe | None" = None) -> "Run":
    """The run in a folder, with its own recipe or another; an empty run where there is none yet."""
    from piegraph_cli.workspace.run import Run

    return Run.open(Path(folder), STAGES, recipe)


def sequences(run: "Run") -> list[str]:
    """The names of a run's sequences; none in a run of trials alone."""
    tracks = run.producer("tracks")
    return [str(unit) for unit in run.units(tracks)] if tracks else []
