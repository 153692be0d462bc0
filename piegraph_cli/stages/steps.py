"""What stages share that act in simulated environments: opening one, and a look at what it needs before hours are spent."""

import os
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.environments import ENVIRONMENTS
from piegraph_cli.environments.params import VARIABLES, EnvironmentParams
from piegraph_cli.process import free_memory

if TYPE_CHECKING:
    from piegraph_cli.planning.model import Model
    from piegraph_cli.planning.params import PlanParams


def make_environment(name: str, particles: int, params: EnvironmentParams) -> Any:
    """The environment of that name with the options that are given for it; one with a process of its own is kept for the
    next unit, which would wait for another to start and compile."""
    from piegraph_cli.environments import make

    if not ENVIRONMENTS[name].memory:
        return make(name, particles, params.options)
    given = {"python": params.daxbench_python, "repo": params.daxbench_repo}
    options = dict(params.options) | {k: str(v) for k, v in given.items() if v is not None}
    shell = tuple(os.environ.get(variable) for variable in VARIABLES.values())
    return _made_once(name, particles, tuple(sorted(options.items())), shell, Path.cwd())


@lru_cache(maxsize=1)
def _made_once(name: str, particles: int, options: tuple, shell: tuple, folder: Path) -> Any:
    """Made of what it depends on: the variables of the shell and the folder that paths start from too."""
    from piegraph_cli.environments import make

    return make(name, particles, dict(options))


def open_environment(params: "PlanParams", model: "Model") -> Any:
    """The environment `params.env`, with as many particles as the model was trained on."""
    return make_environment(str(params.env), model.particles, params)


def check_environments(wanted: Iterable[tuple[str | None, EnvironmentParams]], processes: int) -> list[str]:
    """Raise what would fail every stroke in the environments that run in processes of their own; warn of memory."""
    apart = {name: params for name, params in wanted if name is not None and ENVIRONMENTS[name].memory}
    for name, params in apart.items():
        make_environment(name, 50, params).check()
    free = free_memory()
    return [
        f"{name} takes {need / 1e9:.1f} GB in each of {processes} processes, and {free / 1e9:.1f} GB are free: give --jobs "
        f"{max(1, int(free / need))}, or end other programs"
        if processes > 1
        else f"{name} takes {need / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free: end other programs"
        for name in apart
        if free is not None and (need := ENVIRONMENTS[name].memory) * processes > free
    ]
