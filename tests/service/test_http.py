"""HTTP: who may ask, what is refused before it is read, one at a time, clients that go away."""

import json
import socket
import threading
import time

import pytest

from piegraph_cli.errors import UsageError
from piegraph_cli.service import http
from piegraph_cli.service.http import Gate, listen
from piegraph_cli.service.requests import MOST_BYTES
from tests.cli import PATIENCE
from tests.envelopes import Envelope
from tests.service.conftest import serving


def test_questions_and_bad_ones_in_turn(server, question):
    status, found = server.ask("plan", question)
    Envelope.model_validate(found, strict=True)
    assert (status, found["command"], len(found["result"]["strokes"])) == (200, "plan", 1)
    for bad, wanted in ((b'{"state": [[NaN]]}', 422), (b"\x00\xff", 422), (b" " * (MOST_BYTES + 1), 413)):
        status, found = server.ask("plan", bad)
        assert (status, found["command"], found["result"]) == (wanted, "plan", None)
        assert found["error"]["message"]
        assert server.ask("info", method="GET")[0] == 200


@pytest.mark.parametrize(
    ("command", "method", "headers", "status"),
    [
        ("info", "GET", {}, 200),
        ("info", "POST", {"Host": "localhost:1"}, 200),
        ("info", "POST", {"Host": "[::1]:80"}, 200),
        ("info", "POST", {"Host": "piegraph.example"}, 421),
        ("info", "POST", {"Host": ""}, 421),
        ("info", "GET", {"Host": "127.0.0.1.piegraph.example"}, 421),
        ("info", "POST", {"Origin": "http://piegraph.example"}, 403),
        ("info", "POST", {"Origin": "null"}, 403),
        ("info", "POST", {"Content-Type": "text/plain"}, 415),
        ("info", "POST", {"Content-Type": "application/json; charset=utf-8"}, 200),
        ("plan", "GET", {}, 404),
        ("../info", "POST", {}, 404),
        ("plan/x", "POST", {}, 404),
        ("info", "PUT", {}, 405),
        ("info", "OPTIONS", {"Origin": "http://piegraph.example"}, 405),
    ],
)
def test_who_may_ask_what(server, command, method, headers, status):
    got, found = server.ask(command, method=method, headers=headers)
    assert got == status
    assert (found["error"] is None) == (status == 200)


def test_a_token(service):
    with serving(service, Gate("0.0.0.0", "secret")) as server:
        for given in (
            {},
            {"Authorization": "Bearer wrong"},
            {"Authorization": "secret"},
            {"Authorization": "Bearer é"},
        ):
            status, found = server.ask("info", headers=given)
            assert (status, found["result"]) == (401, None)
        assert server.ask("info", headers={"Authorization": "Bearer secret"})[0] == 200


def test_clients_that_go_away_or_send_junk(server, question):
    head = b"POST /plan HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n"
    body = json.dumps(question).encode()
    for sent in (b"\x16\x03\x01\x00\xff" * 9 + b"\r\n\r\n", head % 1000 + b"{", head % len(body) + body):
        with server.connect() as connection:
            connection.sendall(sent)
    with server.connect() as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nX: " + b"a" * 100_000)
        assert server.ask("info")[0] == 200


def test_a_body_that_does_not_arrive(server, monkeypatch):
    monkeypatch.setattr(http, "PATIENCE", 0.1)
    with server.connect() as connection:
        connection.sendall(
            b"POST /info HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{"
        )
        assert b"408" in connection.recv(100)


class Slow:
    """A service whose answers are waited for."""

    def __init__(self, service):
        self.service, self.go, self.at_work, self.most = service, threading.Event(), 0, 0

    def reply(self, data, command):
        self.at_work += 1
        self.most = max(self.most, self.at_work)
        self.go.wait(PATIENCE)
        self.at_work -= 1
        return self.service.reply(data, command)


def test_one_at_a_time_few_wait_and_who_has_left_is_not_served(service, monkeypatch):
    monkeypatch.setattr(http, "WAITING", 2)
    slow, answers = Slow(service), []
    with serving(slow) as server:  # type: ignore[arg-type]
        threads = [threading.Thread(target=lambda: answers.append(server.ask("info")[0])) for _ in range(6)]
        for thread in threads:
            thread.start()
        until = time.monotonic() + PATIENCE
        while len(answers) < 3 and time.monotonic() < until:
            time.sleep(0.01)
        assert answers == [503] * 3
        slow.go.set()
        for thread in threads:
            thread.join(PATIENCE)
        assert (sorted(answers), slow.most) == ([200] * 3 + [503] * 3, 1)


def test_ports():
    with listen("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match="the port is taken") as told:
            listen("127.0.0.1", port)
        assert told.value.where == f"127.0.0.1:{port}"
    with pytest.raises(UsageError, match="cannot listen"):
        listen("no such host.example", 0)
    if socket.has_ipv6:
        listen("::1", 0).close()
