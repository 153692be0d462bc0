"""Commands on whole runs: running a recipe, and looking at what came of it."""

import contextlib
import logging
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piegraph_cli.commands.names import recipes
from piegraph_cli.commands.options import AsJson, Backend, Device, Force, Jobs, Rehash, RunFolder, Settings, running
from piegraph_cli.commands.output import Report, emit, logging_to, summary
from piegraph_cli.commands.stages import require_run
from piegraph_cli.commands.survey import grouped
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.text import Column, Line, Table
from piegraph_cli.workspace.recipe import Recipe, find_recipe, load_recipe, parse_setting

if TYPE_CHECKING:
    from piegraph_cli.workspace.execute import Options, Outcome
    from piegraph_cli.workspace.run import Run


def run(
    recipe: Annotated[
        str | None,
        typer.Argument(
            help=f"a .toml file, or one of {', '.join(recipes())}",
            metavar="RECIPE",
            autocompletion=lambda: list(recipes()),
        ),
    ] = None,
    run: Annotated[Path | None, typer.Option("--run", help="run folder [default: runs/RECIPE]")] = None,
    until: Annotated[str | None, typer.Option(help="last stage to run")] = None,
    set: Settings = None,
    dry: Annotated[
        bool,
        typer.Option("--dry", help="only say what would be made and why, and write nothing", show_default=False),
    ] = False,
    rehash: Rehash = False,
    force: Force = False,
    jobs: Jobs = 1,
    backend: Backend = "local",
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Run a recipe's stages that are not fresh."""
    if recipe is None and (run is None or not (run / "recipe.toml").exists()):
        raise UsageError("no recipe given", hint="piegraph run RECIPE, or --run with a folder that has a recipe.toml")
    folder = run or Path("runs") / Path(str(recipe)).stem
    opened, named = _opened(folder, recipe, set or [], until)
    if rehash:
        opened.known.forget()
    if dry:
        emit(_foreseen(opened, until, force), as_json)
        return
    how = running((), force, jobs, backend, device)
    with logging_to(folder):
        outcomes = _run(opened, named, until, how)
    emit(summary(outcomes, folder), as_json)


def _opened(folder: Path, recipe: str | None, changes: list[str], until: str | None) -> "tuple[Run, Recipe]":
    """The run with the recipe to follow, changed as asked; and that recipe without the changes."""
    run = open_run(folder)
    if recipe is not None:
        run.recipe = load_recipe(find_recipe(recipe), STAGES)
    named = run.recipe
    for text in changes:
        stage, setting, value = parse_setting(text, STAGES)
        run.recipe = run.recipe.with_values(stage, {setting: value}, f"--set {text}", Path.cwd())
    names = [stage.name for stage in run.recipe.chain()]
    if until is not None and until not in names:
        raise UsageError(f"this recipe has no stage {until}", hint=f"one of {', '.join(names)}")
    unused = [name for name in run.recipe.sections if not STAGES[name].reads and name not in names]
    if unused:
        used = ", ".join(f"[{stage.name}]" for stage in run.chain if not stage.reads)
        logging.getLogger("piegraph").warning(
            "[%s] of the recipe makes nothing beside %s: use two runs", unused[0], used
        )
    for source in run.chain:  # a recording that is not there is said before a folder is made
        _ = source.reads or run.units(source)
    return run, named


def _run(run: "Run", named: Recipe, until: str | None, options: "Options") -> "list[Outcome]":
    """Run the chain. The recipe is kept from the beginning, so that a killed run goes on with it.

    Where it is refused, the run has the recipe again that it had before, or `named` where it had none.
    """
    from piegraph_cli.workspace.execute import run_chain
    from piegraph_cli.workspace.together import tell_changes, tell_recipe

    path = run.folder / "recipe.toml"
    before = path.read_bytes() if path.exists() else None

    def take_back() -> None:
        if before is None:
            named.save(path)
        else:
            with atomic_file(path) as temporary:
                temporary.write_bytes(before)

    run.save_recipe()
    try:
        outcomes = run_chain(run, until, options)
    except UsageError:
        take_back()
        raise
    tell_changes(run, outcomes)
    tell_recipe(run.folder, run.recipe)
    if any(isinstance(o.error, UsageError) for o in outcomes):
        take_back()
    return outcomes


def _foreseen(run: "Run", until: str | None, force: bool) -> Report:
    """What `run --dry` prints: what would be made and why, equal reasons together."""
    from piegraph_cli.workspace.survey import foresee

    rows = foresee(run, until, force)
    told: list[Line] = ["all is fresh"]
    if rows:
        told = ["would make:", grouped([row | {"state": ""} for row in rows], "reason")]
    return Report({"run": str(run.folder), "would_make": rows}, told)


def report(
    run: RunFolder,
    out: Annotated[
        Path | None, typer.Option(help="folder to write it into, and nothing into the run [default: RUN/report]")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a run's report into RUN/report/index.html.

    One file for any browser, with verdicts, tables, pictures of all sequences, plots, and how to make it again.
    """
    require_run(run)
    if out is None and not os.access(run, os.W_OK):
        raise DataError("cannot be written, and the report goes into it", str(run), "--out FOLDER")
    if out is not None and out.exists() and not out.is_dir():
        raise UsageError("is a file", str(out), "give --out a folder")
    with logging_to(run) if out is None else contextlib.nullcontext():
        emit(_reported(run, out), as_json)


def _reported(run: Path, out: Path | None) -> Report:
    """What `report` prints: a word on each part of the run, and where the page is."""
    from tqdm import tqdm

    from piegraph_cli.report.page import write_report

    written = write_report(run, lambda names: tqdm(names, desc="report", leave=False, disable=None, delay=1), out)
    rows = [
        (of.part, of.word, of.figure + (f": {of.command}" if of.word == "not yet" else "")) for of in written.verdicts
    ]
    lines: list[Line] = [Table([Column("", 10), Column("", 8), Column()], rows), str(written.path)]
    value = {"report": str(written.path), "verdicts": [asdict(of) for of in written.verdicts]}
    return Report(value | {"left_out": [asdict(gap) for gap in written.left_out]}, lines)


def view(
    run: Annotated[list[Path], typer.Option("--run", help="run folder; give several to switch between them")],
    sequence: Annotated[str | None, typer.Option(help="sequence to show [default: the first]")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port on this machine; 0: a free one")] = 0,
) -> None:
    """Show runs in the browser: images, hand, cloud, particles, predictions and plans.

    Serves on 127.0.0.1 only, until interrupted.
    """
    from piegraph_cli.viewer.view import view as serve

    for folder in run:
        require_run(folder)
    serve(run, sequence, port)
