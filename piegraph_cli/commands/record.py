"""The command `record`: cameras that are plugged in, their live picture, and takes that become sequences."""

import logging
import queue
import re
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piegraph_cli.commands.options import AsJson
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.errors import UsageError, command_line
from piegraph_cli.text import counted

if TYPE_CHECKING:
    from piegraph_cli.capture.cameras import Mode
    from piegraph_cli.capture.session import Session
    from piegraph_cli.capture.station import Station
    from piegraph_cli.recording.camera import Camera
    from piegraph_cli.recording.layout import CamerasFile

log = logging.getLogger("piegraph")

BOARD_SECONDS = 2.0


def record(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="recording folder, new or one to add to")],
    cameras: Annotated[
        str | None,
        typer.Option(help="how many, or serial numbers with or without names: front=1234,left=5678 [default: all]"),
    ] = None,
    board: Annotated[
        bool, typer.Option("--board", help="record the sequence that shows the board", show_default=False)
    ] = False,
    takes: Annotated[int | None, typer.Option(min=1, help="takes to make by itself; needs --seconds")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.2, help="length of a take [s] [default: until Enter]")] = None,
    countdown: Annotated[int, typer.Option(min=0, help="seconds before a take")] = 3,
    size: Annotated[str, typer.Option(help="size of colour [px]")] = "640x480",
    fps: Annotated[int, typer.Option(min=1, max=300, help="frames a second")] = 30,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port of the live picture on this machine")] = 8090,
    as_json: AsJson = False,
) -> None:
    """Record takes from the cameras that are plugged in.

    Enter begins a take and ends it, d drops it, q or Ctrl-C ends. Colour, depth registered to it and times of one clock
    become sequences of the recording; its cameras.json gets the cameras' intrinsics and keeps their poses.
    """
    mode = _mode(size, fps)
    if board:
        takes, seconds = 1, seconds or BOARD_SECONDS
    if (takes is not None and seconds is None) or (takes is None and not sys.stdin.isatty()):
        hint = "give --takes N --seconds S, or use a terminal"
        raise UsageError("nobody says when a take ends", "piegraph record", hint)
    session = _session(recording, cameras, mode, seconds, port, (takes, countdown, board))
    emit(_report(recording, session, board), as_json)
    if session.failure is not None:
        raise session.failure


def _mode(size: str, fps: int) -> "Mode":
    from piegraph_cli.capture.cameras import Mode

    told = re.fullmatch(r"(\d{2,5})x(\d{2,5})", size)
    if told is None:
        raise UsageError(f"cannot read --size {size}", "piegraph record", "as in --size 640x480")
    return Mode(int(told[1]), int(told[2]), fps)


def _session(
    recording: Path,
    wanted: str | None,
    mode: "Mode",
    seconds: float | None,
    port: int,
    plan: tuple[int | None, int, bool],
) -> "Session":
    """Open the cameras, check what must be checked before a take, and make takes under the live picture."""
    from piegraph_cli.capture.cameras import choose, connected
    from piegraph_cli.capture.folder import known_cameras, names_of
    from piegraph_cli.capture.preview import Preview
    from piegraph_cli.capture.session import Session
    from piegraph_cli.capture.station import Station

    known = known_cameras(recording)
    if plan[2] and (recording / "board").exists():
        place = str(recording / "board")
        raise UsageError("is there already", place, "remove it, and calibrate again after this")
    with Station(choose(connected(), wanted, names_of(known)), mode) as station:
        models = _prepared(station, recording, known, seconds)
        session = Session(station, recording, models, _typed_lines(plan[0] is None), _say)
        with Preview(station.latest, list(station.cameras), lambda: session.state, port) as preview:
            _say(f"live picture: {preview.url}")
            session.run(plan[0], seconds, *plan[1:])
    return session


def _prepared(
    station: "Station", recording: Path, known: "CamerasFile | None", seconds: float | None
) -> "dict[str, Camera]":
    """Write cameras.json, see that disk and processor keep up, and say what should be known; the cameras by name."""
    from piegraph_cli.capture.disk import check, measure
    from piegraph_cli.capture.folder import unfinished, update_cameras

    notes = update_cameras(recording, known, station.models)
    models = {name: replace(model, name=name) for name, model in station.models.items()}
    shots = dict(zip(station.cameras, station.shots(), strict=True))
    load = measure(recording, shots, models, station.mode.fps)
    notes += [*station.notes, *check(load, recording, seconds)]
    notes += [f"{name} is what a take left that was killed: remove it" for name in unfinished(recording)]
    for note in notes:
        log.warning("note: %s", note)
    _say(f"{counted(len(models), 'camera')}, {load.needed:.0f} MB a second, space for {load.seconds / 60:.0f} minutes")
    return models


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _typed_lines(wanted: bool) -> "queue.Queue[str]":
    """What is typed from now on, line by line."""
    lines: queue.Queue[str] = queue.Queue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        lines.put("q")

    if wanted:
        threading.Thread(target=read, daemon=True).start()
    return lines


def _report(recording: Path, session: "Session", board: bool) -> Report:
    from piegraph_cli.recording.layout import read_cameras_file

    file = read_cameras_file(recording / "cameras.json")
    unposed = [name for name, entry in file.cameras.items() if entry.T_world_camera is None]
    following = ""
    if board:
        following = command_line("calibrate", recording, "--sequence", "board")
    elif unposed:
        following = f"{command_line('record', recording, '--board')}, then "
        following += command_line("calibrate", recording, "--sequence", "board")
    kept = [taken for taken in session.taken if taken.kept]
    lines = [
        f"{taken.sequence}: {taken.seconds:.1f} s, {counted(sum(taken.frames.values()), 'image')}" for taken in kept
    ]
    lines += [f"{counted(len(kept), 'take')} in {recording}"] + ([f"next: {following}"] if following else [])
    rows: list[dict[str, Any]] = [
        {"sequence": t.sequence, "frames": t.frames, "dropped": t.dropped, "seconds": t.seconds, "kept": t.kept}
        for t in session.taken
    ]
    value = {"recording": str(recording), "takes": rows, "cameras": list(file.cameras), "uncalibrated": unposed}
    return Report(value | {"next": following or None}, lines)
