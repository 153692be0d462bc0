"""Progress over all units of a stage: counted in the units, summed up in one line, also from other processes."""

import os
import time
from functools import partial
from types import SimpleNamespace

import pytest

from piegraph_cli.workspace import progress
from piegraph_cli.workspace.parallel import each
from piegraph_cli.workspace.progress import Meter, counting, silent, watching
from tests.cli import PATIENCE


@pytest.fixture
def stderr(monkeypatch):
    """A terminal."""
    monkeypatch.setattr(progress, "sys", SimpleNamespace(stderr=SimpleNamespace(isatty=lambda: True)))
    monkeypatch.setattr(progress, "EVERY", 0.0)


def test_items_are_given_and_counted_over_several_iterables(stderr):
    told = []
    over = counting(lambda *of: told.append(of), 5, "images")
    assert [*over("abc"), *over("de")] == list("abcde")
    assert told == [(k, 5, "images") for k in range(6)]


def test_what_has_not_begun_is_expected_to_be_as_long_as_the_rest(stderr):
    meter = Meter("hands", 4, "sequence")
    assert (meter.bar.n, meter.bar.total) == (0, 4)
    meter.tell("a", 0, 100, "images")
    assert (meter.bar.n, meter.bar.total) == (0, 400)
    meter.tell("b", 10, 300, "images")
    meter.tell("a", 90, 100, "images")
    assert (meter.bar.n, meter.bar.total, meter.bar.unit) == (100, 800, " images")
    meter.finish("a")
    assert (meter.bar.n, meter.bar.total, meter.bar.postfix) == (110, 800, "1/4 sequences")
    meter.finish("b")
    meter.finish("c")
    assert (meter.bar.n, meter.bar.total, meter.bar.postfix) == (400, 600, "3/4 sequences"), "one never told anything"
    meter.finish("d")
    assert (meter.bar.n, meter.bar.total) == (400, 400)
    meter.bar.close()


def test_units_that_tell_nothing_are_counted(stderr):
    meter = Meter("trials", 2, "trial")
    meter.finish("a")
    assert (meter.bar.n, meter.bar.total, meter.bar.unit) == (1, 2, " trials")
    meter.bar.close()


def work(tell, unit):
    for _ in counting(partial(tell, unit), 20, "frames")(range(20)):
        time.sleep(0.02)
    return os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_the_sum_over_processes_is_shown(stderr, monkeypatch, jobs):
    seen = []
    real = Meter.tell
    monkeypatch.setattr(Meter, "tell", lambda self, *of: seen.append(of) or real(self, *of))
    with watching("track", 3, "sequence", jobs > 1, True) as (tell, finish):
        for unit in each(partial(work, tell), "abc", jobs, "local", None):
            finish(str(unit))
        limit = time.monotonic() + PATIENCE
        while len({of[0] for of in seen}) < 3:
            assert time.monotonic() < limit
            time.sleep(0.01)
    assert {of[0] for of in seen} == set("abc")
    assert {of[2:] for of in seen} == {(20, "frames")}
    assert max(of[1] for of in seen) > 5


def test_nothing_is_shown_where_stderr_is_no_terminal(capsys):
    with watching("track", 3, "sequence", True, True) as (tell, finish):
        assert tell is finish is silent
        tell("a", 1, 2, "frames")
    assert capsys.readouterr().err == ""


def test_of_other_machines_only_units_are_counted(stderr):
    with watching("track", 3, "sequence", True, False) as (tell, finish):
        assert tell is silent
        finish("a")


def test_a_reader_that_is_gone_does_no_harm(tmp_path):
    progress.Sender(str(tmp_path / "gone"))("a", 1, 2, "frames")
