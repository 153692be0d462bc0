"""Compiled kernels: where they are kept, and what happens where they cannot be."""

import os
import subprocess
import sys

CODE = """
import logging, sys
logging.basicConfig(format="%(message)s")
import torch
from piegraph_cli.kernels import springs
from piegraph_cli.physics.springs import build_springs
graph = build_springs(torch.rand(9, 3).numpy(), 0.5)
start = torch.rand(1, 9, 3)
print(bool(torch.isfinite(springs.guide(start, start, graph, springs.GuidanceParams(stiffness=0.01))).all()))
"""


def run(cache) -> subprocess.CompletedProcess:
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    return subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, timeout=120)


def compiled(folder) -> dict:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.o")}


def test_a_second_process_compiles_nothing(tmp_path):
    first = run(tmp_path / "my cache")
    assert (first.stdout.strip(), first.stderr) == ("True", "")
    kept = compiled(tmp_path / "my cache")
    assert kept
    assert run(tmp_path / "my cache").stdout.strip() == "True"
    assert compiled(tmp_path / "my cache") == kept


def test_without_a_cache_folder_kernels_are_compiled_and_it_is_said(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = run(tmp_path / "file")
    assert done.stdout.strip() == "True"
    assert "no writable cache" in done.stderr
    assert "XDG_CACHE_HOME" in done.stderr
