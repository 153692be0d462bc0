"""The table of models: one protocol, symmetries where a model has them, sparse against dense grids."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics import gbnd, pgnd, sms
from piegraph_cli.dynamics.examples import Pairs, Sequences, Windows, finer, move_in_plane, planar_motions
from piegraph_cli.dynamics.models import MODELS, Trained, make_network, make_predict
from piegraph_cli.dynamics.params import (
    BY_GRADIENT,
    LEARNED,
    TRAINED_AS,
    ModelName,
    PredictionParams,
    trained_label,
)
from piegraph_cli.dynamics.rigid_body import RigidBody
from piegraph_cli.dynamics.spring_fit import SMS
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.physics import simulation
from piegraph_cli.physics.springs import build_springs

SMALL = {"piegraph": {"hidden": 8, "layers": 2}, "pgnd": {"rollout": 2}, "gbnd": {"hidden": 16, "rollout": 2}}


def settings(name: str):
    graph = {"hidden": 8, "layers": 2} if name in ("egnn-g", "gnn", "gnn-aug") else {}
    return LEARNED[name](**SMALL.get(name, graph))


def sequences(picks: bool = False, seed: int = 0, particles: int = 24) -> Sequences:
    """Flat objects that a hand pushes or carries: what it takes along moves with it."""
    rng = np.random.default_rng(seed)
    positions, hand, strokes = [], [], []
    rest = np.concatenate([rng.uniform(-0.1, 0.1, (3, particles, 2)), np.full((3, particles, 1), 0.005)], -1)
    for index in range(3):
        state, frames = rest[index], 6
        angle = rng.uniform(-math.pi, math.pi)
        along = np.array([math.cos(angle), math.sin(angle)])
        begin = state[0, :2] if picks else state[:, :2].mean(0) - 0.12 * along
        path = begin + np.arange(frames)[:, None] * 0.015 * along
        strokes.append([len(hand), len(hand) + frames - 1])
        hand += list(path)
        positions += [state + np.append(max(k - 1, 0) * 0.01 * along, 0) for k in range(frames)]
    pairs = [[a + i, a + j] for a, b in strokes for i in range(6) for j in range(i + 2, 6)]
    return Sequences(
        positions=np.array(positions, np.float32),
        hand=np.array(hand, np.float32),
        strokes=np.array(strokes),
        mode=np.full(3, int(picks), np.uint8),
        owner=np.arange(3),
        rest=rest.astype(np.float32),
        pairs=np.array(pairs),
        pair_stroke=np.repeat(np.arange(3), len(pairs) // 3),
    )


def untrained(name: str, data: Sequences, seed: int = 0, **changes) -> Trained:
    params = settings(name).model_copy(update=changes)
    network = make_network(name, params, data.picks, seed)
    if isinstance(network, RigidBody):
        network.fit(data)
    if isinstance(network, SMS):
        network.span, network.numbers = torch.tensor(0.3), torch.tensor([0.3, 2.5, 5e-5, 0.015, 0.4, 0.03])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(3)))
    modes = tuple(np.unique(data.mode).tolist())
    return Trained(network.eval().requires_grad_(False), params, data.pace, modes, data.positions.shape[1])


def predictor(name: str, data: Sequences):
    own = trained_label(name)
    params = PredictionParams(tension_only=data.picks)
    return make_predict(name, untrained(own, data) if own else None, torch.as_tensor(data.rest[0]), params)


def scenes(data: Sequences, batch: int = 5) -> tuple[torch.Tensor, Strokes]:
    start = torch.as_tensor(data.rest[:1]).expand(batch, -1, -1).clone()
    stroke = data.whole()[[0] * batch]
    end = stroke.start + stroke.along * torch.linspace(0.5, 1.5, batch)[:, None]
    return start, replace(stroke, end=end)


def test_the_table_is_whole():
    assert set(MODELS) == set(ModelName.__args__)
    assert {name for name, model in MODELS.items() if model.learner} == set(LEARNED)
    assert all(trained_label(name) in (None, *LEARNED) for name in MODELS)
    assert set(TRAINED_AS) == set(MODELS) - set(LEARNED) | {"greedy"}


@pytest.mark.parametrize(
    ("name", "picks"),
    [(name, picks) for name in MODELS for picks in (False, True) if not (picks and name.startswith("rigid"))],
)
def test_one_protocol(name, picks):
    """Finite, of the same shape, one candidate like many, and the input stays."""
    data = sequences(picks)
    predict, (start, strokes) = predictor(name, data), scenes(data)
    kept = start.clone()
    after = predict(start, strokes)
    assert after.shape == start.shape
    assert after.dtype == torch.float32
    assert torch.isfinite(after).all()
    assert torch.equal(start, kept)
    assert (name == "static") == torch.equal(after, start)
    torch.testing.assert_close(predict(start[1:2], strokes[1:2]), after[1:2], atol=2e-5, rtol=0)


@pytest.mark.parametrize("name", [name for name in MODELS if name not in ("gnn", "gnn-aug", "pgnd", "gbnd")])
def test_equivariant_models_turn_with_the_scene(name):
    data = sequences()
    start, strokes = scenes(data)
    motion = planar_motions(np.random.default_rng(1), 1, False, True).float()
    turned = Sequences(
        **{**vars(data), "rest": move_in_plane(torch.as_tensor(data.rest), motion.expand(3, -1, -1)).numpy()}
    )
    many = motion.expand(len(start), -1, -1)
    found = predictor(name, turned)(move_in_plane(start, many), strokes.moved(motion))
    # a pusher that sticks or slides by the last bit of a number
    within = 5e-4 if name.startswith("rigid") else 2e-5
    torch.testing.assert_close(found, move_in_plane(predictor(name, data)(start, strokes), many), atol=within, rtol=0)


@pytest.mark.parametrize("name", ["gnn", "pgnd", "gbnd"])
def test_others_do_not_turn_but_move_with_the_scene(name):
    data = sequences()
    start, strokes = scenes(data)
    shift = torch.tensor([0.1, -0.06])
    moved = Sequences(**{**vars(data), "rest": data.rest + np.append(shift.numpy(), 0).astype(np.float32)})
    found = predictor(name, moved)(start + torch.nn.functional.pad(shift, (0, 1)), strokes.moved(torch.eye(2), shift))
    expected = predictor(name, data)(start, strokes) + torch.nn.functional.pad(shift, (0, 1))
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("name", BY_GRADIENT)
def test_every_trained_model_learns_and_goes_on_from_its_state(name):
    data = sequences()
    steps = 200
    rate = {"steps": steps, "batch": 3, "learning_rate": 5e-3}
    rate |= {"turn": False, "noise": 0.0} if name in ("pgnd", "gbnd") else {}
    rate |= {"history": 3} if name == "gbnd" else {}  # what is carried along out of its reach shows in the past alone
    params = settings(name).model_copy(update=rate)
    learner = MODELS[name].learner
    assert learner is not None

    def trainer() -> Trainer:
        return Trainer(make_network(name, params, False, 0), learner.examples(data, params, "cpu"), None, params, 0)

    def error(one: Trainer) -> float:
        every = torch.arange(len(one.examples))
        with torch.no_grad():
            return float(one.examples.loss(one.network, every))

    whole, half, resumed = trainer(), trainer(), trainer()
    first = error(whole)
    for _ in range(12):
        whole.step()
    for _ in range(8):
        half.step()
    resumed.load(half.state())
    for _ in range(4):
        resumed.step()
    for parameter, expected in zip(resumed.network.parameters(), whole.network.parameters(), strict=True):
        assert torch.equal(parameter, expected)
    for _ in range(12, steps):
        whole.step()
    assert error(whole) < 0.8 * first


def test_windows_begin_at_rest_and_end_with_their_stroke():
    data = sequences()
    windows = Windows(data, history=3, rollout=4)
    first, last = data.strokes[0]
    assert windows.past[0].tolist() == [first] * 4
    assert windows.past[2].tolist() == [first, first, first + 1, first + 2]
    assert windows.valid[0].tolist() == [True] * 4
    final = last - first - 1
    assert windows.valid[final].tolist() == [True, False, False, False]
    assert windows.after[final].tolist() == [last - 1, last, last, last, last]
    assert len(windows) == sum(b - a for a, b in data.strokes)


def test_turned_pairs_are_the_same_physics():
    """A rotation of the whole scene leaves an equivariant network's loss alone; the plain one sees other data."""
    data = sequences()
    losses = {}
    for name in ("piegraph", "gnn"):
        network = untrained(name, data).network
        pairs = Pairs.of(data, 12, turn=True)
        chosen = torch.arange(len(pairs))
        losses[name] = [float(pairs.loss(network, chosen, rng)) for rng in (None, np.random.default_rng(0))]
    assert losses["piegraph"][0] == pytest.approx(losses["piegraph"][1], rel=1e-4)
    assert abs(losses["gnn"][0] / losses["gnn"][1] - 1) > 1e-3


