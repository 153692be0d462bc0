"""The command `view` as a process: the address that it prints answers, and it ends when it is told to."""

import contextlib
import os
import signal
import subprocess
import sys
import urllib.request
from http.client import HTTPConnection
from importlib.metadata import version

import pytest

from tests.cli import REPOSITORY
from tests.viewer import made


def greeted(url: str, origin: str | None, **headers: str) -> bool:
    """Whether the viewer's web socket answers a page of that origin."""
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13", **headers}
    upgrade |= {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": f"viser-v{version('viser')}"}
    connection = HTTPConnection(url.removeprefix("http://"), timeout=20)
    with contextlib.closing(connection):
        connection.request("GET", "/", headers=upgrade | ({"Origin": origin} if origin else {}))
        return connection.getresponse().status == 101


@pytest.mark.parametrize("told", [signal.SIGTERM, signal.SIGINT])
def test_it_answers_where_it_says_and_ends_when_it_is_told(tmp_path, told):
    folder = made.make_run(tmp_path / "run", "frames")
    command = [sys.executable, "-m", "piegraph_cli", "view", "--run", str(folder)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, **pipes) as process:
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(line.split()[0], timeout=20) as answer:
            assert b"<title>" in answer.read().lower()
        own = line.split()[0]
        assert greeted(own, own)
        assert greeted(own, None)
        assert not greeted(own, "https://a.website")
        assert not greeted(own, "http://a.website", Host="a.website")
        process.send_signal(told)
        rest, errors = process.communicate(timeout=30)
    assert (process.returncode, rest) == (0, "")
    assert "Traceback" not in errors


def test_a_folder_that_is_no_run_is_refused(tmp_path, capsys):
    from piegraph_cli.commands.program import call

    assert call(["view", "--run", str(tmp_path)]) == 2
    assert "not a run folder" in capsys.readouterr().err
    folder = made.make_run(tmp_path / "run", "frames")
    assert call(["view", "--run", str(folder), "--sequence", "none"]) == 2
    assert "one of first" in capsys.readouterr().err
