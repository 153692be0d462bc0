"""Benchmarks of planning, tracking and training."""

import json
import time
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.bench.kernels import network_flop, random_object, random_strokes
from piegraph_cli.bench.measure import Row, check, core_counts, median_seconds, on_cores
from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.examples import Pairs, Sequences
from piegraph_cli.dynamics.models import MODELS, Trained, make_network, make_predict, sure
from piegraph_cli.dynamics.params import BY_GRADIENT, EGNNParams, LearningParams
from piegraph_cli.dynamics.stroke import Predict, Strokes
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.environments.shapes import t_block
from piegraph_cli.errors import DataError
from piegraph_cli.params import PUSH
from piegraph_cli.physics.simulation import guide
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.physics.tracking import track
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import stroke_space
from piegraph_cli.planning.search import Search
from piegraph_cli.service.requests import written
from piegraph_cli.service.service import Service
from piegraph_cli.stages.steps import make_environment

AT_REST = 1e-3
"""Metres. The springs of a plan stop when all of their group are at rest, and groups differ from the reference's."""

TRACKED = 5e-3
"""Metres of mean error allowed to tracking."""

CLOUD = 3000
"""Points that a robot's cameras see of the T-block."""

FRAMES = 20
STROKES, STROKE_FRAMES = 40, 8
TRAINED = 200
"""Training steps of the planning benchmark's network, so that setpoints are such as a trained one gives."""


def plan_rows() -> Iterator[Row]:
    """Plans for the T-block, horizon 1, guided and not, beside the same search with the references in PyTorch."""
    state, trained = learned_block()
    for samples, iterations in ((100, 5), (500, 30)):
        for model in ("piegraph", "piegraph-ng"):
            for cores in core_counts():
                yield _plan(
                    state,
                    trained,
                    PlanParams(samples=samples, cem_iterations=iterations, model=model, converged=0),
                    cores,
                )
        if samples == 100:
            yield from (_asked(trained, cores) for cores in core_counts())
    default = PlanParams(samples=500, cem_iterations=30)
    yield _plan(state, trained, default, core_counts()[-1])


def _asked(trained: Trained, cores: int) -> Row:
    """A warm service's whole answer to such a question, from the bytes of a cloud to those of strokes."""
    params = PlanParams(samples=100, cem_iterations=5, converged=0)
    service = Service(Model("piegraph", trained, params))
    cloud = t_block().visible_surface(CLOUD, seed=0)
    question = json.dumps({"state": written(cloud, "base64"), "goal_pose": [0.1, 0.05, 0.0]}).encode()
    if service.reply(question, "plan").exit_code:
        raise DataError(f"no answer: {service.reply(question, 'plan').text.decode()}", "bench plan")
    with on_cores(cores):
        seconds = median_seconds(lambda: service.reply(question, "plan"), 5)
    return Row("plan", "100 x 5, guided, asked of serve", seconds, cores)


def learned_block() -> tuple[Tensor, Trained]:
    environment = make_environment("tblock", 50, PlanParams())
    rest, _ = environment.reset(seed=0)
    rng, state = np.random.default_rng(0), rest
    starts, ends, strokes = [], [], []  # type: ignore[var-annotated]
    while len(strokes) < 40:
        stroke = environment.sample_stroke(rng)
        after = environment.step(stroke)[0]
        starts.append(state)
        ends.append(after)
        strokes.append(Strokes.of(stroke["start"], stroke["end"], stroke["mode"]))
        state = after
    owner = np.zeros(len(strokes), int)
    params = EGNNParams(steps=TRAINED)
    pairs = Pairs(np.array(starts), np.array(ends), Strokes.stack(strokes), rest[None], owner, owner, params.neighbors)
    trainer = Trainer(make_network("piegraph", params, False, 0), pairs, None, params, 0)
    for _ in range(TRAINED):
        trainer.step()
    return torch.as_tensor(rest), Trained(trainer.network.requires_grad_(False), params, 0.0, (PUSH,), len(rest))


def _plan(state: Tensor, trained: Trained, params: PlanParams, cores: int) -> Row:
    space = stroke_space(state, params, (PUSH,), params.pusher_radius)
    cost = make_cost("distance", state + torch.tensor([0.1, 0.05, 0.0]), len(state))
    predict, slow = make_predict(params.model, trained, state, params), _reference(trained, state, params)

    def plan(with_: Predict):
        found = Search(sure(with_), cost, space, params, torch.Generator().manual_seed(0))(state)
        assert found is not None
        return found

    strokes = plan(predict).candidates.strokes[0, :, 0]
    states = state.expand(len(strokes), -1, -1)
    error = float((predict(states, strokes) - slow(states, strokes)).norm(dim=-1).mean(1).max())
    with on_cores(cores):
        seconds = median_seconds(lambda: plan(predict), 5)
    begin = time.perf_counter()
    if cores == 1:
        plan(slow)
    reference = time.perf_counter() - begin if cores == 1 else None
    name = f"{params.samples} x {params.cem_iterations}, {'guided' if params.model == 'piegraph' else 'not guided'}"
    name += ", may end early" if params.converged else ""
    return Row("plan", name, seconds, cores, check("plan", error, AT_REST), reference_seconds=reference)


