"""Every row of the table of models does what its name says: which network, which correction, which examples, which rest.

Each prediction is put together a second time from its parts, by the references in PyTorch instead of the kernels.
"""

import math
from itertools import combinations
from typing import Any

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics import gbnd, pgnd, sms
from piegraph_cli.dynamics.ablations import GNN, ActionNodeEGNN
from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.examples import Pairs, Sequences, Windows
from piegraph_cli.dynamics.models import MODELS, Trained, make_network, make_predict
from piegraph_cli.dynamics.params import BY_GRADIENT, LEARNED, TRAINED_AS, PredictionParams
from piegraph_cli.dynamics.rigid_body import RigidBody
from piegraph_cli.dynamics.spring_fit import SMS, springs_of
from piegraph_cli.errors import DataError
from piegraph_cli.physics import pushing, simulation
from piegraph_cli.physics.rigid import rigid_projection
from piegraph_cli.physics.springs import build_springs, stability_bound
from tests import strokes as of_strokes

PARTICLES, BATCH = 20, 3
REST = torch.as_tensor(
    np.concatenate([np.random.default_rng(2).uniform(-0.1, 0.1, (PARTICLES, 2)), np.full((PARTICLES, 1), 0.005)], 1)
).float()
NOW = REST.flip(0) * torch.tensor([0.7, 1.2, 1.0]) + torch.tensor([0.02, 0.01, 0.0])
"""The object as it is before the strokes: of another shape, with other neighbours, than at rest."""
TINY = {"hidden": 8, "layers": 2, "neighbors": 4}
SETTINGS: dict[str, dict] = dict.fromkeys(("piegraph", "egnn-g", "gnn", "gnn-aug"), TINY) | {"gbnd": {"hidden": 16}}
NETWORKS = {
    "piegraph": EGNN,
    "egnn-g": ActionNodeEGNN,
    "gnn": GNN,
    "gnn-aug": GNN,
    "pgnd": pgnd.PGND,
    "gbnd": gbnd.GBND,
}
SPRINGS = torch.tensor([0.3, 2.5, 5e-5, 0.015, 0.4, 0.03])
"""Numbers of springs, as they are fitted."""
GUIDED, RIGID = ("piegraph", "egnn-g"), ("kabsch",)
PACE = 0.012


def strokes(pick: bool = False, held: bool = False) -> Any:
    """Strokes of 3, 5 and 7 cm over the object."""
    start = torch.tensor([[-0.08, 0.0], [0.0, -0.1], [0.05, 0.06]])
    angle, length = torch.tensor([0.2, 1.4, -2.0]), torch.tensor([0.03, 0.05, 0.07])
    end = start + torch.stack([angle.cos(), angle.sin()], 1) * length[:, None]
    return of_strokes.make(start, end, int(pick), torch.full((BATCH, 2), held))


def settings_of(name: str, **changes):
    return LEARNED[name](**SETTINGS.get(name, {}) | changes)


def trained(name: str, picks: bool = False, **changes) -> Trained:
    """A network whose weights are far enough from their start for all of it to matter."""
    settings = settings_of(name, **changes)
    network = make_network(name, settings, picks, 0)
    if isinstance(network, RigidBody):
        network.fit(one_sequence())
    if isinstance(network, SMS):
        network.span, network.numbers = torch.tensor(0.3), SPRINGS
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_((0.01 if name == "pgnd" else 0.05) * torch.randn(parameter.shape, generator=generator))
    return Trained(network.eval().requires_grad_(False), settings, PACE, (0, 1) if picks else (0,), PARTICLES)


def owner(name: str) -> str | None:
    return TRAINED_AS.get(name, name)


def predict(
    name: str, rest: torch.Tensor = REST, picks: bool = False, now: torch.Tensor = NOW, **settings
) -> torch.Tensor:
    own = owner(name)
    params = PredictionParams(**settings)
    model = make_predict(name, trained(own, picks) if own else None, rest, params)
    return model(now.expand(BATCH, -1, -1).clone(), strokes(picks))


def alone(name: str, rest: torch.Tensor = REST, picks: bool = False, now: torch.Tensor = NOW) -> torch.Tensor:
    """What the network of a model predicts, by itself."""
    network, moves = trained(name, picks).network, strokes(picks)
    now = now.expand(BATCH, -1, -1).clone()
    if isinstance(network, SMS):
        graph = springs_of(rest.numpy(), float(network.span))
        return swept(now, moves, graph, sms.push_params(graph, SPRINGS[:5]), sms.STRIDE, float(SPRINGS[5]))
    if isinstance(network, (pgnd.PGND, gbnd.GBND)):
        return torch.cat([step_by_step(network, now[k : k + 1], moves[k]) for k in range(BATCH)])
    at_rest = Rest.of(rest[None], network.neighbors).expand(BATCH)
    return network(now, moves, at_rest)


def swept(now: torch.Tensor, moves: Any, graph, params: pushing.PushParams, stride: float, hold: float) -> torch.Tensor:
    """Springs under strokes, by the reference."""
    held = sms.held_particles(now, moves, torch.tensor(hold))
    picks = bool(held.any())
    return pushing.push(now, sms.stroke_path(moves, stride, params.settle), graph, params, held if picks else None)


