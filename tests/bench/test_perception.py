"""The benchmark of perception: what it adds up, what it says of results that differ, and what it refuses."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.bench import perception
from piegraph_cli.errors import DataError
from tests.cli import piegraph

TIMES = {"a": np.arange(4) * 0.2, "b": np.arange(6) * 0.2}


class FakeRun:
    """A run whose artifacts are all there."""

    folder = SimpleNamespace(is_file=lambda: True)

    def __init__(self, folder=None, recipe=None):
        self.folder = folder
        self.recipe = SimpleNamespace(sections={"ingest": {"recording": "recording"}})

    def path(self, artifact, unit):
        return SimpleNamespace(is_file=lambda: True, unit=unit)

    def save_recipe(self):
        pass


@pytest.fixture
def commands(monkeypatch):
    """The commands that are timed; each takes as long as its name is."""
    given = []

    def seconds(*command):
        words = [str(word) for word in command]
        given.append(words)
        stage = next(word for word in words if word in (*perception.TIMED, "ingest"))
        return len(stage) * (2.0 if words[0] == sys.executable else 5.0)

    monkeypatch.setattr(perception, "_seconds", seconds)
    monkeypatch.setattr(perception, "open_run", lambda folder: FakeRun(folder))
    monkeypatch.setattr(perception, "Run", FakeRun)
    monkeypatch.setattr(perception, "sequences", lambda run: list(TIMES))
    monkeypatch.setattr(perception, "read_artifact", lambda path, name, only: {"time": TIMES[path.unit]})
    monkeypatch.setattr(perception, "_same", lambda own, run, name, names: name != "fuse")
    return given


def test_seconds_a_frame_and_their_sum_beside_the_cameras_step(commands, tmp_path):
    rows = list(perception.perception_rows(tmp_path, tmp_path / "other"))
    assert [row.seconds for row in rows] == pytest.approx([1.0, 1.4, 0.8, 1.0, 4.2])
    assert [row.as_dict()["ratio"] for row in rows] == pytest.approx([2.5] * 5)
    assert [row.case for row in rows][2] == "fuse, a frame, not as stored"
    assert rows[-1].case == "all four, a frame every 200 ms"
    assert [words[1] for words in commands if words[0] != sys.executable] == ["ingest", *perception.TIMED]


def test_alone_it_has_no_reference(commands, tmp_path):
    rows = list(perception.perception_rows(tmp_path, None))
    assert all("ratio" not in row.as_dict() for row in rows)
    assert all(words[0] == sys.executable for words in commands)


def test_the_processors_time_is_what_counts():
    spin = "import time\nwhile time.process_time() < 0.3: pass\ntime.sleep(0.5)"
    assert 0.25 < perception._seconds(sys.executable, "-c", spin) < 0.7
    with pytest.raises(DataError, match="no such thing"):
        perception._seconds(sys.executable, "-c", "raise SystemExit('no such thing')")


def test_a_folder_without_an_environment_is_refused(tmp_path):
    refused = piegraph("bench", "perception", "--run", tmp_path, "--against", tmp_path, check=2).stderr
    assert ".venv/bin/piegraph" in refused
