"""A prior: the network that has seen random strokes of a family of objects, told their traits, before any recording.

The strokes come from this project's own physics alone. What it then makes of a recording is in `tuning`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import DECIMETRE, EGNN, Rest
from piegraph_cli.dynamics.family import blocks, ropes
from piegraph_cli.dynamics.family.drawn import TRAITS, Drawn
from piegraph_cli.dynamics.family.params import PretrainParams
from piegraph_cli.dynamics.losses import mean_seen
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError

Draw = Callable[[np.random.Generator, int], list[Drawn]]
"""Objects with so many particles, with strokes of them: as many as a chunk has."""


@dataclass(frozen=True)
class Family:
    """A kind of object that a prior is for."""

    draw: Draw
    simulator: str
    """What moves its objects: a test in the same one would be no test."""
    seen: dict[str, Any]
    """What is drawn, as it is written into a prior's file."""


FAMILIES = {
    "blocks": Family(blocks.draw_blocks, "analytic quasi-static pushing", blocks.SEEN),
    "ropes": Family(ropes.draw_ropes, "springs of this project", ropes.SEEN),
}

PARTICLES = (20, 30, 40, 50)
"""Of the objects of a chunk."""
STROKES = 1024
"""Of a chunk, each of which is learned from once."""
SOFT = 0.02
"""Decimetres below which an error counts by its square."""
SHORT = 0.2
"""Decimetres that a stroke moves an object by on average, from which on errors count as shares of the motion."""
WARM = 100
"""Steps in which the learning rate rises."""
RECORDS = 40
"""Losses are noted so many times."""


class Prior(nn.Module):
    """The network of piegraph and what it makes of an object's traits: a shift of its features."""

    def __init__(self, network: EGNN, family: str):
        super().__init__()
        self.network, self.family = network, family
        self.traits = nn.Linear(TRAITS, network.embed.out_features, bias=False)

    def forward(self, positions: Tensor, strokes: Strokes, rest: Rest, grasp: Tensor, traits: Tensor) -> Tensor:
        """Positions [B, N, 3] (m) after strokes [B] of objects with traits [B, TRAITS]."""
        return self.network(positions, strokes, rest, grasp, self.traits(traits))


def make_prior(params: PretrainParams, picks: bool, seed: int) -> Prior:
    """One with fresh weights, drawn from the seed."""
    torch.manual_seed(seed)
    network = EGNN(params.neighbors, params.hidden, params.layers, True, picks, True, True)
    return Prior(network, params.family)


@dataclass(frozen=True)
class Chunk:
    """Strokes [S] of many objects with equally many particles."""

    before: Tensor
    """[S, N, 3] metres."""
    after: Tensor
    """[S, N, 3] metres."""
    strokes: Strokes
    rest: Rest
    """Of each object."""
    owner: Tensor
    """[S] the object of each stroke."""
    grasp: Tensor
    """[S] the particle nearest to where the stroke begins."""
    traits: Tensor
    """[objects, TRAITS]."""

    @classmethod
    def of(cls, drawn: Sequence[Drawn], neighbors: int) -> "Chunk":
        """What was drawn, in one."""

        def joined(name: str) -> np.ndarray:
            return np.concatenate([getattr(d, name) for d in drawn])

        before, after, start, end, traits, rest = (
            torch.as_tensor(np.asarray(a, np.float32))
            for a in (
                *map(joined, ("before", "after", "start", "end")),
                np.stack([d.traits for d in drawn]),
                np.stack([d.rest for d in drawn]),
            )
        )
        owner = torch.arange(len(drawn)).repeat_interleave(torch.tensor([len(d.before) for d in drawn]))
        grasp = (before[..., :2] - start[:, None]).norm(dim=-1).argmin(-1)
        strokes = Strokes.of(start, end, joined("mode"), joined("held"))
        return cls(before, after, strokes, Rest.of(rest, neighbors), owner, grasp, traits)

    def __len__(self) -> int:
        return len(self.before)

    def loss(self, prior: Prior, chosen: Tensor) -> Tensor:
        """`distance_loss` on the chosen strokes [B]."""
        owner, before = self.owner[chosen], self.before[chosen]
        found = prior(before, self.strokes[chosen], self.rest[owner], self.grasp[chosen], self.traits[owner])
        return distance_loss(found, self.after[chosen], before).mean()


