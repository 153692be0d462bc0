"""The command that makes the paper's tables and figures."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piegraph_cli.commands import names
from piegraph_cli.commands.answer import error_object
from piegraph_cli.commands.options import AsJson, Backend, Device, Jobs, running
from piegraph_cli.commands.output import Report, emit, logging_to
from piegraph_cli.errors import DataError, UsageError, command_line

if TYPE_CHECKING:
    from piegraph_cli.experiments.params import ExperimentParams
    from piegraph_cli.experiments.run import Work


Runs = Annotated[
    Path | None, typer.Option(help="folder of the experiments' runs [default: runs/paper, or runs/quick with --quick]")
]


Quick = Annotated[bool, typer.Option("--quick", help="minutes, not hours: fewer sequences, seeds, steps")]
Changes = Annotated[
    list[str] | None, typer.Option("--set", help="SETTING=VALUE in place of the experiment's, as trials.seeds=3")
]
Strokes = Annotated[
    Path | None, typer.Option(help="for `pushes`: .npz of strokes that others measured (docs/experiments.md)")
]
Hours = Annotated[
    float | None, typer.Option(min=0.0, help="begin no further piece after so many; the same command goes on")
]
Keep = Annotated[
    Path | None,
    typer.Option(help="folder of pieces, the small text files of figures [default: RUNS/report/pieces]"),
]


def reproduce(
    experiment: Annotated[
        str,
        typer.Argument(
            help=f"{', '.join(names.all_experiments())}, or all of the paper's (docs/experiments.md)",
            metavar="EXPERIMENT",
            autocompletion=lambda: [*names.all_experiments(), "all"],
        ),
    ],
    runs: Runs = None,
    quick: Quick = False,
    set: Changes = None,
    data: Strokes = None,
    envs: Annotated[str, typer.Option(help="environments to do, as tblock,toy [default: all it has]")] = "",
    show: Annotated[bool, typer.Option("--show", help="only print what is done")] = False,
    hours: Hours = None,
    keep: Keep = None,
    jobs: Jobs = 1,
    backend: Backend = "local",
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Run an experiment of the paper, and print its table.

    Whatever is fresh is not done again. Table, numbers and pictures are kept in RUNS/report, and a piece of each part.
    """
    from piegraph_cli.experiments.run import Work

    folder = runs or Path("runs") / ("quick" if quick else "paper")
    if experiment == "troubles":
        place = folder / "troubles"
        return emit(_told_before(place) if show else _troubles(place, quick, set or (), envs, jobs), as_json)
    chosen, reports = _chosen(experiment, quick, set or (), envs, data), {}
    until = float("inf") if hours is None else time.monotonic() + 3600 * hours
    options, place = running((), False, jobs, backend, device), keep or folder / "report" / "pieces"
    for name, params in chosen.items():
        command = command_line("reproduce", name, *(["--quick"] if quick else []), *_each("--set", set or ()))
        reports[name] = _reproduce(name, params, Work(folder, options, place, command, until), show)
    emit(_together(reports), as_json)


def _each(option: str, values: Sequence[str]) -> list[str]:
    return [part for value in values for part in (option, value)]


def _together(reports: dict[str, Report]) -> Report:
    """The reports of experiments, one after the other."""
    lines = [line for report in reports.values() for line in ("", *report.lines)]
    value = {name: report.value for name, report in reports.items()}
    error = next((report.error for report in reports.values() if report.error), None)
    return Report(value, lines[1:], error.exit_code if error else 0, error)


def _told_before(folder: Path) -> Report:
    """The table of troubles as it was made last."""
    text, numbers = (folder / "report" / f"troubles.{suffix}" for suffix in ("txt", "json"))
    if not (text.is_file() and numbers.is_file()):
        raise DataError("no results yet", str(folder), "piegraph reproduce troubles")
    return Report({"troubles": json.loads(numbers.read_text())}, text.read_text().splitlines())


def _troubles(folder: Path, quick: bool, changes: "Sequence[str]", envs: str, jobs: int) -> Report:
    """Recordings that are wrong on purpose, and what is said of them."""
    from piegraph_cli.experiments.params import QUICK_TROUBLES, TroublesParams
    from piegraph_cli.experiments.recipes import with_changes
    from piegraph_cli.experiments.troubles import run_troubles, write_troubles
    from piegraph_cli.params import validated

    values = with_changes(dict(QUICK_TROUBLES) if quick else {}, changes)
    values |= {"environments": envs, "good": envs} if envs else {}
    params = validated(TroublesParams, values, "troubles", "", "correct the experiment")
    with logging_to(folder):
        value, lines = write_troubles(run_troubles(params, folder, jobs), folder)
    return Report({"troubles": value}, lines)


def _chosen(
    experiment: str, quick: bool, changes: Sequence[str], envs: str, data: Path | None
) -> "dict[str, ExperimentParams]":
    """The settings of the experiments that are meant; all of them without data are those that need none."""
    from piegraph_cli.experiments.recipes import load_experiment

    wanted = [experiment] if experiment != "all" else [name for name in names.experiments() if data or name != "pushes"]
    if data and "pushes" not in wanted:
        raise UsageError(f"--data is for pushes, not for {experiment}", "piegraph reproduce", "leave --data out")
    of = [env.strip() for env in envs.split(",") if env.strip()]
    given = {"data": data} if data else {}
    return {name: load_experiment(name, quick, changes, of).model_copy(update=given) for name in wanted}


def _reproduce(name: str, params: "ExperimentParams", work: "Work", show: bool) -> Report:
    """Do what an experiment's runs lack, unless they are only shown, and read its table."""
    from piegraph_cli.experiments.run import run_experiment, write_report

    with logging_to(work.folder):
        if not show:
            run_experiment(name, params, work)
        value, text, pictures = write_report(name, params, work)
    failed = work.failed
    value |= {"pictures": [str(p) for p in pictures], "failed": [error_object(e) for e in failed], "left": work.left}
    error = failed[0] if failed else None
    return Report(value, [*text, "", *map(str, pictures)], error.exit_code if error else 0, error)
