"""Commands on whole runs: running a recipe, and looking at what there is."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piegraph_cli.commands.names import recipes
from piegraph_cli.commands.options import AsJson, Backend, Device, Force, Jobs, Rehash, RunFolder, Settings
from piegraph_cli.commands.output import FEW, Report, emit, logging_to, summary
from piegraph_cli.commands.stages import require_run
from piegraph_cli.errors import UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.stages import STAGES, open_run
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
    from piegraph_cli.workspace.execute import Options

    if recipe is None and (run is None or not (run / "recipe.toml").exists()):
        raise UsageError("no recipe given", hint="piegraph run RECIPE, or --run with a folder that has a recipe.toml")
    folder = run or Path("runs") / Path(str(recipe)).stem
    opened, named = _opened(folder, recipe, set or [], until)
    if rehash:
        opened.known.forget()
    if dry:
        emit(_foreseen(opened, until, force), as_json)
        return
    with logging_to(folder):
        outcomes = _run(opened, named, until, Options((), force, jobs, backend, device))
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
    for source in run.chain:  # a recording that is not there is said before a folder is made
        _ = source.reads or run.units(source)
    return run, named


def _run(run: "Run", named: Recipe, until: str | None, options: "Options") -> "list[Outcome]":
    """Run the chain. The recipe is kept from the beginning, so that a killed run goes on with it.

    Where it is refused, the run has the recipe again that it had before, or `named` where it had none.
    """
    from piegraph_cli.workspace.execute import run_chain

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
    if any(isinstance(o.error, UsageError) for o in outcomes):
        take_back()
    return outcomes


def _foreseen(run: "Run", until: str | None, force: bool) -> Report:
    """What `run --dry` prints: what would be made and why, equal reasons together."""
    from piegraph_cli.workspace.survey import foresee

    rows = foresee(run, until, force)
    lines = _grouped(rows, "reason", every=False)
    return Report({"run": str(run.folder), "would_make": rows}, ["would make:", *lines] if rows else ["all is fresh"])


def _grouped(rows: list[dict[str, Any]], why: str, every: bool) -> list[str]:
    """A line per unit; where many units of a stage share what is said of them, and not `every` one is asked for, one line."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        said = " ".join(str(row[why]).split("\n")[0].split())
        groups.setdefault((row["stage"], row.get("state", ""), said), []).append(row["unit"] or "-")
    lines = []
    for (stage, state, said), units in groups.items():
        if len(units) > FEW and not every:
            units = [f"{len(units)} {STAGES[stage].unit}s"]
        lines += [f"{stage:10s} {unit:16s} {state + ' ' if state else ''}{said}".rstrip() for unit in units]
    return lines


def _size(count: int) -> str:
    """Bytes for people."""
    power = min((len(str(count)) - 1) // 3, 4)
    return f"{count / 1000**power:.{min(power, 1)}f} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"


def status(
    run: RunFolder,
    units: Annotated[
        bool, typer.Option("--units", help="list every unit, not only those that are not fresh", show_default=False)
    ] = False,
    rehash: Rehash = False,
    as_json: AsJson = False,
) -> None:
    """Count a run's artifacts: fresh, stale, missing or failed.

    Beside the counts stands what the artifacts take on disk; units that are not fresh are listed with the reason.
    """
    require_run(run)
    opened = open_run(run)
    if rehash:
        opened.known.forget()
    emit(_status(opened, units), as_json)


def _status(run: "Run", every: bool) -> Report:
    """What `status` prints: counts per stage, then units that are not fresh, or `every` one."""
    from piegraph_cli.workspace.survey import STATES, UNCHECKED, count_states
    from piegraph_cli.workspace.survey import status as rows_of

    rows = rows_of(run)
    counts, total = count_states(rows), sum(row["bytes"] for row in rows)
    lines = [f"{'stage':10s}" + "".join(f"{state:>9s}" for state in STATES) + f"{'on disk':>12s}"]
    for of in counts:
        numbers = "".join(f"{of[state] or '-':>9}" for state in STATES)
        lines.append(f"{of['stage']:10s}{numbers}{_size(of['bytes']):>12s}")
    lines.append(f"{'':10s}{'':36s}{_size(total):>12s}")
    said = [row | {"why": row["quality"] or row["failure"] or row["reason"]} for row in rows]
    listed = _grouped([row for row in said if every or row["state"] != "fresh"], "why", every)
    unchecked = sum(row["reason"] == UNCHECKED for row in rows)
    if unchecked:
        listed.append(f"{unchecked} artifacts are {UNCHECKED}; `piegraph run --force` makes them again")
    value = {"run": str(run.folder), "stages": counts, "bytes": total, "artifacts": rows}
    return Report(value, [*lines, "", *listed] if listed else lines)


def clean(
    run: RunFolder,
    yes: Annotated[
        bool, typer.Option("--yes", help="remove it; without, only say what would be removed", show_default=False)
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Remove what a run does not use any more.

    Stale artifacts, those of sequences, models or trials that the recipe no longer has, and what killed processes left.
    """
    require_run(run)
    emit(_cleaned(open_run(run), yes), as_json)


def _cleaned(run: "Run", yes: bool) -> Report:
    """What `clean` prints: files that could go or have gone, with their sizes."""
    from piegraph_cli.workspace.clean import find_waste, remove

    found = find_waste(run)
    files = remove(found) if yes else found
    rows = [{"file": str(waste.path), "bytes": waste.bytes, "reason": waste.reason} for waste in files]
    total = sum(waste.bytes for waste in files)
    lines = [f"{_size(waste.bytes):>10s}  {waste.path.relative_to(run.folder)}  {waste.reason}" for waste in files]
    end = f"removed {len(files)} files" if yes else f"{len(files)} files could go"
    lines.append(f"{_size(total):>10s}  {end}{'' if yes or not files else '; remove them with --yes'}")
    return Report({"run": str(run.folder), "removed": yes, "bytes": total, "files": rows}, lines)


def report(run: RunFolder, as_json: AsJson = False) -> None:
    """Draw a run's pictures into RUN/report."""
    from piegraph_cli.report.draw import draw_report

    require_run(run)
    with logging_to(run):
        files = draw_report(run)
    emit(Report({"pictures": [str(f) for f in files]}, [str(f) for f in files]), as_json)


def view(
    run: RunFolder,
    sequence: Annotated[str | None, typer.Option(help="sequence to show [default: the first]")] = None,
    port: Annotated[int, typer.Option(min=1024, max=65535, help="port on this machine")] = 8080,
) -> None:
    """Show clouds and tracks in the browser.

    Serves on 127.0.0.1 only, until interrupted.
    """
    from piegraph_cli.viewer.serve import serve

    serve(run, sequence, port)
