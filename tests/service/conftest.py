"""A warm service on the tiny run, and servers on it."""

import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piegraph_cli import open_run
from piegraph_cli.service.http import Gate, listen, make_server
from piegraph_cli.service.service import Service
from piegraph_cli.service.setup import opened_service
from tests.cli import PATIENCE


@pytest.fixture(scope="session")
def service(tiny_run: Path) -> Iterator[Service]:
    with opened_service(tiny_run, None) as service:
        yield service


@pytest.fixture(scope="session")
def block(tiny_run: Path) -> np.ndarray:
    """The T-block's particles [50, 3] (m) at the start of a sequence."""
    return open_run(tiny_run).read("tracks", "sequence_0000")["positions"][0]


@pytest.fixture
def question(block) -> dict[str, Any]:
    """A plan for it."""
    return {"state": block.tolist(), "goal_pose": [0.1, 0.0, 0.5]}


class Server:
    """An HTTP server in a thread."""

    def __init__(self, service: Service, gate: Gate):
        self.socket = listen("127.0.0.1", 0)
        self.port = self.socket.getsockname()[1]
        self.server = make_server(service, gate, lambda: None)
        self.thread = threading.Thread(target=self.server.run, args=([self.socket],))

    def ask(
        self, command: str, value: Any = None, *, method: str = "POST", headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Status and envelope of one request; a value that is no bytes is sent as JSON."""
        body = value if isinstance(value, bytes) else json.dumps(value or {}).encode()
        connection = HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        with contextlib.closing(connection):
            connection.request(method, f"/{command}", body, {"Content-Type": "application/json"} | (headers or {}))
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read())

    def connect(self) -> socket.socket:
        """A bare connection."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE)


@contextlib.contextmanager
def serving(service: Service, gate: Gate | None = None) -> Iterator[Server]:
    server = Server(service, gate or Gate("127.0.0.1", None))
    server.thread.start()
    try:
        until = time.monotonic() + PATIENCE
        while not server.server.started and time.monotonic() < until:
            time.sleep(0.01)
        yield server
    finally:
        server.server.should_exit = True
        server.thread.join(PATIENCE)
        server.socket.close()


@pytest.fixture(scope="module")
def server(service: Service) -> Iterator[Server]:
    with serving(service) as server:
        yield server
