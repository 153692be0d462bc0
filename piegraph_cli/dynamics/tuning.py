"""What becomes of a prior on a recording: strokes of this very object, simulated with numbers fitted to it, and the real ones.

With no stroke yet the object's particles at rest are enough.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import EGNN
from piegraph_cli.dynamics.examples import Pairs, Sequences
from piegraph_cli.dynamics.own import Own
from piegraph_cli.dynamics.own_block import check_block, own_block
from piegraph_cli.dynamics.own_rope import check_rope, own_rope
from piegraph_cli.dynamics.params import EGNNParams
from piegraph_cli.dynamics.prior import Chunk, Prior, distance_loss, plain_distance
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.errors import DataError

HELD, ENOUGH = 4, 20
"""Every so many strokes one is left out to choose the number of steps by, where there are enough: two tell nothing."""
GAIN = 0.1
"""Share by which fewer steps have to be better than all, on strokes that were left out: a few strokes tell no less."""


@dataclass(frozen=True)
class Kind:
    """What is done with a recording for a prior of one family."""

    check: Callable[[Sequences], None]
    """Raises `DataError` for another kind of object."""
    own: Callable[[Sequences, int, int], Own]
    """The object, from its strokes, neighbours in the graph and a seed."""
    steps: int
    """Training steps, at most."""
    real: int
    """Examples of a batch that are real, where there are any."""
    compared: int
    """Training steps where it is only compared with other models."""
    loss: Callable[..., Tensor]
    """Of positions that are predicted, true, before, and of the particles that are seen [B, N], each [B]."""


KINDS = {
    "blocks": Kind(check_block, own_block, 600, 3, 200, distance_loss),
    "ropes": Kind(check_rope, own_rope, 3000, 8, 600, plain_distance),
}
"""By family. A rope's springs are further from the truth than a block's numbers: more of what it learns from is real. What
a rope does that is pushed along itself is rare and goes far, so that there all millimetres count alike."""


class Tuning:
    """Training examples: pairs of the recording, and in every batch more strokes that are simulated."""

    def __init__(self, data: Sequences, chunk: Chunk, neighbors: int, kind: Kind):
        self.pairs = Pairs.of(data, neighbors) if len(data.pairs) else None
        self.chunk, self.kind = chunk, kind

    def __len__(self) -> int:
        return len(self.chunk) if self.pairs is None else len(self.pairs)

    def loss(self, network: nn.Module, chosen: Tensor, rng: np.random.Generator | None = None) -> Tensor:
        """The loss of the network on the chosen pairs [B]; with `rng` most of them are simulated strokes instead."""
        if rng is None:
            return self._real(network, chosen).mean() if self.pairs is not None else self._made(network, chosen).mean()
        real = chosen[: min(self.kind.real, len(chosen))] if self.pairs is not None else chosen[:0]
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
        return self.kind.loss(found, pairs.end[chosen], start, seen)

    def _made(self, network: nn.Module, chosen: Tensor) -> Tensor:
        chunk, before = self.chunk, self.chunk.before[chosen]
        found = network(before, chunk.strokes[chosen], chunk.rest[chunk.owner[chosen]], chunk.grasp[chosen])
        return self.kind.loss(found, chunk.after[chosen], before)


def family_of(data: Sequences) -> str:
    """The family of priors that a recording's object belongs to. Raises `DataError` for one that belongs to none."""
    reasons = []
    for family, kind in KINDS.items():
        try:
            kind.check(data)
        except DataError as error:
            reasons.append(error.message)
        else:
            return family
    raise DataError("no prior fits this object: " + "; ".join(dict.fromkeys(reasons)), hint="train without --from")


def unseen(data: Sequences) -> Sequences:
    """The object at rest alone, without any stroke of it."""
    none = np.zeros((0, 2), np.int64)
    empty = none[:, 0]
    return replace(data, strokes=none, mode=data.mode[:0], owner=empty, pairs=none, pair_stroke=empty)


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
    kept, left = (some(data, chosen) for chosen in (~held, held))
    own = KINDS[prior.family].own(kept, settings.neighbors, seed)
    trainer = start_tuning(prior, own, kept, left, settings, seed)
    every = max(1, settings.steps // 10)
    while not trainer.finished:
        trainer.step()
        if trainer.done % every == 0:
            trainer.record()
    losses = {step: loss for step, _, loss in trainer.history}
    best = min(losses, key=lambda step: losses[step])
    return best if losses[best] < (1 - GAIN) * losses[trainer.done] else settings.steps


def start_tuning(
    prior: Prior, own: Own, data: Sequences, held_out: Sequences | None, settings: EGNNParams, seed: int
) -> Trainer:
    """The training of a prior on a recording of one object, about to begin."""
    chunk, neighbors, kind = own.chunk, settings.neighbors, KINDS[prior.family]
    validation = Tuning(held_out, chunk, neighbors, kind) if held_out is not None and len(held_out.pairs) else None
    return Trainer(told(prior, own.traits), Tuning(data, chunk, neighbors, kind), validation, settings, seed)


def some(data: Sequences, chosen: np.ndarray) -> Sequences:
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
