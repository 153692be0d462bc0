"""Models by name: each predicts particles after strokes, `predict(positions [B, N, 3], strokes [B]) -> [B, N, 3]`."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from piegraph_cli.dynamics import gbnd, pgnd, sms
from piegraph_cli.dynamics.ablations import GNN, ActionNodeEGNN
from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.examples import Pairs, Sequences, Windows, finer
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.dynamics.params import (
    TRAINED_AS,
    EGNNParams,
    FittedParams,
    GBNDParams,
    GraphParams,
    PGNDParams,
    PredictionParams,
    RigidParams,
    SMSParams,
    StepParams,
    split_label,
)
from piegraph_cli.dynamics.reliability import Calibration, signs_of
from piegraph_cli.dynamics.rigid_body import RigidBody, body_frame
from piegraph_cli.dynamics.rigid_residual import RigidResidual
from piegraph_cli.dynamics.spring_fit import SMS
from piegraph_cli.dynamics.stroke import Foresee, Predict, Spread, Strokes
from piegraph_cli.dynamics.training import Examples
from piegraph_cli.physics import spring_kernel
from piegraph_cli.physics.particles import Sizes
from piegraph_cli.physics.rigid import rigid_projection
from piegraph_cli.physics.springs import build_springs

Correct = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]

CHUNK = 64
"""Scenes that a network in PyTorch predicts together, so that its arrays stay in the cache."""

FRAME_CHUNK = 16
"""The same for one that predicts frame by frame, whose arrays are larger: a row for every node or edge."""


SHORTEST = 1e-3
"""Of a step that a model by frames goes at the end of a stroke, as a share of the others: less is rounding."""


@dataclass(frozen=True)
class Trained:
    """What a model has learned."""

    network: nn.Module
    settings: FittedParams
    pace: float
    """Metres that the hand moved between two frames of the training data."""
    modes: tuple[int, ...]
    """Of the strokes it was trained on: 0 push, 1 pick."""
    particles: int
    """Of the objects it was trained on."""
    rest: np.ndarray | None = None
    """[N, 3] metres: such an object before its first stroke; None where it is not known."""
    sizes: Sizes | None = None
    """How large it was, in all states that were seen."""
    calibration: Calibration | None = None
    """What errors to expect of its predictions; None where that was not measured."""


@dataclass(frozen=True)
class Learner:
    """How a model that is trained comes about: its network, its examples, and how the network predicts a stroke."""

    network: Callable[[Any, bool], nn.Module]
    """From its settings, and whether there are picks in the data."""
    examples: Callable[[Sequences, Any, str], Examples] | None
    """From training sequences and settings, on a device; None for what fits itself."""
    predict: Callable[[Trained, torch.Tensor], Predict]
    """For an object at rest [N, 3] (m)."""


@dataclass(frozen=True)
class Model:
    """A row of the table: what is learned, and what is done with the prediction."""

    learner: Learner | None = None
    """None for a model that is not trained itself: see `dynamics.params.TRAINED_AS`."""
    correction: Callable[[torch.Tensor, PredictionParams], Correct] | None = None
    """Given the rest state [N, 3], makes the function (state, setpoint) -> prediction, all [B, N, 3]."""


def _pairs(mirror: bool, turn: bool) -> Callable[[Sequences, GraphParams, str], Pairs]:
    """Pairs for a network, mirrored where the settings say so and turned: what it is not equivariant to by itself."""

    def examples(data: Sequences, params: GraphParams, device: str) -> Pairs:
        settings = {"shape_weight": params.shape_weight, "mirror": mirror and params.mirror, "turn": turn}
        return Pairs.of(data, params.neighbors, device, **settings)

    return examples


def _in_kernel(trained: Trained, rest: torch.Tensor) -> Predict:
    network = trained.network
    assert isinstance(network, EGNN)
    return NetworkKernel(network, Rest.of(rest[None], network.neighbors))


def _in_torch(trained: Trained, rest: torch.Tensor) -> Predict:
    network = trained.network
    at_rest = Rest.of(rest[None], network.neighbors)  # type: ignore[arg-type]

    @torch.inference_mode()
    def predict(positions: torch.Tensor, strokes: Strokes) -> torch.Tensor:
        chunks = zip(positions.split(CHUNK), strokes.split(CHUNK), strict=True)
        return torch.cat([network(x, stroke, at_rest.expand(len(x))) for x, stroke in chunks])

    return predict


def _frame_by_frame(trained: Trained, rest: torch.Tensor) -> Predict:
    """The object rests before a stroke; the hand goes as in the training data, and waits where it ends."""
    settings = trained.settings
    assert isinstance(settings, StepParams)
    pace = min(trained.pace, settings.step)

    def roll(x: torch.Tensor, strokes: Strokes) -> torch.Tensor:
        """Of strokes of which none is longer than those before it: those that still move come first."""
        start, along, length = strokes.planar.start, strokes.along, strokes.length[:, None]
        past, hand, x = x[:, None].expand(-1, settings.frames, -1, -1), start, x.clone()
        for k in range(1, math.ceil(float(length.max()) / pace) + 1):
            moving = int((length > (k - 1 + SHORTEST) * pace).sum())
            if moving == 0:
                break
            after = start + along / length * torch.minimum(length, length.new_tensor(k * pace))
            past, hand, after = past[:moving], hand[:moving], after[:moving]
            x[:moving] = trained.network.step(past, hand, after, strokes.mode[:moving])  # type: ignore[operator]
            past, hand = torch.cat([past[:, 1:], x[:moving, None]], 1), after
        return x

    @torch.inference_mode()
    def predict(positions: torch.Tensor, strokes: Strokes) -> torch.Tensor:
        order = strokes.length.argsort(descending=True)
        chunks = zip(positions[order].split(FRAME_CHUNK), strokes[order].split(FRAME_CHUNK), strict=True)
        return torch.cat([roll(x, stroke) for x, stroke in chunks])[order.argsort()]

    return predict


def _springs_alone(trained: Trained, rest: torch.Tensor) -> Predict:
    springs = trained.network
    assert isinstance(springs, SMS)
    return springs.predict(rest.cpu().numpy())


def _springs_as_given(rest: torch.Tensor, params: PredictionParams) -> Predict:
    graph = sms.object_springs(rest.cpu().numpy(), sms.RADIUS)
    given = sms.as_given(graph, params.tension_only)
    return lambda positions, strokes: sms.moved(positions, strokes, graph, given, sms.AS_GIVEN_STRIDE)


def _pushed(trained: Trained, rest: torch.Tensor) -> Predict:
    body = trained.network
    assert isinstance(body, RigidBody)
    frame = body_frame(rest.cpu().numpy(), body.shape.cpu().numpy())
    return lambda positions, strokes: body.predict(positions, strokes, rest, frame)


def _spread(trained: Trained | None, rest: torch.Tensor) -> Spread | None:
    """How far apart the ends lie that its strokes leave possible, of what is fitted; None for what springs correct."""
    network = None if trained is None else trained.network
    if isinstance(network, SMS):
        return network.spread(rest.cpu().numpy())
    if not isinstance(network, RigidBody):
        return None
    frame = body_frame(rest.cpu().numpy(), network.shape.cpu().numpy())
    return lambda positions, strokes, _: network.spread(positions, strokes, rest, frame)


def _guided(rest: torch.Tensor, params: PredictionParams) -> Correct:
    graph = build_springs(rest.cpu().numpy(), params.spring_radius)
    return lambda positions, setpoint: spring_kernel.guide(positions, setpoint, graph, params)


def _rigid(rest: torch.Tensor, params: PredictionParams) -> Correct:
    return lambda positions, setpoint: rigid_projection(rest, setpoint)


def _egnn(params: EGNNParams, picks: bool) -> EGNN:
    return EGNN(params.neighbors, params.hidden, params.layers, params.action_head, picks, params.pool, params.mirror)


def _gnn(params: GraphParams, picks: bool) -> GNN:
    return GNN(params.neighbors, params.hidden, params.layers, picks, params.pool)


def _pgnd(params: PGNDParams, picks: bool) -> pgnd.PGND:
    return pgnd.PGND(params)


def _gbnd(params: GBNDParams, picks: bool) -> gbnd.GBND:
    return gbnd.GBND(params)


def _rigid_body(params: RigidParams, picks: bool) -> RigidBody:
    return RigidBody(params)


def _rigid_residual(params: RigidParams, picks: bool) -> RigidResidual:
    return RigidResidual(params)


def _springs(params: SMSParams, picks: bool) -> SMS:
    return SMS(params)


def _windows(data: Sequences, params: StepParams, device: str) -> Windows:
    fine, before = finer(data, params.step), params.frames - 1
    return Windows(fine, before, params.rollout, device, noise=params.noise, turn=params.turn)


_ACTION_NODES = Learner(
    lambda params, picks: ActionNodeEGNN(params.neighbors, params.hidden, params.layers, picks, params.pool),
    _pairs(mirror=True, turn=False),
    _in_torch,
)

MODELS: dict[str, Model] = {
    "piegraph": Model(Learner(_egnn, _pairs(mirror=False, turn=False), _in_kernel), _guided),
    "piegraph-ng": Model(),
    "kabsch": Model(correction=_rigid),
    "egnn-g": Model(_ACTION_NODES, _guided),
    "gnn": Model(Learner(_gnn, _pairs(mirror=True, turn=False), _in_torch)),
    "gnn-aug": Model(Learner(_gnn, _pairs(mirror=True, turn=True), _in_torch)),
    "sms-no": Model(),
    "sms-o": Model(Learner(_springs, None, _springs_alone)),
    "pgnd": Model(Learner(_pgnd, _windows, _frame_by_frame)),
    "gbnd": Model(Learner(_gbnd, _windows, _frame_by_frame)),
    "rigid": Model(Learner(_rigid_body, None, _pushed)),
    "rigid-gp": Model(Learner(_rigid_residual, None, _pushed)),
    "static": Model(),
}
"""What they are, in words: `dynamics.params.MODEL_HELP`."""


def recordable(name: str) -> bool:
    """Whether a GPU can record the model's predictions: nothing in them waits for a result, or depends on values."""
    name = split_label(name)[0]
    owner = TRAINED_AS.get(name, name)
    learner = MODELS[owner].learner if owner else None
    return learner is not None and learner.predict is _in_kernel and MODELS[name].correction in (None, _guided)


