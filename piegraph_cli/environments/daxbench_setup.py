"""What the bridge to DaXBench needs on this machine: interpreter, packages and repository, and what mends each of them."""

import os
import shlex
import sys
from pathlib import Path
from typing import Any

from piegraph_cli.environments import daxbench_child
from piegraph_cli.environments.daxbench_process import HELP, clean
from piegraph_cli.environments.params import VARIABLES, DaXBenchOptions
from piegraph_cli.errors import MissingError

COMMIT = "bc73c58134b004e5fbe9131639d06e8e052566cd"
"""Of DaXBench's repository, with which the bridge was tested."""
PACKAGES = {
    "jax": "==0.4.13",
    "jaxlib": "==0.4.13",
    "numpy": "==1.26.4",
    "scipy": "<1.13",
    "gym": "==0.25.2",
    "optax": "==0.1.7",
    "opencv-python-headless": "<4.11",
    "trimesh": "<5",
}
"""Those of its interpreter, likewise."""
PYTHONS = ("3.9.", "3.10.", "3.11.")
"""For which there is such a jaxlib, and such a NumPy."""


def installation(options: DaXBenchOptions, task: str) -> tuple[Path, Path]:
    """The interpreter and the repository, given or named by the environment's variables, as far as that can be told
    without starting them."""
    where, found = f"daxbench-{task}", {}
    for name, given, what in (("python", options.python, "interpreter"), ("repo", options.repo, "repository")):
        named = os.environ.get(VARIABLES[name], "")
        if given is None and not named:
            ways = " and ".join(f"--daxbench-{n} PATH or {v}=PATH" for n, v in VARIABLES.items())
            raise MissingError(f"DaXBench's {what} is not given", where, f"give {ways}; {HELP}")
        found[name] = Path(named) if given is None else given
    python, repo = found["python"], found["repo"]
    if not python.is_file():
        raise MissingError(f"{python} is no interpreter", where, f"--daxbench-python PATH; {HELP}")
    folder = repo / "daxbench" / "core" / "envs"
    if not folder.is_dir():
        raise MissingError(f"{repo} is no DaXBench repository", where, f"--daxbench-repo PATH; {HELP}")
    module = f"{daxbench_child.TASKS[task].module}.py"
    if not (folder / module).is_file():
        raise MissingError(f"{repo} is a DaXBench without this task: {folder} has no {module}", where, _checkout(repo))
    # a virtual environment's interpreter is a link that must not be followed
    return python.absolute(), repo.resolve()


def _checkout(repo: Path) -> str:
    return f"git -C {shlex.quote(str(repo))} checkout {COMMIT}, with which this was tested; {HELP}"


def problem(reply: dict[str, Any], python: str, repo: Path, where: str) -> MissingError:
    """What keeps DaXBench from starting, as its process tells it, and what mends it."""
    said, found = reply["problem"], reply["found"]
    if not isinstance(said, str) or not isinstance(found, dict):
        raise ValueError("a problem in no words")
    version = clean(str(found.get("python")))
    wrong = [
        name
        for name, pin in PACKAGES.items()
        if found.get(name) is None or (pin[:2] == "==" and pin[2:] != found[name])
    ]
    if not version.startswith(PYTHONS):
        hint = f"make its virtual environment with Python 3.9, 3.10 or 3.11, this one has {version}; {HELP}"
    elif wrong and Path(python).parent == Path(sys.executable).absolute().parent:
        hint = (
            f"make a virtual environment for DaXBench: this is piegraph's own, which its packages would break; {HELP}"
        )
    elif wrong:
        pins = " ".join(shlex.quote(f"{name}{PACKAGES[name]}") for name in wrong)
        hint = f"{shlex.quote(python)} -m pip install {pins}; {HELP}"
    else:
        hint = _checkout(repo)
    return MissingError(f"DaXBench does not start: {clean(said)[:300]}", where, hint)
