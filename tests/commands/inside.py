"""The command line inside this process, where a process of its own is not the point: nothing heavy is imported again."""

import contextlib
import io
import os
import subprocess
from pathlib import Path

from piegraph_cli.commands.program import call
from tests.envelopes import checked


def piegraph(*arguments: object, check: int | None = 0, cwd: Path | None = None) -> subprocess.CompletedProcess:
    """Run a command line; `check` is the exit code it must end with."""
    out, err, before = io.StringIO(), io.StringIO(), Path.cwd()
    os.chdir(cwd or before)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = call([*map(str, arguments)])
    finally:
        os.chdir(before)
    if check is not None:
        assert code == check, f"{arguments}: exit {code}\n{out.getvalue()}\n{err.getvalue()}"
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def piegraph_json(*arguments: object, check: int | None = 0) -> dict:
    """The result that a command prints with --json."""
    return envelope(*arguments, check=check)["result"]


def envelope(*arguments: object, check: int | None = 0) -> dict:
    """All that a command prints with --json: one object."""
    return checked(piegraph(*arguments, "--json", check=check).stdout)
