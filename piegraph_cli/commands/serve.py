"""The command `serve`: a model kept warm that answers over HTTP, or over JSON lines on stdin and stdout."""

import ipaddress
import os
import secrets
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piegraph_cli.commands.answer import answer
from piegraph_cli.commands.options import AsJson, Device
from piegraph_cli.commands.stages import require_run
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.signals import stopped

if TYPE_CHECKING:
    from piegraph_cli.service.service import Service

TOKEN = "PIEGRAPH_TOKEN"
"""The environment's variable that holds the token."""


def serve(
    run: Annotated[Path | None, typer.Option("--run", help="run folder of a trained model")] = None,
    model: Annotated[
        str | None, typer.Option(help="model of the run, by label [default: piegraph]; without --run a model's FILE")
    ] = None,
    stdio: Annotated[
        bool, typer.Option("--stdio", help="JSON lines on stdin and stdout in place of HTTP", show_default=False)
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port of HTTP; 0 takes a free one")] = 8765,
    host: Annotated[str, typer.Option(help="address of HTTP; beyond this machine a token is needed")] = "127.0.0.1",
    token_file: Annotated[
        Path | None, typer.Option(help=f"file with the token [default: ${TOKEN}, or a new one]")
    ] = None,
    recording: Annotated[
        Path | None, typer.Option(help="recording whose images are looked at, and whose cameras.json places the robot")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="look through the cameras of --recording, plugged in", show_default=False)
    ] = False,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Keep a model warm and answer a robot program: plan, predict, look, info.

    It serves until Ctrl-C or SIGTERM, or, with --stdio, until stdin ends. What to send is in docs/robot.md.
    """
    _check(run, model, recording, live)
    what = (run, model, recording, live, device)
    try:
        if stdio:
            _on_stdio(what)
        else:
            _on_http(what, host, port, _token(host, token_file), as_json)
    except KeyboardInterrupt:
        if stopped() == signal.SIGTERM:  # how services are ended: there is nothing to say
            raise typer.Exit(128 + signal.SIGTERM) from None
        raise


def _on_stdio(what: tuple[Any, ...]) -> None:
    from piegraph_cli.service.setup import opened_service
    from piegraph_cli.service.stdio import serve_lines, stdout_alone

    with stdout_alone() as answers, opened_service(*what) as service:
        answer().told = True  # stdout belongs to the answers
        print(f"{_what(service)} answers JSON lines on stdin", file=sys.stderr, flush=True)
        serve_lines(service, sys.stdin.buffer, answers)


def _on_http(what: tuple[Any, ...], host: str, port: int, token: str | None, as_json: bool) -> None:
    from piegraph_cli.service.http import Gate, listen, make_server

    with listen(host, port) as socket:  # before the model is read: a port that is taken is said at once
        from piegraph_cli.service.setup import opened_service

        with opened_service(*what) as service:
            url = f"http://{f'[{host}]' if ':' in host else host}:{socket.getsockname()[1]}"
            make_server(service, Gate(host, token), lambda: _tell(service, url, as_json)).run([socket])


def _check(run: Path | None, model: str | None, recording: Path | None, live: bool) -> None:
    if run is None and model is None:
        raise UsageError("nothing to serve", "piegraph serve", "--run RUN, or --model FILE")
    if run is not None:
        require_run(run)
    if live and recording is None:
        raise UsageError("--live needs the cameras' calibration", "piegraph serve", "--recording RECORDING")


def _token(host: str, file: Path | None) -> str | None:
    """What requests must bear: the file's or the environment's token; beyond this machine a new one, which is printed."""
    if file is not None:
        try:
            token = file.read_text().strip()
        except (OSError, ValueError) as error:
            raise DataError(f"cannot be read: {getattr(error, 'strerror', None) or error}", str(file)) from None
        where = str(file)
    else:
        token, where = os.environ.get(TOKEN, "").strip(), f"${TOKEN}"
    if file is None and not token:
        if _of_this_machine(host):
            return None
        token = secrets.token_urlsafe()
        print(f"requests need the header  Authorization: Bearer {token}", file=sys.stderr, flush=True)
    if not token.isascii() or not token.isprintable() or len(token) < 16 or " " in token:
        hint = "python -c 'import secrets; print(secrets.token_urlsafe())' makes one"
        raise UsageError("a token is one word of at least 16 characters", where, hint)
    return token


def _of_this_machine(host: str) -> bool:
    """Whether nothing but this machine can reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _what(service: "Service") -> str:
    key = f", key {service.origin.key[:12]}" if service.origin.key else ""
    return f"model {service.model.label}{key}"


def _tell(service: "Service", url: str, as_json: bool) -> None:
    """Say where the service is, at once, whoever reads it."""
    from piegraph_cli.service.service import envelope

    if as_json:
        value = {"url": url, "model": service.model.label, "key": service.origin.key}
        answer().told = True  # first: whoever reads the line may end the server at once
        print(envelope("serve", value, [], None).text.decode(), flush=True)
    else:
        print(f"{url}  ({_what(service)}; Ctrl-C ends it)", flush=True)
