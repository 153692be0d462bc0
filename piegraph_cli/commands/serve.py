"""The command `serve`: a model kept warm that answers over HTTP, or over JSON lines on stdin and stdout."""

import contextlib
import ipaddress
import os
import secrets
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from piegraph_cli.commands.options import AsJson, Device
from piegraph_cli.errors import DataError, UsageError

if TYPE_CHECKING:
    from piegraph_cli.service.service import Service

TOKEN = "PIEGRAPH_TOKEN"
"""Variable that holds the token."""
TOLD_TO_END = 143


def serve(
    run: Annotated[Path | None, typer.Option("--run", help="run folder of a trained model")] = None,
    model: Annotated[
        str | None,
        typer.Option(help="model of the run, by label [default: piegraph]; without --run a model's file", show_default=False),
    ] = None,
    stdio: Annotated[
        bool, typer.Option("--stdio", help="JSON lines on stdin and stdout in place of HTTP", show_default=False)
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port of HTTP; 0 takes a free one")] = 8765,
    host: Annotated[str, typer.Option(help="address to listen on; beyond this machine a token is needed")] = "127.0.0.1",
    token_file: Annotated[
        Path | None,
        typer.Option(help=f"file whose first line is the token [default: ${TOKEN}, or a new one]", show_default=False),
    ] = None,
    recording: Annotated[
        Path | None, typer.Option(help="recording whose images are looked at, and whose cameras.json has the robot's place")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="look through the cameras of --recording that are plugged in", show_default=False)
    ] = False,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Keep a model warm, and answer: plan, predict, look, info (docs/robot.md).

    It ends with Ctrl-C, when it is told to, or with --stdio when stdin ends.
    """
    _check(run, model, stdio, recording, live)
    signal.signal(signal.SIGTERM, _end)
    if stdio:
        from piegraph_cli.service.stdio import serve_lines

        with _service(run, model, recording, live, device) as service:
            print(f"{_what(service)} answers JSON lines on stdin", file=sys.stderr, flush=True)
            serve_lines(service)
        return
    from piegraph_cli.service.http import Gate, listen, make_server

    gate = Gate(host, _token(host, token_file))
    with listen(host, port) as socket, _service(run, model, recording, live, device) as service:
        _tell(service, f"http://{_named(host)}:{socket.getsockname()[1]}", as_json)
        make_server(service, gate).run([socket])


def _end(*_: object) -> NoReturn:
    raise SystemExit(TOLD_TO_END)


def _check(run: Path | None, model: str | None, stdio: bool, recording: Path | None, live: bool) -> None:
    if run is None and model is None:
        raise UsageError("nothing to serve", "piegraph serve", "--run RUN, or --model FILE")
    if live and recording is None:
        raise UsageError("--live needs the cameras' calibration", "piegraph serve", "--recording RECORDING")


@contextlib.contextmanager
def _service(
    run: Path | None, model: str | None, recording: Path | None, live: bool, device: str
) -> "Iterator[Service]":
    from piegraph_cli.service.setup import opened_service

    with opened_service(run, model, recording, live, device) as service:
        yield service