def step_by_step(network, x: torch.Tensor, stroke: Any) -> torch.Tensor:
    """One scene, frame by frame, the hand at the pace of data or settings, and no step after its last, shorter one."""
    start, end = of_strokes.start(stroke), of_strokes.end(stroke)
    length, pace = float((end - start).norm()), min(PACE, network.params.step)
    past = [x] * network.params.frames
    for k in range(math.ceil(length / pace - 1e-3)):
        here, there = (start + (end - start) * min(1.0, step * pace / length) for step in (k, k + 1))
        past = [*past[1:], network.step(torch.stack(past, 1), here[None], there[None], stroke.mode[None])]
    return past[-1]


def guided(setpoint: torch.Tensor, now: torch.Tensor = NOW, **settings) -> torch.Tensor:
    params = PredictionParams(**settings)
    graph = build_springs(REST.numpy(), params.spring_radius)
    return simulation.guide(now.expand(BATCH, -1, -1), setpoint, graph, params)


def close(found: torch.Tensor, expected: torch.Tensor, within: float = 2e-5) -> None:
    torch.testing.assert_close(found, expected, atol=within, rtol=0)


def apart(one: torch.Tensor, other: torch.Tensor) -> float:
    """Largest distance (m) between particles of two predictions."""
    return float((one - other).norm(dim=-1).max())


@pytest.mark.parametrize("name", NETWORKS)
def test_every_model_has_its_network(name):
    assert type(trained(name).network) is NETWORKS[name]
    assert set(NETWORKS) == set(BY_GRADIENT)


@pytest.mark.parametrize("picks", [False, True])
@pytest.mark.parametrize("name", ["piegraph-ng", "gnn", "gnn-aug", "sms-o", "pgnd", "gbnd"])
def test_an_unguided_model_is_its_network_alone(name, picks):
    found = predict(name, picks=picks)
    close(found, alone(str(owner(name)), picks=picks))
    assert apart(found, NOW) > 1e-3, "it moves something"


@pytest.mark.parametrize("picks", [False, True])
@pytest.mark.parametrize("name", GUIDED)
def test_a_guided_model_is_its_network_drawn_back_by_springs(name, picks):
    found, network = predict(name, picks=picks), alone(name, picks=picks)
    close(found, guided(network))
    assert apart(found, network) > 1e-3, "guidance does something"


def test_kabsch_is_the_same_network_made_rigid():
    found = predict("kabsch")
    close(found, rigid_projection(REST, alone("piegraph")))
    close(torch.cdist(found, found), torch.cdist(REST, REST).expand(BATCH, -1, -1), 1e-4)
    assert apart(predict("piegraph"), found) > 1e-3


def test_springs_as_given_are_of_8_cm_at_a_millimetre_an_iteration():
    """`sms-no` takes nothing from settings but whether springs only pull."""
    graph = sms.object_springs(REST.numpy(), 0.08)
    for tension_only in (False, True):
        bound = sms.STABLE * stability_bound(graph, 0.9)
        params = pushing.PushParams(min(0.1, bound), 0.9, 5e-5, 0.015, 0.4, tension_only, 20)
        expected = swept(NOW.expand(BATCH, -1, -1), strokes(), graph, params, 1e-3, 0.02)
        close(predict("sms-no", tension_only=tension_only), expected, 2e-3)
    assert apart(predict("sms-no", tension_only=True), predict("sms-no")) > 1e-3


def test_static_is_what_was_there():
    assert torch.equal(predict("static"), NOW.expand(BATCH, -1, -1))


def test_no_two_models_are_one():
    """But `gnn-aug` and `gnn`, `rigid-gp` and `rigid`, which differ in what they learn from alone, and in what they learn."""
    found = {name: predict(name) for name in MODELS if name not in ("gnn-aug", "rigid-gp")}
    for one, other in combinations(found, 2):
        assert apart(found[one], found[other]) > 5e-4, (one, other)
    assert torch.equal(predict("gnn-aug"), found["gnn"])
    assert torch.equal(predict("rigid-gp"), found["rigid"])


CHANGES = {
    "stiffness": 0.02,
    "gain": 0.2,
    "damping": 0.4,
    "integral": 1e-3,
    "derivative": 0.3,
    "friction": 5.0,
    "tension_only": True,
    "iterations": 7,
    "tolerance": 1e-3,
    "spring_radius": 0.02,
}


@pytest.mark.parametrize("name", ["piegraph", "egnn-g", "piegraph-ng", "kabsch"])
@pytest.mark.parametrize("field", [*CHANGES, "integral_limit"])
def test_every_setting_of_the_guidance_reaches_guided_models_and_no_others(field, name):
    assert {*CHANGES, "integral_limit"} == set(PredictionParams.model_fields)
    base = {"integral": 1e-3, "iterations": 60} if field == "integral_limit" else {}
    changed = base | {field: CHANGES.get(field, 1e-4)}
    low = NOW - torch.tensor([0.0, 0.0, 0.004])  # friction needs particles on the table
    found = [predict(name, now=low, **settings) for settings in (base, changed)]
    if name in GUIDED:
        assert apart(*found) > 1e-6
        close(found[1], guided(alone(name, now=low), low, **changed), 5e-5)
    else:
        assert torch.equal(*found)


