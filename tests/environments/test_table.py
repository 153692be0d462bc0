"""The table of environments: names, documentation, and what all that are pushed refuse alike."""

import pytest

pytest.importorskip("mujoco", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from functools import cache
from typing import get_args

import numpy as np

from piegraph_cli.environments import ENVIRONMENTS, check_options, make
from piegraph_cli.environments.params import EnvironmentName
from piegraph_cli.errors import DataError, UsageError
from tests.cli import REPOSITORY


def test_settings_accept_every_name():
    assert set(get_args(EnvironmentName)) == set(ENVIRONMENTS)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_documentation_names_every_environment_and_option(name):
    text = (REPOSITORY / "docs" / ("daxbench.md" if name.startswith("daxbench-") else "environments.md")).read_text()
    assert f"`{name}`" in text
    for option in ENVIRONMENTS[name].options.model_fields:
        assert f"`{option}`" in text or f'"{option}"' in text


def test_an_unknown_option_lists_those_there_are_with_their_units():
    with pytest.raises(UsageError, match="colour") as caught:
        check_options("rope-bendy", {"colour": 1})
    assert "young: Young's modulus [Pa]" in caught.value.hint
    with pytest.raises(UsageError, match="greater than 0"):
        check_options("rope-bendy", {"young": -1.0})


MUJOCO = ["rope-stiff", "rope-bendy", "toy"]


@cache
def made(name):
    return make(name)


def ready(name):
    made(name).reset(seed=3)
    return made(name)


@pytest.mark.parametrize("name", ["tblock", *MUJOCO])
@pytest.mark.parametrize(
    ("action", "reason"),
    [
        ({"start": [0, 0.3], "end": [0.1, 0.3], "mode": 1}, "knows no pick"),
        ({"start": [0, 0.3], "end": [0, 0.3], "mode": 0}, "heading"),
        ({"start": [0, np.nan], "end": [0, 0.3], "mode": 0}, "finite"),
    ],
)
def test_impossible_strokes_are_refused(name, action, reason):
    with pytest.raises(UsageError, match=reason):
        ready(name).step(action)


@pytest.mark.parametrize("name", MUJOCO)
@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_a_state_that_is_not_finite_is_refused(name, broken):
    env = ready(name)
    state = env.get_state()
    state["integration"][7] = broken
    with pytest.raises(DataError, match="finite"):
        env.set_state(state)


@pytest.mark.parametrize("name", MUJOCO)
def test_a_state_of_another_environment_is_refused(name):
    with pytest.raises(DataError, match="numbers"):
        ready(name).set_state({"integration": np.zeros(5)})
