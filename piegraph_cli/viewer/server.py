"""The web server: on this machine alone, at the port that is printed, and nothing of it shared."""

import contextlib
import errno
import io
import socket

import viser

from piegraph_cli.errors import UsageError

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
    with contextlib.redirect_stdout(io.StringIO()):
        server = Server(host=HOST, port=port, label="piegraph", verbose=False)
    if port not in (0, server.get_port()):  # somebody else was faster, and viser went to the next free one
        server.stop()
        raise UsageError(f"port {port} is taken", HOST, FREE_PORT)
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
    server.scene.set_up_direction("+z")
    return server


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
