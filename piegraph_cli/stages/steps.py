"""What `plan` and `trials` share: the environment they act in."""

from typing import Any

from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.stages.simulate import make_environment


def open_environment(params: PlanParams, model: Model) -> Any:
    """The environment `params.env`, with as many particles as the model was trained on."""
    return make_environment(str(params.env), model.particles, params)
