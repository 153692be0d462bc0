"""What can be given by name, each with a line on what it is."""

from pathlib import Path

from piegraph_cli.dynamics.params import MODEL_HELP
from piegraph_cli.environments.params import ENVIRONMENT_HELP
from piegraph_cli.recording.params import LAYOUT_HELP
from piegraph_cli.workspace.recipe import SHIPPED


def models() -> dict[str, str]:
    """Models, for --model and --models."""
    return MODEL_HELP


def environments() -> dict[str, str]:
    """Simulated environments, for `simulate`, --env and --envs."""
    return ENVIRONMENT_HELP


def recipes() -> dict[str, str]:
    """Recipes that come with the package, for `run`."""
    return {path.stem: _first_line(path) for path in sorted(SHIPPED.glob("[!.]*.toml"))}


def experiments() -> dict[str, str]:
    """Experiments of the paper, for `reproduce`."""
    return {path.stem: _first_line(path) for path in sorted((SHIPPED / "experiments").glob("[!.]*.toml"))}


def all_experiments() -> dict[str, str]:
    """The same, and what else `reproduce` makes."""
    return experiments() | {
        "troubles": "Recordings that are wrong on purpose, and what ingest says of them (docs/checks.md)"
    }


def layouts() -> dict[str, str]:
    """Layouts of recordings, for `ingest --layout`."""
    return LAYOUT_HELP


KINDS = {
    "models": models,
    "environments": environments,
    "recipes": recipes,
    "experiments": all_experiments,
    "layouts": layouts,
}


def _first_line(path: Path) -> str:
    """What the comment at the top of a file says."""
    return path.read_text(encoding="utf-8").split("\n", 1)[0].strip("# .,")
