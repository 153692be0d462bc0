"""Simulated environments behind one interface (gymnasium), and the virtual camera rig that records them.

Nothing else in piegraph imports this package for a prediction: a model that has seen the simulator has cheated.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from pydantic import ValidationError

from piegraph_cli.environments import params
from piegraph_cli.errors import MissingError, UsageError
from piegraph_cli.params import Params


@dataclass(frozen=True)
class Entry:
    """One environment: its class as "module:Class", its options, and what else the class is made with."""

    target: str
    options: type[Params]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    memory: float = 0.0
    """Bytes that it takes in a process of its own; 0 where it has none."""


ENVIRONMENTS = {
    "tblock": Entry("tblock:TBlock", params.TBlockOptions),
    "rope-stiff": Entry("rope:Rope", params.RopeOptions),
    "rope-bendy": Entry("rope:Rope", params.BendyRopeOptions),
    "tshirt": Entry("cloth:Cloth", params.TShirtOptions, {"outline": "tshirt"}),
    "cloth": Entry("cloth:Cloth", params.ClothOptions, {"outline": "square"}),
    "toy": Entry("toy:Toy", params.ToyOptions),
    "daxbench-rope": Entry("daxbench:DaXBench", params.DaXBenchOptions, {"task": "rope"}, memory=3.1e9),
    "daxbench-tshirt": Entry("daxbench:DaXBench", params.DaXBenchOptions, {"task": "tshirt"}, memory=0.4e9),
}
"""Every environment by name; each class is a `base.Environment`."""


def make(name: str, particles: int = 50, options: Mapping[str, Any] | None = None):
    """Build the environment of that name.

    Raises UsageError for an unknown name or option, and MissingError where the `sim` extra is not installed.
    """
    if name not in ENVIRONMENTS:
        raise UsageError(f"no environment named {name!r}", hint=f"one of: {', '.join(sorted(ENVIRONMENTS))}")
    entry = ENVIRONMENTS[name]
    checked = check_options(name, options or {})
    module, _, cls = entry.target.partition(":")
    return getattr(import_extra(f"{__name__}.{module}"), cls)(particles, checked, **entry.fixed)


def check_options(name: str, options: Mapping[str, Any]) -> Params:
    """The validated options of an environment. Raises UsageError that lists what there is."""
    model = ENVIRONMENTS[name].options
    try:
        return model.model_validate(dict(options))
    except ValidationError as error:
        problem = error.errors()[0]
        known = "; ".join(f"{n}: {f.description}" for n, f in model.model_fields.items())
        raise UsageError(
            f"option {'.'.join(map(str, problem['loc']))}: {problem['msg']}", name, f"its options are {known}"
        ) from None


def import_extra(module: str):
    """Import a module that is part of, or needs, the `sim` extra; MissingError names the pip command otherwise."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("piegraph_cli"):
            raise
        raise MissingError(f"the package {error.name} is not installed", hint="pip install 'piegraph[sim]'") from None
