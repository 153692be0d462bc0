"""The table of environments, the names that settings accept, and what the documentation says of them."""

import pytest

pytest.importorskip("mujoco", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from typing import get_args

from piegraph_cli.environments import ENVIRONMENTS, check_options
from piegraph_cli.errors import UsageError
from piegraph_cli.params import EnvironmentName
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
