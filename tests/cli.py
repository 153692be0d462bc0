"""Running the command line from tests, and where things are."""

import atexit
import functools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.envelopes import checked

REPOSITORY = Path(__file__).parents[1]
SAMPLE = REPOSITORY / "sample_data" / "tblock"
PATIENCE = 600.0
"""Seconds that a test waits for what must come: the machine may have other work, so only what never comes takes longer."""
PROGRAM = [sys.executable, "-m", "piegraph_cli"]
"""The command line as a process that a test may signal, limit or start without one of its packages."""


def piegraph(
    *arguments: object,
    check: int | None = 0,
    cwd: Path | None = None,
    env: dict[str, str] | None = None,
    **place: object,
) -> subprocess.CompletedProcess:
    """Run the command line in a process of its own, forked by `forks.py`; `check` is the exit code it must end with.

    `place`: the cores it has, and whose file systems.
    """
    environment = dict(os.environ if env is None else env)
    server = _server(environment.get("LD_PRELOAD", ""))
    with tempfile.TemporaryDirectory() as folder:
        files = {name: f"{folder}/{name}" for name in ("stdout", "stderr")}
        request = {"arguments": list(map(str, arguments)), "folder": str(cwd or Path.cwd()), **files}
        server.stdin.write(json.dumps(request | {"environment": environment, **place}) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        done = subprocess.CompletedProcess(arguments, code, *(Path(path).read_text() for path in files.values()))
    if check is not None:
        assert done.returncode == check, f"{arguments}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


@functools.cache
def _server(preload: str) -> subprocess.Popen:
    """One for each library that is preloaded: what is forked has those of its server."""
    command = [sys.executable, "-c", "from tests.forks import serve; serve()"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    server = subprocess.Popen(command, cwd=REPOSITORY, env=os.environ | {"LD_PRELOAD": preload}, **pipes)
    atexit.register(server.communicate)  # its stdin is closed, so it ends
    return server


def piegraph_json(*arguments: object) -> dict:
    """The result that a command prints with --json."""
    return checked(piegraph(*arguments, "--json").stdout)["result"]
