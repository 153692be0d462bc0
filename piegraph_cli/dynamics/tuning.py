"""What becomes of a prior on a recording: strokes of this very object, simulated with numbers fitted to it, and the real ones.

With no stroke yet the object's particles at rest are enough.
"""

import copy
import math
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import EGNN
from piegraph_cli.dynamics.examples import Pairs, Sequences
from piegraph_cli.dynamics.family.blocks import FRICTION, PRESSURE, REACH, simulated
from piegraph_cli.dynamics.family.drawn import TRAITS
from piegraph_cli.dynamics.params import EGNNParams, RigidParams
from piegraph_cli.dynamics.prior import Chunk, Prior, distance_loss
from piegraph_cli.dynamics.rigid_body import MOVED, WIDE, RigidBody, body_frame, planar_residuals
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.errors import DataError
from piegraph_cli.physics.rigid import moved_in_plane

SIMULATED = 6000
"""Strokes of the object that are simulated."""
KNOWN = (0.25, 0.1, 0.15)
"""Deviations of the logarithms of friction, turning length and reach in these, where there are strokes to fit them to."""
UNKNOWN = (FRICTION[1], PRESSURE[1], REACH[1])
"""The same without any stroke."""
REAL = 3
"""Examples of a batch that are real, where there are any."""
SHAPES = 4
"""Sequences whose particles are used in simulated strokes, at most."""
HELD, ENOUGH = 4, 20
"""Every so many strokes one is left out to choose the number of steps by, where there are enough: two tell nothing."""
GAIN = 0.1
"""Share by which fewer steps have to be better than all, on strokes that were left out: a few strokes tell no less."""
BENT, SHARE = 0.005, 0.2
"""Metres from a rigid motion, and share of the motion, above which a thing bends."""


class Tuning:
    """Training examples: pairs of the recording, and in every batch more strokes that are simulated."""

    def __init__(self, data: Sequences, chunk: Chunk, neighbors: int):
        self.pairs = Pairs.of(data, neighbors) if len(data.pairs) else None
        self.chunk = chunk

    def __len__(self) -> int:
        return len(self.chunk) if self.pairs is None else len(self.pairs)

    def loss(self, network: nn.Module, chosen: Tensor, rng: np.random.Generator | None = None) -> Tensor:
        """`distance_loss` of the network on the chosen pairs [B]; with `rng` most of them are simulated strokes instead."""
        if rng is None:
            return self._real(network, chosen).mean() if self.pairs is not None else self._made(network, chosen).mean()
        real = chosen[: min(REAL, len(chosen))] if self.pairs is not None else chosen[:0]
        made = torch.as_tensor(rng.integers(0, len(self.chunk), len(chosen) - len(real)))
        losses = [self._made(network, made)] if len(made) else []
        return torch.cat([*losses, self._real(network, real)] if len(real) else losses).mean()

    def static_loss(self, network: nn.Module, chosen: Tensor) -> Tensor:
        """The loss on the chosen examples [B] if nothing moves."""
        return self.loss(lambda positions, *_: positions, chosen)  # type: ignore[arg-type]

    def _real(self, network: nn.Module, chosen: Tensor) -> Tensor:
        assert self.pairs is not None
        pairs, start = self.pairs, self.pairs.start[chosen]
        found = network(start, pairs.strokes[chosen], pairs.rest[pairs.owner[chosen]], pairs.grasp[chosen])
        seen = None if pairs.seen is None else pairs.seen[chosen]
        return distance_loss(found, pairs.end[chosen], start, seen)

    def _made(self, network: nn.Module, chosen: Tensor) -> Tensor:
        chunk, before = self.chunk, self.chunk.before[chosen]
        found = network(before, chunk.strokes[chosen], chunk.rest[chunk.owner[chosen]], chunk.grasp[chosen])
        return distance_loss(found, chunk.after[chosen], before)


def check_block(data: Sequences) -> None:
    """Refuse a recording of something else than a block. Raises `DataError` that says by what it is told."""
    hint = "train without --from: the prior is for blocks"
    if data.picks:
        raise DataError("strokes that hold the object; the prior is for blocks that are pushed", hint=hint)
    flat = data.rest[0][:, :2] - data.rest[0][:, :2].mean(0)
    width = float(np.linalg.svd(flat, compute_uv=False)[-1] / math.sqrt(len(flat)))
    if width < WIDE:
        raise DataError(f"as narrow as a rope ({width * 1000:.0f} mm): the prior is for blocks", hint=hint)
    before, after = (data.positions[k][..., :2] for k in data.strokes.T)
    motion = np.linalg.norm(after - before, axis=-1).mean(1)
    moved = motion > MOVED
    if not moved.any():
        return
    bent = float(np.median(planar_residuals(before[moved], after[moved])))
    if bent > max(BENT, SHARE * float(np.median(motion[moved]))):
        raise DataError(
            f"particles end {bent * 1000:.0f} mm from a rigid motion: this bends; the prior is for blocks", hint=hint
        )


def unseen(data: Sequences) -> Sequences:
    """The object at rest alone, without any stroke of it."""
    none = np.zeros((0, 2), np.int64)
    empty = none[:, 0]
    return replace(data, strokes=none, mode=data.mode[:0], owner=empty, pairs=none, pair_stroke=empty)


