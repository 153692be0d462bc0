"""Trials on a Ray cluster of two nodes, one of which is killed while it works."""

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_stage
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.cli import PATIENCE, PROGRAM, piegraph
from tests.envelopes import checked

SETTINGS = {"envs": ["tblock"], "models": ["piegraph"], "goals": 3, "seeds": 4, "strokes": 6, "thresholds": [1e-6]}
"""No goal is reached, so no trial is over before its node can be killed."""
QUICK_TO_NOTICE = {
    "health_check_initial_delay_ms": 0,
    "health_check_period_ms": 500,
    "health_check_failure_threshold": 4,
}
NODE = {"num_cpus": 1, "object_store_memory": 80 << 20, "node_ip_address": "127.0.0.1", "include_dashboard": False}


@pytest.fixture
def cluster(monkeypatch):
    """A cluster of two nodes of one core each, on 127.0.0.1 alone, which reports to nobody."""
    folder = tempfile.mkdtemp(prefix="ray", dir="/tmp")  # short: paths of sockets have a limit
    monkeypatch.setenv("RAY_TMPDIR", folder)
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # or 127.0.0.1 becomes the machine's address
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    from ray.cluster_utils import Cluster

    found = Cluster(initialize_head=True, head_node_args=NODE | {"_system_config": QUICK_TO_NOTICE})
    try:
        found.add_node(**NODE)
        monkeypatch.setenv("RAY_ADDRESS", found.address)
        yield found
    finally:
        raylets = [process_of(node) for node in (found.head_node, *found.worker_nodes)]
        found.shutdown()
        shutil.rmtree(folder, ignore_errors=True)
        assert not any(Path(f"/proc/{raylet}").exists() for raylet in raylets)


def process_of(node) -> int:
    """The process id of a node's raylet."""
    return node.all_processes["raylet"][0].process.pid


def workers(raylet: int) -> list[int]:
    """Processes of a raylet that are at work on a trial."""
    listed = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(raylet)], capture_output=True, text=True).stdout
    return [int(line.split()[0]) for line in listed.splitlines() if "ray::piegraph" in line]


def wait_for(condition):
    limit = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.05)


def test_a_node_that_dies_loses_no_trial(cluster, tiny_run, tmp_path):
    runs = tmp_path / "runs"
    (runs / "tblock").mkdir(parents=True)
    shutil.copytree(tiny_run / "model", runs / "tblock" / "model")
    shutil.copy(tiny_run / "recipe.toml", runs / "tblock")
    (node,) = cluster.worker_nodes
    raylet, done = process_of(node), runs / "paper" / "trials"
    options = [
        f"--{name}={','.join(map(str, value)) if isinstance(value, list) else value}"
        for name, value in SETTINGS.items()
    ]
    command = [*PROGRAM, "trials", "--backend", "ray", "--json"]
    process = subprocess.Popen(
        [*command, "--run", runs / "paper", *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    at_work: list[int] = []

    def begun() -> bool:
        assert process.poll() is None, "all was done before a node was seen at work"
        at_work[:] = workers(raylet)
        return bool(at_work) and done.is_dir() and any(done.glob("*.h5"))

    try:
        wait_for(begun)
        (worker,) = at_work
        cluster.remove_node(node, allow_graceful=False)
        before = len(list(done.glob("*.h5")))
        out, err = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert before < 12, "the node was killed on the way"
    wait_for(lambda: not Path(f"/proc/{worker}").exists())
    names = sorted(path.name for path in done.iterdir())
    assert names == [f"tblock.piegraph.goal0{g}.seed0{s}.h5" for g in range(3) for s in range(4)]
    found = checked(out)["result"]
    assert [row["trials"] for row in found["results"]] == [12], "each trial once in the results"
    assert found["failed"] == []
    alone = runs / "alone"
    run_stage(Run(alone, Recipe(STAGES, {"trials": SETTINGS})), STAGES["trials"], Options())
    for name in names:
        one, other = read_artifact(done / name, "trials"), read_artifact(alone / "trials" / name, "trials")
        assert one.key == other.key
        assert all(
            np.array_equal(one[d], other[d], equal_nan=one[d].dtype.kind == "f") for d in set(one.arrays) - {"seconds"}
        )


def test_without_a_cluster_it_says_how_to_start_one(tmp_path):
    environment = {k: v for k, v in os.environ.items() if k != "RAY_ADDRESS"} | {"RAY_TMPDIR": str(tmp_path)}
    arguments = ["--envs", "tblock", "--models", "static", "--backend", "ray"]
    done = piegraph("trials", "--run", tmp_path / "paper", *arguments, check=4, env=environment)
    assert "no Ray cluster answers" in done.stderr
    assert "ray start --head" in done.stderr
    assert "Traceback" not in done.stderr