def plain_distance(predicted: Tensor, target: Tensor, before: Tensor, seen: Tensor | None = None) -> Tensor:
    """Mean distance [B] (about dm) of particles [B, N, 3] (m); its square near 0.

    `seen` [B, N]: the particles that count, all by default.
    """
    square = ((predicted - target) * DECIMETRE).square().sum(-1)
    return mean_seen((square + SOFT**2).sqrt() - SOFT, seen)


def distance_loss(predicted: Tensor, target: Tensor, before: Tensor, seen: Tensor | None = None) -> Tensor:
    """`plain_distance`, less of particles that move far: errors count as shares of the motion."""
    motion = mean_seen(((target - before) * DECIMETRE).norm(dim=-1), seen)
    return plain_distance(predicted, target, before, seen) * (2 * SHORT / (SHORT + motion))


def draw_chunk(family: str, seed: int, index: int, neighbors: int) -> Chunk:
    """The `index`-th chunk of a seed."""
    rng = np.random.default_rng([seed, index])
    particles = PARTICLES[int(rng.integers(len(PARTICLES)))]
    return Chunk.of(FAMILIES[family].draw(rng, particles), neighbors)


class Pretraining:
    """AdamW on fresh strokes, its rate falling along one cosine; it can be stopped, kept as arrays and taken up again.

    Step t learns from strokes that (seed, t) alone decide, so resuming changes nothing.
    """

    def __init__(self, prior: Prior, params: PretrainParams):
        self.prior, self.params = prior, params
        self.optimizer = torch.optim.AdamW(prior.parameters(), lr=params.learning_rate, weight_decay=1e-4, fused=True)
        self.done = 0
        self.history: list[tuple[int, float]] = []
        self.recent = [0.0, 0.0]
        self.chunk: tuple[int, Chunk, Tensor] | None = None

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.done >= self.params.steps

    def step(self) -> None:
        """One step. Raises `DataError` when training has diverged."""
        params = self.params
        every = STROKES // params.batch
        index, place = divmod(self.done, every)
        if self.chunk is None or self.chunk[0] != index:
            drawn = draw_chunk(params.family, params.seed, index, params.neighbors)
            order = np.random.default_rng([params.seed, index, 1]).permutation(len(drawn))
            self.chunk = index, drawn, torch.as_tensor(order)
        _, chunk, chosen = self.chunk
        rate = params.learning_rate * min(1.0, (self.done + 1) / WARM)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * 0.5 * (1 + math.cos(math.pi * self.done / params.steps))
        loss = chunk.loss(self.prior, chosen[place * params.batch : (place + 1) * params.batch])
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.prior.parameters(), params.clip)
        self.optimizer.step()
        self.done += 1
        value = loss.item()
        if not math.isfinite(value):
            raise DataError(f"training diverged at step {self.done}", hint="lower --learning-rate")
        self.recent = [self.recent[0] + value, self.recent[1] + 1]
        if self.done % max(1, params.steps // RECORDS) == 0 or self.finished:
            self.history.append((self.done, self.recent[0] / self.recent[1]))
            self.recent = [0.0, 0.0]

    def state(self) -> dict[str, np.ndarray]:
        """Everything `load` needs, as arrays."""
        arrays = {f"prior.{k}": v for k, v in self.prior.state_dict().items()}
        for index, slot in self.optimizer.state_dict()["state"].items():
            arrays |= {f"adam.{index}.{k}": v for k, v in slot.items()}
        plain = {name: value.detach().numpy().copy() for name, value in arrays.items()}
        plain["history"] = np.array(self.history, np.float64).reshape(-1, 2)
        return plain | {"recent": np.array(self.recent), "done": np.array(self.done)}

    def load(self, state: Mapping[str, np.ndarray]) -> None:
        """Take up the state that `state` gave."""
        tensors = {name: torch.as_tensor(value) for name, value in state.items()}
        self.prior.load_state_dict({k[6:]: v for k, v in tensors.items() if k.startswith("prior.")})
        slots: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, index, slot = name.split(".")
                slots.setdefault(int(index), {})[slot] = value
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": slots, "param_groups": groups})
        self.done, self.recent = int(state["done"]), state["recent"].tolist()
        self.history = [(int(step), loss) for step, loss in state["history"].tolist()]
