"""Commands beside runs: names, cameras, what this machine has, and how fast it is."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from piegraph_cli.commands.names import KINDS
from piegraph_cli.commands.options import AsJson
from piegraph_cli.commands.output import Report, emit


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
    lines = []
    for heading, names in found.items():
        lines += ["", heading] if kind is None else []
        lines += [f"{'' if kind else '  '}{name:{width}s}  {text}" for name, text in names.items()]
    emit(Report(found, lines[1:] if kind is None else lines), as_json)


def calibrate(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="recording folder whose cameras.json has K and distortion")
    ],
    sequence: Annotated[str | None, typer.Option(help="sequence that shows the board [default: the first]")] = None,
    columns: Annotated[int, typer.Option(help="squares across the board")] = 7,
    rows: Annotated[int, typer.Option(help="squares down the board")] = 5,
    square: Annotated[float, typer.Option(help="edge of a square [m]")] = 0.04,
    marker: Annotated[float, typer.Option(help="edge of a marker [m]")] = 0.03,
    dictionary: Annotated[str, typer.Option(help="OpenCV's name of the marker dictionary")] = "DICT_5X5_100",
    as_json: AsJson = False,
) -> None:
    """Locate the cameras by a ChArUco board.

    The board lies on the table; its middle becomes the origin of the world, z up. Fills T_world_camera in cameras.json,
    and notes there which sequence shows the board: runs leave it out.
    """
    from piegraph_cli.recording.calibration import Board
    from piegraph_cli.recording.locate import calibrate as locate

    found = locate(recording, sequence, Board(columns, rows, square, marker, dictionary))
    lines = [
        f"{one.name:12s} {one.error:5.2f} px{''.join(f'  {text}' for text in one.warnings)}" for one in found.cameras
    ]
    lines += ["the board has the layout from before OpenCV 4.6"] if found.board.legacy else []
    lines += [f"sequence {found.sequence} shows the board: runs leave it out"]
    cameras = {
        one.name: {"error_px": one.error, "frames_px": one.frames, "warnings": one.warnings} for one in found.cameras
    }
    emit(Report({"cameras": cameras, "sequence": found.sequence, "legacy_board": found.board.legacy}, lines), as_json)


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
    lines = [f"{'ok' if c.ok else 'MISSING':8s} {c.name:24s} {c.detail}" for c in checks]
    needed = [c for c in checks if not c.ok and c.needed]
    emit(Report({"checks": [asdict(c) for c in checks]}, lines, 4 if needed else 0), as_json)


def bench(
    subjects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SUBJECT ...",
            help="sms, egnn, plan, track, train, workspace, perception [default: all; perception only with --run]",
        ),
    ] = None,
    run: Annotated[Path | None, typer.Option(help="run folder with a recording's results, for perception")] = None,
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
    emit(Report({"rows": [row.as_dict() for row in rows]}, table(rows)), as_json)
