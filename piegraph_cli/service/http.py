"""HTTP on one address: POST /plan, /predict, /look and /info. One request is worked on at a time; few wait."""

import asyncio
import errno
import hmac
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from http import HTTPStatus

from piegraph_cli.errors import DataError, MissingError, PiegraphError, UsageError
from piegraph_cli.service.hosts import is_ours
from piegraph_cli.service.requests import MOST_BYTES, REQUESTS
from piegraph_cli.service.service import Reply, Service, envelope

try:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.requests import ClientDisconnect, Request
    from starlette.responses import Response
    from starlette.routing import Route
except ImportError as error:
    raise MissingError(f"{error.name} is not installed", hint="pip install 'piegraph[serve]', or --stdio") from None

WAITING = 8
"""Requests that wait for the one that is worked on; more are refused."""
CONNECTIONS = 64
"""Open at a time."""
PATIENCE = 30.0
"""Seconds for a request's body to arrive."""
DRAINED = 64 << 20
"""Bytes of a request that are read at most, to answer those who send too much."""
FAREWELL = 10
"""Seconds for what is worked on when the server is told to end."""

STATUS = {
    0: HTTPStatus.OK,
    2: HTTPStatus.UNPROCESSABLE_ENTITY,
    3: HTTPStatus.UNPROCESSABLE_ENTITY,
    4: HTTPStatus.SERVICE_UNAVAILABLE,
}
"""By the exit code that a command would end with."""

Refused = tuple[HTTPStatus, PiegraphError]


@dataclass
class Gate:
    """Who may ask."""

    host: str
    """The address that is listened on."""
    token: str | None
    """Needed in each request, where there is one."""

    def check(self, request: Request) -> Refused | None:
        """Why a request is refused before it is read.

        A page of some website in a browser on this machine can send requests here: by a name that it has pointed at this
        address, which the host it names tells, or across origins, which the header of that name tells.
        """
        host = request.headers.get("host", "")
        if not is_ours(host, self.host):
            text = f"this server is not called {host[:80]!r}"
            return HTTPStatus.MISDIRECTED_REQUEST, UsageError(text, "Host", f"ask {self.host}")
        if "origin" in request.headers:
            return HTTPStatus.FORBIDDEN, UsageError("pages of a browser are not answered", "Origin")
        given = request.headers.get("authorization", "")
        if self.token is not None and not hmac.compare_digest(given.encode(), f"Bearer {self.token}".encode()):
            return HTTPStatus.UNAUTHORIZED, UsageError(
                "a token is needed", "Authorization", "Authorization: Bearer TOKEN"
            )
        kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if request.method == "POST" and kind != "application/json":
            hint = "send the header Content-Type: application/json"
            return HTTPStatus.UNSUPPORTED_MEDIA_TYPE, UsageError(
                f"not JSON but {kind[:80] or 'unnamed'}", "Content-Type", hint
            )
        return None


@dataclass
class Counter:
    """Takes requests in their order, and has the service work on one at a time."""

    service: Service
    gate: Gate
    waiting: int = 0
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    worker: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, thread_name_prefix="service"))

    async def take(self, request: Request) -> Response:
        """The answer to one request."""
        command = request.path_params["command"]
        try:
            refused = self.gate.check(request) or _unknown(request.method, command)
            data = await asyncio.wait_for(_body(request, MOST_BYTES + 1 if refused is None else 0), PATIENCE)
        except ClientDisconnect:
            return Response()
        except asyncio.TimeoutError:
            late = DataError(f"the request did not arrive within {PATIENCE:g} s", "request")
            refused = HTTPStatus.REQUEST_TIMEOUT, late
        if refused is None and self.waiting > WAITING:
            busy = Busy(f"{WAITING} requests are waiting already", "request", "ask again when they are answered")
            refused = HTTPStatus.SERVICE_UNAVAILABLE, busy
        if refused is not None:
            return _response(envelope(command if command in REQUESTS else None, None, [], refused[1]), refused[0])
        return await self._in_turn(request, command, data)

    async def _in_turn(self, request: Request, command: str, data: bytes) -> Response:
        self.waiting += 1
        try:
            async with self.turn:
                if await request.is_disconnected():
                    return Response()  # nobody waits for it any more
                loop = asyncio.get_running_loop()
                reply = await loop.run_in_executor(self.worker, self.service.reply, data, command)
        finally:
            self.waiting -= 1
        status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE if len(data) > MOST_BYTES else STATUS.get(reply.exit_code)
        return _response(reply, status or HTTPStatus.INTERNAL_SERVER_ERROR)


class Busy(PiegraphError):
    """More is asked than can be answered."""

    exit_code = 4
    kind = "busy"


def _unknown(method: str, command: str) -> Refused | None:
    if command in REQUESTS and (method == "POST" or (method, command) == ("GET", "info")):
        return None
    commands = ", ".join(f"/{name}" for name in REQUESTS)
    return HTTPStatus.NOT_FOUND, UsageError(f"there is no {method} /{command}"[:80], "request", f"POST {commands}")


async def _body(request: Request, keep: int) -> bytes:
    """The first `keep` bytes of the body. The rest is read too: whoever still sends does not read the answer."""
    data, read = bytearray(), 0
    async for chunk in request.stream():
        data += chunk[: keep - len(data)]
        read += len(chunk)
        if read > DRAINED:
            break
    return bytes(data)


def _response(reply: Reply, status: HTTPStatus) -> Response:
    headers = {"WWW-Authenticate": "Bearer"} if status == HTTPStatus.UNAUTHORIZED else {}
    return Response(reply.text + b"\n", status, headers, "application/json")


async def _no_method(request: Request, error: Exception) -> Response:
    refused = UsageError(f"the method {request.method[:20]} is not served", "request", "POST")
    return _response(envelope(None, None, [], refused), HTTPStatus.METHOD_NOT_ALLOWED)


def listen(host: str, port: int) -> socket.socket:
    """A socket on that address; port 0 takes a free one. Raises `UsageError` where that cannot be."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        taken = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
        reason = "the port is taken" if taken else f"cannot listen: {getattr(error, 'strerror', None) or error}"
        hint = "another --port, or --port 0 for a free one" if taken else "--host 127.0.0.1 and a --port above 1023"
        raise UsageError(reason, f"{host}:{port}", hint) from None


class _Server(uvicorn.Server):
    """Calls `ready` when it can be asked, and no signal can fall into what is still set up."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]):
        super().__init__(config)
        self.ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """As any server's, then `ready`."""
        await super().startup(sockets)
        self.ready()


def make_server(service: Service, gate: Gate, ready: Callable[[], None]) -> uvicorn.Server:
    """A server for sockets of `listen`: `server.run([socket])`; `ready` is called once it answers."""
    take = Counter(service, gate).take
    app = Starlette(
        routes=[Route("/{command:path}", take, methods=["GET", "POST"])], exception_handlers={405: _no_method}
    )
    return _Server(
        uvicorn.Config(
            app,
            loop="asyncio",
            http="h11",
            ws="none",
            lifespan="off",
            log_level="critical",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            limit_concurrency=CONNECTIONS,
            timeout_graceful_shutdown=FAREWELL,
        ),
        ready,
    )
