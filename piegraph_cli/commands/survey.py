"""The commands `status` and `clean`: what there is in a run, what to do next, and what could go."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piegraph_cli.commands.options import AsJson, Rehash, RunFolder
from piegraph_cli.commands.output import FEW, Report, emit
from piegraph_cli.commands.stages import require_run
from piegraph_cli.errors import command_line
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.text import Column, Line, Table, counted

if TYPE_CHECKING:
    from piegraph_cli.workspace.run import Run


def status(
    run: RunFolder,
    units: Annotated[
        bool, typer.Option("--units", help="list every unit, not only those that are not fresh", show_default=False)
    ] = False,
    rehash: Rehash = False,
    as_json: AsJson = False,
) -> None:
    """Count a run's artifacts: fresh, stale, missing or failed.

    Beside the counts stands what the artifacts take on disk; units that are not fresh are listed with the reason, and then
    the next command.
    """
    require_run(run)
    opened = open_run(run)
    if rehash:
        opened.known.forget()
    emit(_status(opened, units), as_json)


def _status(run: "Run", every: bool) -> Report:
    """What `status` prints: counts per stage, then units that are not fresh, or `every` one, then what to do next."""
    from piegraph_cli.workspace.survey import STATES, UNCHECKED, count_states
    from piegraph_cli.workspace.survey import status as rows_of

    rows = rows_of(run)
    counts, total = count_states(rows), sum(row["bytes"] for row in rows)
    told = [(of["stage"], *(str(of[state] or "-") for state in STATES), _size(of["bytes"])) for of in counts]
    heads = [*(Column(state, 8, right=True) for state in STATES), Column("on disk", 11, right=True)]
    lines: list[Line] = [Table([Column("stage", 10), *heads], [*told, ("", *("" for _ in STATES), _size(total))])]
    said = [row | {"why": row["quality"] or row["failure"] or row["reason"]} for row in rows]
    if every:
        lines += ["", _units([_unit(row["stage"], row["unit"] or "-", row["state"], row["why"]) for row in said])]
    elif any(row["state"] != "fresh" for row in rows):
        lines += ["", grouped([row for row in said if row["state"] != "fresh"], "why")]
    unchecked = sum(row["reason"] == UNCHECKED for row in rows)
    if unchecked:
        lines += ["", f"{counted(unchecked, 'artifact')} {UNCHECKED}; `piegraph run --force` makes them again"]
    following = _next(run, rows)
    lines += ["", *(f"{'next' if k == 0 else 'or'}: {text}" for k, text in enumerate(following))]
    value = {"run": str(run.folder), "stages": counts, "bytes": total, "artifacts": rows, "next": following}
    return Report(value, lines)


def _next(run: "Run", rows: list[dict[str, Any]]) -> list[str]:
    """What to do next: mend what failed first, make what is missing or stale, or look at what there is."""
    to_make = list(dict.fromkeys(row["stage"] for row in rows if row["state"] in ("missing", "stale")))
    failure = next((row for row in rows if row["state"] == "failed"), None)
    found = []
    if failure is not None:
        hint = failure["failure"].partition("\n  try: ")[2]
        again = _making(run, failure["stage"])
        found.append(f"{hint}, then {again}" if hint and not hint.startswith("piegraph") else hint or again)
    if to_make:
        found.append(_making(run, to_make[0]))
        found += [command_line("run", "--run", run.folder)] if len(to_make) > 1 else []
    return found or [command_line(name, "--run", run.folder) for name in ("report", "view")]


def _making(run: "Run", stage: str) -> str:
    """The command that makes what a stage lacks, with the settings that the run has."""
    call = STAGES[stage].call
    alone = not call.argument and call.folder.option == "run"
    return (
        command_line(stage, "--run", run.folder)
        if alone
        else command_line("run", "--run", run.folder, "--until", stage)
    )


def grouped(rows: list[dict[str, Any]], why: str) -> Table:
    """A row per unit; where many units of a stage share what is said of them, one row."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        groups.setdefault((row["stage"], row["state"], row[why]), []).append(row["unit"] or "-")
    listed = []
    for (stage, state, said), units in groups.items():
        if len(units) > FEW:
            units = [counted(len(units), STAGES[stage].unit)]
        listed += [_unit(stage, unit, state, said) for unit in units]
    return _units(listed)


def _unit(stage: str, unit: str, state: str, said: str) -> tuple[str, str, str, str]:
    return stage, unit, state, " ".join(said.partition("\n")[0].split())


def _units(rows: Sequence[tuple[str, str, str, str]]) -> Table:
    """Units of stages, their states, and what is said of them."""
    state = Column("", 6 if any(row[2] for row in rows) else 0)
    return Table([Column("", 10), Column("", 16), state, Column()], rows)


def _size(count: int) -> str:
    """Bytes for people."""
    power = min((len(str(count)) - 1) // 3, 4)
    return f"{count / 1000**power:.{min(power, 1)}f} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"


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
    from piegraph_cli.workspace.clean import find_waste, remove, remove_locks

    found = find_waste(run)
    files = remove(found) if yes else found
    if yes:
        remove_locks(run)
    rows = [{"file": str(waste.path), "bytes": waste.bytes, "reason": waste.reason} for waste in files]
    total = sum(waste.bytes for waste in files)
    lines = [f"{_size(waste.bytes):>10s}  {waste.path.relative_to(run.folder)}  {waste.reason}" for waste in files]
    end = f"removed {counted(len(files), 'file')}" if yes else f"{counted(len(files), 'file')} could go"
    lines.append(f"{_size(total):>10s}  {end}{'' if yes or not files else '; remove them with --yes'}")
    return Report({"run": str(run.folder), "removed": yes, "bytes": total, "files": rows}, lines)