@pytest.mark.parametrize("mode", [PUSH, PICK])
def test_the_sparse_grid_is_the_dense_one(mode, monkeypatch):
    data = sequences()
    network = untrained("pgnd", data).network.double()
    past = torch.as_tensor(data.positions[[0, 0, 1, 2, 6, 7, 8, 9]]).double().view(2, 4, -1, 3)
    hand = torch.as_tensor(data.hand[[2, 9]]).double()
    after, modes = hand + torch.tensor([0.012, -0.004]), torch.tensor([mode, mode])
    axis = torch.arange(pgnd.NODES)
    nodes = torch.cartesian_prod(axis, axis, axis)

    def every(touched: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        place = (touched[..., 0] * pgnd.NODES + touched[..., 1]) * pgnd.NODES + touched[..., 2]
        return nodes[None].expand(len(touched), -1, -1), place

    with torch.no_grad():
        sparse = network.step(past, hand, after, modes)
        monkeypatch.setattr(pgnd, "active_nodes", every)
        dense = network.step(past, hand, after, modes)
    assert float((sparse - past[:, -1]).norm(dim=-1).max()) > 1e-3
    torch.testing.assert_close(sparse, dense, atol=1e-12, rtol=0)


def test_the_stencil_is_a_partition_of_unity_and_reproduces_places():
    points = torch.rand(40, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    nodes, weights = pgnd.stencil(points, 0.02)
    torch.testing.assert_close(weights.sum(-1), torch.ones(40, dtype=torch.float64))
    torch.testing.assert_close((weights[..., None] * nodes * 0.02).sum(1), points)


def test_nodes_at_a_hand_that_holds_move_with_it_and_nothing_flows_into_the_table():
    data = sequences()
    network = untrained("pgnd", data).network
    with torch.no_grad():
        network.decode[-1].bias += torch.tensor([0.0, 0.0, -5.0])
    nodes = torch.tensor([[[25, 25, 5], [25, 25, pgnd.WALL], [45, 25, 15]]])
    x, centre = torch.full((1, 8, 3), 0.5), torch.tensor([[0.5, 0.5, 0.0]])
    counts, features = torch.ones(1, 8, dtype=torch.bool), torch.zeros(1, 8, 64)

    def velocity(holds: bool) -> torch.Tensor:
        tool = pgnd.Tool(torch.tensor([[0.5, 0.5]]), torch.tensor([[0.02, 0.0]]), torch.tensor([holds]))
        return network.field(nodes, x, counts, features, centre, tool)[0]

    torch.testing.assert_close(velocity(True)[0], torch.tensor([0.02 / pgnd.FRAME, 0.0, 0.0]))
    assert velocity(True)[1, 2] == 0
    assert velocity(True)[2, 2] < -1
    assert velocity(False)[0, 2] < -1, "a pusher drags nothing along"


def test_a_pusher_is_points_of_its_own_and_a_pick_has_none():
    network = untrained("pgnd", sequences()).network
    past = torch.rand(1, 4, 12, 3, generator=torch.Generator().manual_seed(0)) * 0.05
    here, there = torch.tensor([[0.08, 0.02]]), torch.tensor([[0.09, 0.02]])
    frames = network.pusher(here, there - here)
    assert frames.shape == (1, network.params.frames, pgnd.RING * len(pgnd.HEIGHTS), 3)
    torch.testing.assert_close(frames[0, -1, :, :2].mean(0), here[0])
    torch.testing.assert_close(frames[0, 1:, :, 0] - frames[0, :-1, :, 0], torch.full_like(frames[0, 1:, :, 0], 0.01))
    steps = {
        (mode, place): network.step(past, here + place, there + place, torch.tensor([mode]))
        for mode in (PUSH, PICK)
        for place in (0.0, 0.1)
    }
    assert not torch.allclose(steps[PUSH, 0.0], steps[PUSH, 0.1], atol=1e-6), "the network sees where it is"
    far = [network.step(past, here + d, there + d, torch.tensor([PICK])) for d in (0.5, 0.7)]
    torch.testing.assert_close(*far, atol=0, rtol=0)


def test_frames_between_are_on_straight_lines_and_no_step_is_long():
    data = sequences()
    fine = finer(data, 0.004)
    steps = [np.linalg.norm(np.diff(fine.hand[a : b + 1], axis=0), axis=1) for a, b in fine.strokes]
    assert max(step.max() for step in steps) <= 0.004 * 1.5
    assert len(fine.positions) > 2 * len(data.positions)
    for (a, b), (c, d) in zip(data.strokes, fine.strokes, strict=True):
        np.testing.assert_allclose(fine.positions[[c, d]], data.positions[[a, b]])
        path = np.linalg.norm(np.diff(fine.positions[c : d + 1], axis=0), axis=-1).sum(0)
        np.testing.assert_allclose(
            path, np.linalg.norm(np.diff(data.positions[a : b + 1], axis=0), axis=-1).sum(0), atol=1e-6
        )
    same = finer(data, 1.0)
    np.testing.assert_array_equal(same.positions, np.concatenate([data.positions[a : b + 1] for a, b in data.strokes]))


def test_the_size_of_pgnd_is_the_papers():
    count = sum(p.numel() for p in make_network("pgnd", settings("pgnd"), False, 0).parameters())
    assert count == pytest.approx(834_956, rel=0.01)  # that one normalises its layers


def test_a_tool_out_of_reach_moves_nothing_differently():
    network = untrained("gbnd", sequences(), history=3).network
    past = torch.rand(1, 4, 12, 3, generator=torch.Generator().manual_seed(0)) * 0.05
    far = torch.tensor([[0.5, 0.5]])
    push = torch.tensor([PUSH])
    still, moving = network.step(past, far, far, push), network.step(past, far, far + 0.03, push)
    torch.testing.assert_close(still, moving)
    near = past[:, -1].mean(1)[:, :2]
    assert not torch.allclose(network.step(past, near, near, push), network.step(past, near, near + 0.03, push))
    assert past.shape[1] == network.params.frames


def test_the_nodes_on_a_tool_lie_around_a_pusher_and_in_one_place_where_it_holds():
    network = untrained("gbnd", sequences()).network
    hand = torch.tensor([[0.1, 0.2], [0.3, -0.1]])
    nodes = network.tool(hand, torch.tensor([PUSH, PICK]))
    apart = (nodes[..., :2] - hand[:, None]).norm(dim=-1)
    torch.testing.assert_close(apart, torch.tensor([[0.01] * gbnd.RING, [0.0] * gbnd.RING]))
    assert (nodes[0].unique(dim=0).shape, nodes[..., 2].unique().item()) == ((gbnd.RING, 3), pytest.approx(0.01))
    particles = torch.tensor([[[0.1, 0.2 + 0.07, 0.0], [0.1, 0.2 + 0.09, 0.0], [0.1, 0.2 + 0.5, 0.0]]]).expand(
        2, -1, -1
    )
    neighbors, near = network.graph(particles, nodes)
    assert neighbors[0, 0, 2:].tolist() == [3, 4, 5, 6]
    assert near[0, :, 2:].sum(-1).tolist() == [3, 0, 0], "the far side of the ring is out of reach"


def test_stiffness_stays_below_what_the_springs_bear():
    graph = build_springs(sequences().rest[0], 0.05)
    for damping in (0.3, 0.8, 0.99):
        numbers = torch.tensor([sms.STABLE, math.log(damping / (1 - damping)), 4e-5, 0.02, 0.5])
        bound = simulation.stability_bound(graph, damping)
        assert sms.stiffness_of(graph, numbers).item() == pytest.approx(sms.STABLE * bound, rel=1e-4)
    assert sms.as_given(graph, False).stiffness == 0.1
    many = build_springs(sequences(particles=60).rest[0], 0.3)
    assert sms.as_given(many, True).stiffness == pytest.approx(sms.STABLE * simulation.stability_bound(many, 0.9))


def test_a_pick_carries_what_it_holds():
    data = sequences(picks=True)
    predict = predictor("sms-no", data)
    start, strokes = scenes(data, 1)
    after = predict(start, strokes)
    held = sms.held_particles(start, strokes, torch.tensor(0.02))[0]
    assert held.any()
    moved = (after - start)[0, held, :2]
    torch.testing.assert_close(moved, strokes.along.expand_as(moved), atol=1e-5, rtol=0)
    pushed = replace(strokes, mode=torch.zeros_like(strokes.mode))
    assert not sms.held_particles(start, pushed, torch.tensor(0.02)).any()


@pytest.mark.parametrize("name", ["pgnd", "gbnd"])
def test_strokes_of_all_lengths_are_predicted_as_each_alone(name, monkeypatch):
    """Those that have ended are predicted no further, and what comes back is in the order that was asked."""
    trained, steps = untrained(name, sequences()), []
    rest, step = torch.as_tensor(sequences().rest[0]), trained.network.step
    monkeypatch.setattr(trained.network, "step", lambda past, *rest: steps.append(len(past)) or step(past, *rest))
    predict = make_predict(name, trained, rest, PredictionParams())
    lengths = torch.tensor([0.03, 0.14, 0.02, 0.08, 0.08 + 1e-6])
    start = rest[:, :2].mean(0).expand(5, -1) - torch.tensor([0.06, 0.0])
    strokes = Strokes.of(start, start + torch.nn.functional.pad(lengths[:, None], (0, 1)), PUSH)
    found = predict(rest.expand(5, -1, -1), strokes)
    pace = min(trained.pace, trained.settings.step)
    assert sum(steps) == sum(math.ceil(float(length) / pace - 0.01) for length in lengths)
    alone = torch.cat([predict(rest[None], strokes[k : k + 1]) for k in range(5)])
    torch.testing.assert_close(found, alone, atol=1e-6, rtol=0)
    assert (found - rest).norm(dim=-1).mean(-1).min() > 1e-5
