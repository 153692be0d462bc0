"""The web server: on this machine alone, at the port that is printed, and nothing of it shared."""

import contextlib
import errno
import http
import io
import socket
from collections.abc import Callable, Iterator
from typing import Any

import viser
import websockets.asyncio.server
from websockets.http11 import Request, Response

from piegraph_cli.errors import UsageError
from piegraph_cli.service.hosts import is_ours

HOST = "127.0.0.1"
FREE_PORT = "another --port, or none: a free one is chosen then"


class Server(viser.ViserServer):
    """Viser's server without its tunnel to other machines, and without what it prints."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """No browser gets a share link, whatever it asks for: nothing leaves the machine."""
        return None

    def stop(self) -> None:
        """End quietly."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def start_server(port: int) -> Server:
    """A server at a port, or at a free one for 0. Raises `UsageError` where the port is taken or cannot be had."""
    _try_port(port)
    with contextlib.redirect_stdout(io.StringIO()), _own_pages_alone():
        server = Server(host=HOST, port=port, label="piegraph", verbose=False)
    if port not in (0, server.get_port()):  # somebody else was faster, and viser went to the next free one
        server.stop()
        raise UsageError(f"port {port} is taken", HOST, FREE_PORT)
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
    server.scene.set_up_direction("+z")
    return server


def _foreign(request: Request) -> bool:
    """Whether a website asks: by a name of its own for this machine, or from a page that is not this server's.

    A browser lets any page open a web socket to this machine, and tells which page it is in `Origin` alone.
    """
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
    return not is_ours(host, HOST) or (origin is not None and origin.lower() != f"http://{host}".lower())


@contextlib.contextmanager
def _own_pages_alone() -> Iterator[None]:
    """Servers that viser starts meanwhile refuse what is `_foreign`: it has no option for that, and takes all."""
    serve = websockets.asyncio.server.serve

    def guarded(*where: Any, process_request: Callable[..., Response | None], **options: Any) -> Any:
        def answer(connection: websockets.asyncio.server.ServerConnection, request: Request) -> Response | None:
            if _foreign(request):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "other websites are not answered\n")
            return process_request(connection, request)

        return serve(*where, process_request=answer, **options)

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _try_port(port: int) -> None:
    """Viser goes to the next free port without a word, and never comes back where there is none above."""
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((HOST, port))
        except OSError as error:
            why = "is taken" if error.errno == errno.EADDRINUSE else f"cannot be had: {error.strerror}"
            raise UsageError(f"port {port} {why}", HOST, FREE_PORT) from None


def address(server: Server) -> str:
    """Where it answers."""
    return f"http://{HOST}:{server.get_port()}"