def _reference(trained: Trained, state: Tensor, params: PlanParams) -> Predict:
    network = trained.network
    assert isinstance(network, EGNN)
    rest, graph = Rest.of(state[None], network.neighbors), build_springs(state.numpy(), params.spring_radius)

    @torch.no_grad()
    def predict(positions: Tensor, strokes: Strokes) -> Tensor:
        pairs = zip(positions.split(25), strokes.split(25), strict=True)
        setpoint = torch.cat([network(x, s, rest.expand(len(x))) for x, s in pairs])
        return guide(positions, setpoint, graph, params) if params.model == "piegraph" else setpoint

    return predict


def track_rows() -> Iterator[Row]:
    """A frame of tracking: 150 particles of a block that turns, in clouds of 3000 points with 1 mm of noise."""
    rng = np.random.default_rng(0)
    block = rng.uniform([-0.1, -0.05, 0], [0.1, 0.05, 0.03], (3000, 3))
    clouds, poses = [], []
    for frame in range(FRAMES):
        c, s = np.cos(0.05 * frame), np.sin(0.05 * frame)
        pose = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        clouds.append((block @ pose + [0.006 * frame, 0, 0] + rng.normal(0, 0.001, block.shape)).astype(np.float32))
        poses.append(pose)
    found = track(clouds).positions
    true = np.stack([found[0] @ pose + [0.006 * k, 0, 0] for k, pose in enumerate(poses)])
    error = float(np.linalg.norm(found - true, axis=-1).mean())
    seconds = median_seconds(lambda: track(clouds), 3) / FRAMES
    yield Row("track", "a frame, 150 particles", seconds, error=check("track", error, TRACKED))


def train_rows() -> Iterator[Row]:
    """A training step of piegraph, by batch and threads, the backward pass counted as two forward ones; and of the others."""
    data = carried_sequences()
    for batch in (8, 32):
        for threads in core_counts():
            torch.set_num_threads(threads)
            params = EGNNParams(batch=batch)
            seconds = median_seconds(make_trainer("piegraph", data, params).step)
            torch.set_num_threads(1)
            yield Row("train", f"a step, batch {batch}", seconds, threads, flop=3 * batch * network_flop(50, params))
    for name, settings in BY_GRADIENT.items():
        if name != "piegraph":
            seconds = median_seconds(make_trainer(name, data, settings()).step, 5)
            yield Row("train", f"a step of {name}, batch {settings().batch}", seconds)


def make_trainer(name: str, data: Sequences, params: LearningParams, device: str = "cpu") -> Trainer:
    learner = MODELS[name].learner
    assert learner is not None
    assert learner.examples is not None
    return Trainer(
        make_network(name, params, False, 0), learner.examples(data, params, device), None, params, 0, device
    )


def carried_sequences() -> Sequences:
    """Strokes of eight frames that carry an object of 50 particles along."""
    rng = np.random.default_rng(0)
    rest = random_object(50, rng)
    ends = random_strokes(STROKES, rng).ends.numpy()
    travelled = np.linspace(0, 1, STROKE_FRAMES)[:, None] * (ends[:, 1] - ends[:, 0])[:, None]
    first = np.arange(STROKES) * STROKE_FRAMES
    pairs = np.array([[a + i, a + j] for a in first for i in range(STROKE_FRAMES) for j in range(i + 2, STROKE_FRAMES)])
    return Sequences(
        positions=(rest + np.pad(travelled, ((0, 0), (0, 0), (0, 1)))[:, :, None])
        .reshape(-1, 50, 3)
        .astype(np.float32),
        hand=(ends[:, :1] + travelled).reshape(-1, 2).astype(np.float32),
        strokes=np.stack([first, first + STROKE_FRAMES - 1], 1),
        mode=np.zeros(STROKES, np.uint8),
        owner=np.arange(STROKES) // 4,
        rest=np.repeat(rest[None], STROKES // 4, 0).astype(np.float32),
        pairs=pairs,
        pair_stroke=np.repeat(np.arange(STROKES), len(pairs) // STROKES),
    )