def test_springs_and_neighbours_are_those_at_rest_not_those_of_the_moment():
    for name in ("piegraph", "piegraph-ng", "egnn-g", "gnn", "kabsch", "sms-o"):
        assert apart(predict(name, REST), predict(name, NOW)) > 1e-4, name
    for name in ("pgnd", "gbnd", "static"):
        assert apart(predict(name, REST), predict(name, NOW)) == 0, name


@pytest.mark.parametrize("name", ["piegraph", "egnn-g", "gnn"])
def test_where_there_are_picks_the_network_sees_them(name):
    own = str(owner(name))
    with_picks, without = (trained(own, picks) for picks in (True, False))
    assert with_picks.network.embed.in_features == without.network.embed.in_features + 5
    carried = strokes(True)
    at_rest = Rest.of(REST[None], 4).expand(BATCH)
    now = NOW.expand(BATCH, -1, -1)
    whole, going_on = (with_picks.network(now, s, at_rest) for s in (carried, strokes(True, held=True)))
    assert apart(whole, going_on) > 1e-3, "whether it is held at the stroke's ends matters"
    far = (NOW[None, :, :2] - of_strokes.start(carried)[:, None]).norm(dim=-1)
    assert apart(whole, with_picks.network(now, carried, at_rest, far.argmax(1))) > 1e-3, "what is held matters"
    assert torch.equal(whole, with_picks.network(now, carried, at_rest, far.argmin(1)))


def test_a_label_with_a_number_of_sequences_is_the_model_of_that_name():
    model = make_predict("kabsch@20", trained("piegraph"), REST, PredictionParams())
    close(model(NOW.expand(BATCH, -1, -1), strokes()), predict("kabsch"), 0)
    variant = make_predict("piegraph:wide@20", trained("piegraph"), REST, PredictionParams())
    close(variant(NOW.expand(BATCH, -1, -1), strokes()), predict("piegraph"), 0)


@pytest.mark.parametrize("name", [name for name in MODELS if name != "static"])
def test_a_stroke_without_heading_is_refused_by_every_model(name):
    own = owner(name)
    model = make_predict(name, trained(own) if own else None, REST, PredictionParams())
    start, end = of_strokes.start(strokes()), of_strokes.end(strokes()).clone()
    end[1] = start[1]
    with pytest.raises(DataError, match="no heading"):
        model(NOW.expand(BATCH, -1, -1), of_strokes.make(start, end, 0))


def one_sequence(picks: bool = False) -> Sequences:
    frames = 5
    path = np.array([[-0.1 + PACE * k, 0.01] for k in range(frames)], np.float32)
    positions = np.stack([REST.numpy() + np.array([0.01 * k, 0, 0], np.float32) for k in range(frames)])
    pairs = np.array([[0, 2], [0, 4], [1, 4]])
    owners = (np.array([[0, 4]]), np.array([int(picks)], np.uint8), np.array([0]))
    return Sequences(positions, path, *owners, REST.numpy()[None], pairs, np.zeros(3, np.int64))


@pytest.mark.parametrize(
    ("name", "mirror", "turn"),
    [("piegraph", False, False), ("egnn-g", True, False), ("gnn", True, False), ("gnn-aug", True, True)],
)
def test_pairs_are_varied_by_what_their_network_is_not_equivariant_to(name, mirror, turn):
    learner = MODELS[name].learner
    assert learner is not None
    assert learner.examples is not None
    for asked in (False, True):
        settings = settings_of(name, mirror=asked, shape_weight=0.7, neighbors=3)
        pairs = learner.examples(one_sequence(), settings, "cpu")
        assert isinstance(pairs, Pairs)
        assert (pairs.mirror, pairs.turn, pairs.shape_weight) == (mirror and asked, turn, 0.7)
        assert pairs.rest.neighbors.shape == (1, PARTICLES, 3)
        assert len(pairs) == 3


@pytest.mark.parametrize(
    ("name", "history", "frames"), [("pgnd", 2, 4), ("pgnd", 0, 2), ("gbnd", 0, 1), ("gbnd", 3, 4)]
)
def test_windows_are_as_long_as_their_network_looks_back_and_ahead(name, history, frames):
    learner = MODELS[name].learner
    assert learner is not None
    assert learner.examples is not None
    windows = learner.examples(
        one_sequence(), settings_of(name, history=history, rollout=2, noise=0.3, turn=False), "cpu"
    )
    assert isinstance(windows, Windows)
    assert windows.past.shape == (4, frames)
    assert windows.after.shape == (4, 3)
    assert (windows.noise, windows.turn) == (0.3, False)
    assert learner.examples(one_sequence(), settings_of(name, turn=True), "cpu").turn