def fitted_body(data: Sequences) -> RigidBody:
    """Outline and numbers of a block from its strokes; without any the numbers stay as before strokes are seen."""
    body = RigidBody(RigidParams(fit=len(data.strokes) > 0, friction=FRICTION[0], reach=REACH[0]))
    if not len(data.strokes):  # one that nothing comes of
        at_rest, one = data.rest[:1].repeat(2, 0), np.array([[0, 1]])
        hand, zero = np.array([[1.0, 0.0], [1.1, 0.0]], np.float32), np.zeros(1, np.int64)
        data = replace(data, positions=at_rest, hand=hand, strokes=one, mode=zero, owner=zero)
    body.fit(data)
    return body


def own_strokes(body: RigidBody, data: Sequences, neighbors: int, seed: int) -> Chunk:
    """Strokes of a body simulated, with the particles that its sequences have."""
    rng = np.random.default_rng([seed, len(data.strokes)])
    chosen = np.unique(np.linspace(0, len(data.rest) - 1, SHAPES).astype(int))
    like = _parts(data, float(body.numbers[2])) if len(data.strokes) else None
    drawn = []
    for rest in data.rest[chosen]:
        pose = body_frame(rest, body.shape.numpy())
        own = moved_in_plane(rest[:, :2] - pose[:2], np.array([0.0, 0.0, -pose[2]]))
        spread = KNOWN if len(data.strokes) else UNKNOWN
        particles = np.concatenate([own, rest[:, 2:]], 1)
        drawn.append(simulated(rng, body.edges, body.numbers, spread, particles, SIMULATED // len(chosen), like))
    return Chunk.of(drawn, neighbors)


def _parts(data: Sequences, reach: float) -> np.ndarray:
    """How far the strokes [S, 2] (m) go before they come near the object, and from there on."""
    strokes, before = data.whole(), torch.as_tensor(data.positions[data.strokes[:, 0]])
    relative = ((before[..., :2] - strokes.start[:, None]) @ strokes.rotation).double()
    spacing = float(np.median(cKDTree(data.rest[0]).query(data.rest[0], k=2)[0][:, 1]))
    near = reach + spacing / 2
    ahead, aside = relative.unbind(-1)
    touch = torch.where(aside.abs() < near, ahead - (near**2 - aside**2).clamp_min(0).sqrt(), torch.inf).amin(1)
    free = torch.minimum(touch.clamp_min(0), strokes.length)
    return torch.stack([free, strokes.length - free], 1).numpy()


def traits_of(body: RigidBody) -> Tensor:
    """A body's traits [TRAITS] as the prior of blocks was told them."""
    friction, c, *_ = body.numbers.tolist()
    gyration = float(body.shape.square().sum(1).mean().sqrt())
    traits = torch.zeros(TRAITS)
    for k, (number, (middle, spread)) in enumerate([(friction, FRICTION), (c / gyration, PRESSURE)]):
        traits[k] = min(max(math.log(number / middle) / spread, -2.0), 2.0)
    return traits  # how near the pusher comes is measured from particles here: REACH stays in the middle


def told(prior: Prior, traits: Tensor) -> EGNN:
    """The prior's network, for objects with these traits [TRAITS]: what it takes is what any of piegraph's networks takes."""
    network = copy.deepcopy(prior.network)
    with torch.no_grad():
        network.embed.bias.add_(prior.traits.weight @ traits)
    return network


def tuned_steps(prior: Prior, data: Sequences, settings: EGNNParams, seed: int) -> int:
    """How many steps to learn for: fewer than all only where that is clearly better on strokes that are left out."""
    count = len(data.strokes)
    if count < ENOUGH:
        return settings.steps
    held = np.random.default_rng(seed).permutation(count) % HELD == 0
    kept, left = (_some(data, chosen) for chosen in (~held, held))
    trainer = start_tuning(prior, kept, left, settings, seed)
    every = max(1, settings.steps // 10)
    while not trainer.finished:
        trainer.step()
        if trainer.done % every == 0:
            trainer.record()
    losses = {step: loss for step, _, loss in trainer.history}
    best = min(losses, key=lambda step: losses[step])
    return best if losses[best] < (1 - GAIN) * losses[trainer.done] else settings.steps


def start_tuning(prior: Prior, data: Sequences, held_out: Sequences | None, settings: EGNNParams, seed: int) -> Trainer:
    """The training of a prior on a recording, about to begin. Raises `DataError` for things that the prior is not for."""
    body = fitted_body(data)
    network = told(prior, traits_of(body))
    chunk = own_strokes(body, data, settings.neighbors, seed)
    validation = Tuning(held_out, chunk, settings.neighbors) if held_out is not None and len(held_out.pairs) else None
    return Trainer(network, Tuning(data, chunk, settings.neighbors), validation, settings, seed)


def _some(data: Sequences, chosen: np.ndarray) -> Sequences:
    """Some of the strokes, with their pairs."""
    pairs = chosen[data.pair_stroke]
    return replace(
        data,
        strokes=data.strokes[chosen],
        mode=data.mode[chosen],
        owner=data.owner[chosen],
        pairs=data.pairs[pairs],
        pair_stroke=(np.cumsum(chosen) - 1)[data.pair_stroke[pairs]],
    )
