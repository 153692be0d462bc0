"""Simulated environments behind one interface (gymnasium), and the virtual camera rig that records them.

Nothing else in piegraph imports this package for a prediction: a model that has seen the simulator has cheated.
"""

from importlib import import_module

from piegraph_cli.errors import MissingError, UsageError

ENVIRONMENTS = {"tblock": "piegraph_cli.environments.tblock:TBlock"}
"""Name to "module:Class"; each class is a gymnasium.Env with the methods of `tblock.TBlock`."""


def make(name: str, **options):
    """Build the environment of that name; `options` go to its class.

    Raises UsageError for an unknown name and MissingError where the `sim` extra is not installed.
    """
    if name not in ENVIRONMENTS:
        raise UsageError(f"no environment named {name!r}", hint=f"one of: {', '.join(sorted(ENVIRONMENTS))}")
    module, _, cls = ENVIRONMENTS[name].partition(":")
    return getattr(import_extra(module), cls)(**options)


def import_extra(module: str):
    """Import a module that is part of, or needs, the `sim` extra; MissingError names the pip command otherwise."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("piegraph_cli"):
            raise
        raise MissingError(f"the package {error.name} is not installed", hint="pip install 'piegraph[sim]'") from None