def make_predict(name: str, trained: Trained | None, rest: torch.Tensor, params: PredictionParams) -> Predict:
    """The predict function of a model for one object, whose rest state [N, 3] (m) gives springs and neighbours.

    One neighbour list serves every prediction of a graph network: it is cheaper than a new one per state, and more accurate
    over several strokes, since layers of a folded object do not connect. `name` may end in @ and a number of sequences.
    """
    foresee = make_foresee(name, trained, rest, params, spread=False)
    return lambda positions, strokes: foresee(positions, strokes)[0]


def make_foresee(
    name: str, trained: Trained | None, rest: torch.Tensor, params: PredictionParams, spread: bool = True
) -> Foresee:
    """As `make_predict`, beside the signs of how far off a prediction may be.

    Without `spread`, which nobody needs who knows no `Calibration`, what is fitted is not predicted by other numbers too.
    """
    name = split_label(name)[0]
    if name == "static":
        return sure(lambda positions, strokes: positions)
    move, correction = _move(name, trained, rest, params), MODELS[name].correction
    correct = correction(rest, params) if correction else None
    apart = _spread(trained, rest) if spread else None

    def foresee(positions: torch.Tensor, strokes: Strokes) -> tuple[torch.Tensor, torch.Tensor]:
        strokes.check()
        setpoint = move(positions, strokes)
        after = correct(positions, setpoint) if correct else setpoint
        signs = signs_of(positions, setpoint, after)
        if apart is not None:
            signs[:, 1] = apart(positions, strokes, after)
        return after, signs

    return foresee


def sure(predict: Predict) -> Foresee:
    """Predictions without a sign that any may be off."""
    return lambda positions, strokes: (predict(positions, strokes), positions.new_zeros(len(positions), 2))


def _move(name: str, trained: Trained | None, rest: torch.Tensor, params: PredictionParams) -> Predict:
    """What one network, or springs alone, predict: before any correction."""
    if name == "sms-no":
        return _springs_as_given(rest, params)
    learner = MODELS[str(TRAINED_AS.get(name, name))].learner
    assert learner is not None
    assert trained is not None
    trained.network.to(rest.device)
    return learner.predict(trained, rest)


def make_network(name: str, settings: FittedParams, picks: bool, seed: int) -> nn.Module:
    """A network with fresh weights, drawn from the seed; `picks` where the data has picks."""
    torch.manual_seed(seed)
    learner = MODELS[name].learner
    assert learner is not None
    return learner.network(settings, picks)
