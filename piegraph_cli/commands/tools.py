"""Commands beside runs: names, cameras, what this machine has, and how fast it is."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from piegraph_cli.commands.names import KINDS
from piegraph_cli.commands.options import AsJson
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.errors import MissingError
from piegraph_cli.text import Column, Line, Table, counted

if TYPE_CHECKING:
    from piegraph_cli.doctor import Check


def list_names(
    kind: Annotated[
        Literal["models", "environments", "recipes", "experiments", "layouts"] | None,
        typer.Argument(metavar="KIND", help="[default: all]"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List models, environments, recipes, experiments and layouts of recordings by name."""
    found = {name: names() for name, names in KINDS.items() if kind in (None, name)}
    width = max(len(name) for names in found.values() for name in names)
    lines: list[Line] = []
    for heading, names in found.items():
        lines += ["", heading] if kind is None else []
        indent = "" if kind else "  "
        lines.append(
            Table([Column("", width + len(indent)), Column()], [(indent + n, t) for n, t in names.items()], gap=2)
        )
    emit(Report(found, lines[1:] if kind is None else lines), as_json)


def unpack(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="folder of ROS bags")],
    out: Annotated[Path, typer.Option(help="folder to write sequences and cameras.json to")],
    as_json: AsJson = False,
) -> None:
    """Write the sequences of ROS bags as image files, for `calibrate`."""
    from tqdm import tqdm

    from piegraph_cli.recording.folders import list_sequences
    from piegraph_cli.recording.unpack import unpack as write_sequence

    written, lines, warnings = [], [], []
    for bag in tqdm(list_sequences(recording, "ros"), desc="unpack", leave=False, disable=None):
        name, count, notes = write_sequence(bag, out)
        written.append({"sequence": name, "images": count, "warnings": notes})
        warnings += [f"{name}: {note}" for note in notes]
        lines += [f"{name}  {counted(count, 'image')} of each camera", *(f"  {note}" for note in notes)]
    emit(Report({"out": str(out), "sequences": written}, lines, warnings=warnings), as_json)


def doctor(
    fetch: Annotated[str | None, typer.Option(help="fetch a weight file by name")] = None, as_json: AsJson = False
) -> None:
    """Check what this machine lacks."""
    from piegraph_cli.doctor import check_machine
    from piegraph_cli.weights import fetch_weights

    if fetch:
        path = fetch_weights(fetch)
        emit(Report({"fetched": str(path)}, [str(path)]), as_json)
        return
    checks = check_machine()
    lines = [*_checked("needed", checks, True, "MISSING"), "", *_checked("optional", checks, False, "missing")]
    lacking = [c for c in checks if not c.ok and c.needed]
    lines += [
        "",
        f"{', '.join(c.name for c in lacking)}: needed, and missing" if lacking else "all that is needed is there",
    ]
    error = MissingError(f"{lacking[0].name} is missing", hint=lacking[0].detail) if lacking else None
    emit(Report({"checks": [asdict(c) for c in checks]}, lines, 4 if lacking else 0, error), as_json)


def _checked(heading: str, checks: "list[Check]", needed: bool, missing: str) -> list[Line]:
    """The checks of what is needed, or of what is optional, under their heading."""
    rows = [("ok" if c.ok else missing, c.name, c.detail) for c in checks if c.needed == needed]
    return [heading, Table([Column("", 8), Column("", 24), Column()], rows)]


def bench(
    subjects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SUBJECT ...",
            help="sms, egnn, plan, track, train, workspace, perception, view [default: all; the last two only with --run]",
        ),
    ] = None,
    run: Annotated[
        Path | None, typer.Option(help="run folder with a recording's results, for perception and view")
    ] = None,
    against: Annotated[
        Path | None, typer.Option(help="checkout of another commit with a .venv, to compare perception with")
    ] = None,
    roofline: Annotated[Path | None, typer.Option(help="picture (.png, .svg) of the kernels' rates")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure speed on this machine.

    Every figure comes after a check of the result, beside the machine's measured peak and the reference in PyTorch.
    """
    from tqdm import tqdm

    from piegraph_cli.bench.measure import table
    from piegraph_cli.bench.run import check_picture, draw_roofline, run_benchmarks

    if roofline is not None:
        check_picture(roofline)
    rows = list(
        tqdm(run_benchmarks(list(subjects or ()), run, against), desc="bench", unit=" rows", leave=False, disable=None)
    )
    if roofline is not None:
        draw_roofline(rows).savefig(roofline, dpi=150)
    emit(Report({"rows": [row.as_dict() for row in rows]}, [table(rows)]), as_json)
