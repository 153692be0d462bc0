"""The command: JSON lines on stdin and stdout, a server that ends as it is told to, and what cannot be served."""

import io
import json
import signal
import subprocess
import urllib.request

import pytest

from piegraph_cli.commands import serve
from piegraph_cli.service.requests import MOST_BYTES
from piegraph_cli.service.stdio import lines, serve_lines
from tests.cli import PATIENCE, PROGRAM, REPOSITORY
from tests.cli import piegraph as in_a_process
from tests.commands.inside import envelope
from tests.envelopes import checked


def start(*arguments: object, **streams: int) -> subprocess.Popen:
    command = [*PROGRAM, "serve", *map(str, arguments)]
    return subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **streams)


def test_a_server_answers_until_it_is_told_to_end(tiny_run):
    server = start("--run", tiny_run, "--port", 0, "--json")
    try:
        ready = checked(server.stdout.readline().decode())
        with urllib.request.urlopen(f"{ready['result']['url']}/info", timeout=PATIENCE) as answer:
            assert json.load(answer)["result"]["model"]["key"] == ready["result"]["key"]
        server.send_signal(signal.SIGTERM)
        out, err = server.communicate(timeout=PATIENCE)
        assert (server.returncode, out, err) == (143, b"", b"")
    finally:
        server.kill()


def test_ctrl_c_adds_no_second_object_to_stdout(tiny_run):
    server = start("--run", tiny_run, "--port", 0, "--json")
    try:
        checked(server.stdout.readline().decode())
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=PATIENCE)
        assert (server.returncode, out) == (130, b"")
        assert err.startswith(b"interrupted")
    finally:
        server.kill()


def test_json_lines_until_ctrl_c(tiny_run, question):
    server = start("--run", tiny_run, "--stdio", "--json", stdin=subprocess.PIPE)
    try:
        for line, failed in (
            (json.dumps({"command": "plan", **question}).encode(), False),
            (b"\xff\x00 junk", True),
            (b"a" * (3 * MOST_BYTES), True),
            (b'{"command": "info"}', False),
        ):
            server.stdin.write(line + b"\n\n")
            server.stdin.flush()
            answer = json.loads(server.stdout.readline())
            assert (answer["error"] is not None) == failed
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=PATIENCE)
        assert (server.returncode, out) == (130, b"")
        assert err.decode().splitlines()[0].startswith("model piegraph, key")
        assert b"Traceback" not in err
    finally:
        server.kill()


def test_lines_of_a_stream():
    long = b"a" * (2 * MOST_BYTES + 7)
    found = list(lines(io.BytesIO(b"{}\n\n  \nlast one\n" + long + b"\nnext\n" + long)))
    assert [len(line) for line in found] == [3, 9, MOST_BYTES + 1, 5, MOST_BYTES + 1]
    assert list(lines(io.BytesIO(b"without an end"))) == [b"without an end"]


class Gone(io.BytesIO):
    """What nobody reads any more."""

    def write(self, data):
        raise BrokenPipeError


def test_stdin_that_ends_and_a_reader_that_is_gone(service, tiny_run):
    read = io.BytesIO()
    serve_lines(service, io.BytesIO(b'{"command": "info"}\n{"command": "info"}'), read)
    assert [json.loads(line)["error"] for line in read.getvalue().splitlines()] == [None, None]
    serve_lines(service, io.BytesIO(b'{"command": "info"}\n'), Gone())
    done = in_a_process("serve", "--run", tiny_run, "--model", "static", "--stdio")
    assert (done.stdout, done.stderr) == ("", "model static answers JSON lines on stdin\n")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "nothing to serve"),
        (("--run", "nowhere"), 2, "not a run folder"),
        (("--model", "nothing.h5"), 3, "no such model artifact"),
        (("--run", "RUN", "--model", "pgnd"), 3, "model is missing"),
        (("--run", "RUN", "--live"), 2, "--live needs the cameras"),
        (("--run", "RUN", "--port", "99999"), 2, "65535"),
        (("--run", "RUN", "--token-file", "nothing"), 3, "No such file"),
        (("--run", "RUN", "--host", "256.0.0.1", "--port", "0"), 2, "cannot listen"),
    ],
)
def test_what_cannot_be_served(tiny_run, tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.delenv(serve.TOKEN, raising=False)
    monkeypatch.chdir(tmp_path)
    words = [str(tiny_run) if word == "RUN" else word for word in arguments]
    found = envelope("serve", *words, check=code)
    assert message in found["error"]["message"]


def test_tokens(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv(serve.TOKEN, raising=False)
    assert (serve._token("127.0.0.1", None), serve._token("::1", None), serve._token("localhost", None)) == (None,) * 3
    made = serve._token("0.0.0.0", None)
    assert f"Authorization: Bearer {made}\n" in capsys.readouterr().err
    assert serve._token("192.168.1.2", None) != made
    monkeypatch.setenv(serve.TOKEN, "sixteen-letters-and-more")
    assert serve._token("127.0.0.1", None) == serve._token("0.0.0.0", None) == "sixteen-letters-and-more"
    file = tmp_path / "token"
    file.write_text("another-word-of-16-letters\n")
    assert serve._token("0.0.0.0", file) == "another-word-of-16-letters"
    for bad in ("", "short", "two words that are long", "sechzehn-Zeichen-ä-ü"):
        file.write_text(bad)
        with pytest.raises(serve.UsageError, match="one word of at least 16"):
            serve._token("0.0.0.0", file)
