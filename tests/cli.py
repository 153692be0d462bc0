"""Running the command line from tests, and where things are."""

import json
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
SAMPLE = REPOSITORY / "sample_data" / "tblock"


def piegraph(*arguments: object, check: int | None = 0, **options) -> subprocess.CompletedProcess:
    """Run the command line in a process of its own; `check` is the exit code it must end with."""
    command = [sys.executable, "-m", "piegraph_cli", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, **options)
    if check is not None:
        assert done.returncode == check, f"{arguments}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def piegraph_json(*arguments: object) -> dict:
    """The JSON object a command prints with --json."""
    return json.loads(piegraph(*arguments, "--json").stdout)
