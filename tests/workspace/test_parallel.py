"""Many items in processes of this machine: all results, and a worker that dies."""

import os
import signal

import pytest

from piegraph_cli.errors import MissingError
from piegraph_cli.workspace.parallel import each


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
