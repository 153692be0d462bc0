"""Doing what an experiment's runs lack, piece by piece, and writing its tables and pictures."""

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.errors import DataError, PiegraphError
from piegraph_cli.evaluation.tables import as_json
from piegraph_cli.experiments.collect import collect, model_pieces, shown_trials, trial_pieces
from piegraph_cli.experiments.figures import draw
from piegraph_cli.experiments.measured import with_outline, write_strokes
from piegraph_cli.experiments.params import MEASURED, ExperimentParams
from piegraph_cli.experiments.pieces import keep_pieces, read_pieces
from piegraph_cli.experiments.recipes import recipe_of, recording_of, trial_recipe
from piegraph_cli.experiments.results import put_together
from piegraph_cli.experiments.tables import describe
from piegraph_cli.files import atomic_file
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.simulate import record_sequences
from piegraph_cli.stages.train import trained_name
from piegraph_cli.stages.trials import split_name
from piegraph_cli.text import counted
from piegraph_cli.workspace.execute import Options, Outcome, run_chain, run_stage
from piegraph_cli.workspace.recipe import SHIPPED, load_recipe
from piegraph_cli.workspace.run import Run

log = logging.getLogger("piegraph")


@dataclass
class Work:
    """How an experiment is done: in which folder, where its pieces are kept, and for how long."""

    folder: Path
    options: Options
    keep: Path
    command: str = ""
    until: float = float("inf")
    """No piece is begun after this [s, as `time.monotonic` counts]."""
    failed: list[PiegraphError] = field(default_factory=list)
    left: int = 0
    """Pieces that were not begun."""

    def note(self, outcomes: Sequence[Outcome]) -> None:
        """Take up what failed."""
        self.failed += [o.error for o in outcomes if o.error]

    def do(self, run: Run, stage: str, units: Sequence[str]) -> None:
        """Run a stage on some units, and say how long that took if there was something to do."""
        begin = time.monotonic()
        outcomes = run_stage(run, STAGES[stage], replace(self.options, only=tuple(units)))
        self.note(outcomes)
        if any(o.state == "done" for o in outcomes):
            what = ", ".join(units) if stage == "train" else f"{units[0]} and {len(units) - 1} more"
            log.info("%-9s %6.2f h  %s", stage, (time.monotonic() - begin) / 3600, what)

    def in_time(self, pieces: int) -> bool:
        """Whether so many pieces may be begun; else they are left."""
        if time.monotonic() < self.until:
            return True
        self.left += pieces
        return False


def run_experiment(name: str, params: ExperimentParams, work: Work) -> list[PiegraphError]:
    """Do what the experiment's runs lack, and keep a piece of each model and seed, then of each model's trials.

    Returns what failed.
    """
    for environment in params.interactions:
        _run_models(name, params, environment, work)
    for environment in params.interactions if params.trials else ():
        _run_trials(name, params, environment, work)
    if work.left:
        log.warning("the time is up: %s left; the same command goes on", counted(work.left, "piece"))
    return work.failed


def _run_models(name: str, params: ExperimentParams, environment: str, work: Work) -> None:
    folder, recording = work.folder, recording_of(params, environment, work.folder)
    if environment == MEASURED:
        write_strokes(params.data, _measured_in(folder))
        params = with_outline(params, _measured_in(folder))
    run = open_run(folder / params.run_name(environment), recipe_of(params, environment, recording))
    if not work.in_time(len(run.units(STAGES["train" if params.table == "search" else "evaluate"]))):
        return
    if recording and environment != MEASURED:
        _render(recording, params, environment, work.options.jobs)
    log.info("%s: %s", name, run.folder)
    begin = run_chain(run, "dataset", work.options)
    work.note(begin)
    if any(o.error for o in begin if o.stage == "dataset"):
        return
    for trained, measured in _batches(run, params, work.options.jobs):
        if not work.in_time(len(measured or trained)):
            continue
        for stage, units in (("train", trained), ("evaluate", measured)):
            if units:
                work.do(run, stage, units)
        work.failed += keep_pieces(
            model_pieces(params, environment, folder, work.command, measured or trained), work.keep
        )
    run.save_recipe()


def _batches(run: Run, params: ExperimentParams, jobs: int) -> Iterator[tuple[list[str], list[str]]]:
    """Models to train and those to evaluate, as many at a time as there are jobs; what is not trained comes first."""
    measured = [] if params.table == "search" else [str(unit) for unit in run.units(STAGES["evaluate"])]
    trained = [str(unit) for unit in run.units(STAGES["train"])]
    if untrained := [unit for unit in measured if trained_name(unit) is None]:
        yield [], untrained
    for first in range(0, len(trained), jobs):
        some = trained[first : first + jobs]
        yield some, [unit for unit in measured if trained_name(unit) in some]


def _run_trials(name: str, params: ExperimentParams, environment: str, work: Work) -> None:
    grid = open_run(work.folder / name / environment, trial_recipe(params, environment, work.folder))
    log.info("%s: %s", name, grid.folder)
    for label in dict.fromkeys(params.trial_labels(environment)):
        if not work.in_time(1):
            continue
        work.do(grid, "trials", [str(u) for u in grid.units(STAGES["trials"]) if split_name(str(u))[1] == label])
        work.failed += keep_pieces(trial_pieces(name, params, environment, work.folder, work.command), work.keep)
    grid.save_recipe()


def _measured_in(folder: Path) -> Path:
    return folder / "recordings" / MEASURED


def _render(recording: Path, params: ExperimentParams, environment: str, jobs: int) -> None:
    shipped = load_recipe(SHIPPED / f"{environment}.toml", STAGES).params(STAGES["simulate"])
    assert isinstance(shipped, SimulateParams)
    count = params.training + params.validation + params.test
    settings = shipped.model_copy(update={"sequences": count, "strokes": params.strokes})
    record_sequences(recording, settings, jobs=jobs, force=False)


def write_report(name: str, params: ExperimentParams, work: Work) -> tuple[dict[str, Any], list[str], list[Path]]:
    """The experiment's tables as an object and as lines, and its pictures; all are kept in the folder's `report`.

    What is fresh is kept as pieces first. Raises `DataError` when nothing has been done yet.
    """
    folder = work.folder
    params = with_outline(params, _measured_in(folder)) if MEASURED in params.interactions else params
    pieces = collect(name, params, folder, work.command)
    if not pieces:
        raise DataError("no run of this experiment has results yet", str(folder), f"piegraph reproduce {name}")
    told = {str(error) for error in work.failed}
    work.failed += [error for error in keep_pieces(pieces, work.keep) if str(error) not in told]
    results = put_together(name, params, pieces, shown_trials(name, params, folder))
    kept = read_pieces(work.keep) if work.keep.is_dir() else []
    value, lines = describe(params, results, kept)
    out = folder / "report"
    for suffix, text in (("txt", "\n".join(lines)), ("json", as_json(value))):
        with atomic_file(out / f"{name}.{suffix}") as temporary:
            temporary.write_text(text + "\n")
    pictures = []
    for kind, figure in draw(params, results):
        path = out / f"{name}_{kind}.png"
        with atomic_file(path) as temporary:
            figure.savefig(temporary, dpi=110, format="png")
        pictures.append(path)
    return value, lines, pictures
