"""docs/robot.md: its code runs as it stands, against a service of the tiny run, and it names every field of a request."""

import json
import re
import shlex
import shutil
import subprocess

import pytest

from piegraph_cli.service.requests import REQUESTS
from tests.cli import REPOSITORY

PAGE = (REPOSITORY / "docs" / "robot.md").read_text(encoding="utf-8")
PORT = "8765"


def test_the_python_of_the_page(server, capsys):
    names: dict = {}
    for example in re.findall(r"```python\n(.*?)```", PAGE, re.S):
        exec(compile(example.replace(PORT, str(server.port)), "docs/robot.md", "exec"), names)
    out = capsys.readouterr().out
    assert "cm from the goal (distance)" in out
    assert "(50, 3)" in out
    with pytest.raises(RuntimeError, match="one goal is needed"):
        names["ask"]("plan", state=names["packed"])


@pytest.mark.skipif(shutil.which("curl") is None, reason="no curl")
def test_curl(server, question, tmp_path):
    (tmp_path / "question.json").write_text(json.dumps(question))
    lines = [line.replace(PORT, str(server.port)) for line in PAGE.splitlines() if line.startswith("curl ")]
    assert len(lines) == 2
    for line in lines:
        done = subprocess.run(shlex.split(line), cwd=tmp_path, capture_output=True, check=True)
        assert json.loads(done.stdout)["error"] is None


def test_every_field_is_named():
    asked = PAGE[PAGE.index("## What is asked") : PAGE.index("## What is answered")]
    for command, model in REQUESTS.items():
        assert f"`{command}`" in asked
        for name in model.model_fields:
            assert f"`{name}`" in asked, f"{command}: {name}"
