"""Compiled kernels: where they are kept, and what happens where they cannot be."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
import warp as wp

from piegraph_cli.dynamics import network_kernel
from piegraph_cli.kernels import lanes
from piegraph_cli.physics import spring_kernel

CODE = """
import logging, sys
logging.basicConfig(format="%(message)s")
import torch
from piegraph_cli.kernels import lanes
from piegraph_cli.physics import spring_kernel
from piegraph_cli.physics.springs import build_springs
graph = build_springs(torch.rand(9, 3).numpy(), 0.5)
start = torch.rand(1, 9, 3)
print(bool(torch.isfinite(spring_kernel.guide(start, start, graph, spring_kernel.GuidanceParams(stiffness=0.01))).all()))
"""


def run(cache) -> subprocess.CompletedProcess:
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    return subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True)


def compiled(folder) -> dict:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.o")}


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """The cache that one process has filled: read it, never write to it."""
    folder = tmp_path_factory.mktemp("caches") / "my cache"
    first = run(folder)
    assert (first.stdout.strip(), first.stderr) == ("True", "")
    return folder


def test_a_second_process_compiles_nothing(cache):
    kept = compiled(cache)
    assert len(kept) == 1
    assert run(cache).stdout.strip() == "True"
    assert compiled(cache) == kept


@pytest.mark.parametrize("suffix", [".o", ".meta"])
def test_a_cache_cut_short_is_named(cache, tmp_path, suffix):
    shutil.copytree(cache, tmp_path, dirs_exist_ok=True)
    for path in tmp_path.rglob(f"*{suffix}"):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    error = run(tmp_path).stderr
    assert f"MissingError: {tmp_path}/piegraph/kernels" in error
    assert "delete that folder" in error


def test_without_a_cache_folder_kernels_are_compiled_and_it_is_said(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = run(tmp_path / "file")
    assert done.stdout.strip() == "True"
    assert "no writable cache" in done.stderr
    assert "XDG_CACHE_HOME" in done.stderr


def test_the_kernels_of_a_gpu_compile(tmp_path):
    terms = spring_kernel._Terms(True, True, True, True, True)
    kernels = (
        spring_kernel._guide_blocks(terms),
        spring_kernel._push_blocks(terms),
        network_kernel._kernel_blocks(True, True),
    )
    for number, kernel in enumerate(kernels):
        wp.compile_aot_module(kernel.module, arch=80, module_dir=str(tmp_path / str(number)))
        assert list((tmp_path / str(number)).glob("*.sm80.*"))


@pytest.mark.parametrize("used", [1, 2, 3])
@pytest.mark.parametrize("count", [1, 4, 5, 17])
def test_parts_come_back_in_their_order(monkeypatch, used, count):
    monkeypatch.setattr(lanes, "cores", lambda: used)
    found = lanes.in_parts(lambda part: np.arange(count)[part], count, 4)
    np.testing.assert_array_equal(np.concatenate(found), np.arange(count))
    assert {len(part) for part in found[:-1]} <= {4}
