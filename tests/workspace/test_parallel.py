"""Many items in processes of this machine: all results, and a worker that dies."""

import os
import signal
import sys
from types import SimpleNamespace

import pytest

from piegraph_cli.errors import MissingError
from piegraph_cli.workspace.parallel import RETRIES, each


def square(number):
    return number**2


def die(number):
    os.kill(os.getpid(), signal.SIGKILL)


def not_lost(number, error):
    raise AssertionError


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_has_its_result(jobs):
    assert sorted(each(square, range(20), jobs, "local", not_lost)) == [n**2 for n in range(20)]


def test_a_worker_that_is_killed_ends_the_command_with_a_word():
    with pytest.raises(MissingError, match="a worker process was killed") as caught:
        list(each(die, range(4), 2, "local", not_lost))
    assert "--jobs" in caught.value.hint


class Ray:
    """What is used of Ray: tasks are done when they are waited for, the last one first."""

    class exceptions:
        class RayError(Exception):
            pass

    def __init__(self, answers: bool = True):
        self.answers, self.told = answers, []

    def init(self, **options):
        if not self.answers:
            raise ConnectionError
        self.told.append(("init", options["address"], options["log_to_driver"]))

    def remote(self, **options):
        self.told.append(("remote", options))

        def task(work, item):
            return (work, item)

        def decorate(call):
            return SimpleNamespace(options=lambda name: SimpleNamespace(remote=task))

        return decorate

    def wait(self, waiting, num_returns=1):
        return waiting[-num_returns:], waiting[:-num_returns]

    def get(self, done):
        work, item = done
        if item == 3:
            raise self.exceptions.RayError("node died\nand more")
        print("news of nodes")
        return work(item)

    def shutdown(self):
        self.told.append(("shutdown",))


@pytest.fixture
def ray(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", found := Ray())
    monkeypatch.setenv("RAY_gcs_server_port_wait_time_s", "7")
    return found


def test_a_cluster_gives_every_result_as_it_comes_and_loses_one_with_a_word(ray, capsys):
    lost = []
    found = list(each(square, range(5), 1, "ray", lambda item, error: lost.append((item, error)) or -item))
    assert found == [16, -3, 4, 1, 0]
    ((item, error),) = lost
    assert (item, type(error)) == (3, MissingError)
    assert str(error).startswith(f"lost {RETRIES + 1} times: node died\n")
    assert ray.told == [
        ("init", "auto", False),
        ("remote", {"num_cpus": 1, "max_retries": RETRIES}),
        ("shutdown",),
    ]
    assert capsys.readouterr().out == "", "stdout is for results"


def test_a_cluster_is_left_where_the_work_is_broken_off(ray):
    def broken(number):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(each(broken, range(2), 1, "ray", not_lost))
    assert ray.told[-1] == ("shutdown",)


def test_without_ray_or_without_an_answer_it_says_what_is_missing(ray, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "somewhere:1")
    ray.answers = False
    with pytest.raises(MissingError, match="no Ray cluster answers") as caught:
        list(each(square, range(2), 1, "ray", not_lost))
    assert caught.value.where == "somewhere:1"
    assert ray.told == []
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingError, match="ray is not installed"):
        list(each(square, range(2), 1, "ray", not_lost))
