"""Models by name: each predicts particles after strokes, `predict(positions [B, N, 3], strokes [B, 7]) -> [B, N, 3]`."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from piegraph_cli.dynamics.action import check_strokes
from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.params import PredictionParams
from piegraph_cli.physics.rigid import rigid_projection
from piegraph_cli.physics.spring_kernel import guide
from piegraph_cli.physics.springs import build_springs

Predict = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
Correct = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class Model:
    """A row of the table: what is done with the network's prediction, if it is asked at all."""

    help: str
    network: bool
    correction: Callable[[torch.Tensor, PredictionParams], Correct] | None = None
    """Given the rest state [N, 3], makes the function (state, setpoint) -> prediction, all [B, N, 3]."""


def _guided(rest: torch.Tensor, params: PredictionParams) -> Correct:
    graph = build_springs(rest.cpu().numpy(), params.spring_radius)
    return lambda positions, setpoint: guide(positions, setpoint, graph, params)


def _rigid(rest: torch.Tensor, params: PredictionParams) -> Correct:
    return lambda positions, setpoint: rigid_projection(rest, setpoint)


MODELS: dict[str, Model] = {
    "piegraph": Model("the network's prediction, kept physical by springs it guides", True, _guided),
    "piegraph-ng": Model("the network alone, no guidance", True),
    "kabsch": Model("the network's prediction, made rigid: an oracle for rigid objects", True, _rigid),
    "static": Model("nothing moves: the floor of every comparison", False),
}


def make_predict(name: str, network: EGNN | None, rest: torch.Tensor, params: PredictionParams) -> Predict:
    """The predict function of a model for one object, whose rest state [N, 3] (m) gives springs and neighbours.

    One neighbour list serves every prediction: it is cheaper than a new one per state, and more accurate over several
    strokes, since layers of a folded object do not connect.
    """
    model = MODELS[name]
    if not model.network:
        return lambda positions, strokes: positions
    assert network is not None
    move = NetworkKernel(network, Rest.of(rest[None], network.neighbors))
    correct = model.correction(rest, params) if model.correction else None

    def predict(positions: torch.Tensor, strokes: torch.Tensor) -> torch.Tensor:
        check_strokes(strokes)
        setpoint = move(positions, strokes)
        return correct(positions, setpoint) if correct else setpoint

    return predict
