"""The equivariant graph network: turned or moved scene and stroke in, equally turned or moved prediction out."""

from dataclasses import dataclass

import torch
from torch import nn

from piegraph_cli.dynamics.action import (
    FEATURES,
    PICK_FEATURES,
    canonical_action,
    grasped_particle,
    pick_features,
)
from piegraph_cli.dynamics.stroke import Strokes

DECIMETRE = 10.0
"""Inside the network lengths are in decimetres, so that features are near one."""


def nearest_neighbors(positions: torch.Tensor, count: int) -> torch.Tensor:
    """Indices [B, N, k] of the k nearest other particles of positions [B, N, 3]; k is at most N - 1."""
    count = min(count, positions.shape[1] - 1)
    distances = torch.cdist(positions, positions)
    distances.diagonal(dim1=-2, dim2=-1).fill_(torch.inf)
    return distances.topk(count, largest=False, sorted=True).indices


@dataclass(frozen=True)
class Rest:
    """Objects as they were before the first stroke: their neighbours stay the graph's, so that folded layers do not join."""

    positions: torch.Tensor
    """[B, N, 3] metres; B may be 1 for one object in many scenes."""
    neighbors: torch.Tensor
    """[B, N, k]."""

    @classmethod
    def of(cls, positions: torch.Tensor, neighbors: int) -> "Rest":
        """The rest of positions [B, N, 3] with its k nearest neighbours."""
        return cls(positions, nearest_neighbors(positions, neighbors))

    def expand(self, batch: int) -> "Rest":
        """One object's rest for a batch of scenes."""
        return Rest(self.positions.expand(batch, -1, -1), self.neighbors.expand(batch, -1, -1))

    def __getitem__(self, index: torch.Tensor) -> "Rest":
        return Rest(self.positions[index], self.neighbors[index])


def gather_neighbors(values: torch.Tensor, neighbors: torch.Tensor) -> torch.Tensor:
    """Values [B, M, C] of every particle's neighbours [B, N, k], which are among the M: [B, N, k, C]."""
    batch, particles, count = neighbors.shape
    offsets = torch.arange(batch, device=values.device)[:, None, None] * values.shape[1]
    flat = values.reshape(batch * values.shape[1], -1).index_select(0, (neighbors + offsets).reshape(-1))
    return flat.view(batch, particles, count, -1)


def scaled_pick_features(
    positions: torch.Tensor, strokes: Strokes, rest: torch.Tensor, grasp: torch.Tensor | None
) -> torch.Tensor:
    """`pick_features` with lengths in decimetres; by default the particle nearest to a stroke's start is grasped."""
    grasp = grasped_particle(positions, strokes) if grasp is None else grasp
    features = pick_features(positions, strokes, rest, grasp)
    return torch.cat([features[..., :2], features[..., 2:] * DECIMETRE], -1)


def small_linear(inputs: int, outputs: int) -> nn.Linear:
    """A last layer that begins with small outputs: nothing moves."""
    layer = nn.Linear(inputs, outputs)
    with torch.no_grad():
        layer.weight.mul_(0.1)
        layer.bias.zero_()
    return layer


class Layer(nn.Module):
    """One round of messages to N nodes from all M >= N: features become h' [B, N, H], coordinates x' [B, N, 3].

    Message m_ij = silu(A h_i + B h_j + w [d, d0^2]); the linear layer comes after their mean, which costs k times less
    than one per edge. With `pool` the mean of all features is mixed into each first: messages alone would need half as
    many layers as an object has neighbourhoods along it to tell one end that the other is pushed.
    Source: paper, II-B (Satorras et al. 2021), with d taken anew in each layer; the mean is this project's.
    """

    def __init__(self, hidden: int, pool: bool):
        super().__init__()
        self.pool = nn.Linear(hidden, hidden, bias=False) if pool else None
        self.receive = nn.Linear(hidden, hidden)
        self.send = nn.Linear(hidden, hidden, bias=False)
        self.distance = nn.Linear(2, hidden, bias=False)
        self.update = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.SiLU(), nn.Linear(hidden, hidden))
        self.coordinate = nn.Linear(hidden, 1, bias=False)
        with torch.no_grad():
            self.coordinate.weight.mul_(0.1)

    def forward(
        self, h: torch.Tensor, x: torch.Tensor, rest2: torch.Tensor, neighbors: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        if self.pool is not None:
            h = h + self.pool(h.mean(1, keepdim=True))
        sent, all_x = self.send(h), x
        h, x = h[:, : neighbors.shape[1]], x[:, : neighbors.shape[1]]
        offset = x[:, :, None] - gather_neighbors(all_x, neighbors)
        distance = (offset.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        edge = self.distance(torch.cat([distance, rest2], -1))
        message = torch.nn.functional.silu(self.receive(h)[:, :, None] + gather_neighbors(sent, neighbors) + edge)
        x = x + (offset / (distance + 1) * self.coordinate(message)).mean(2)
        return h + self.update(torch.cat([h, message.mean(2)], -1)), x


class EGNN(nn.Module):
    """Particles after a stroke, from particles before it.

    Equivariant to rotation about z, to translation in the plane and to the order of particles; z enters as a feature and
    leaves as an output of its own, since gravity points along it.

    `action_head` adds a displacement given in the stroke's frame: the coordinate updates of a plain EGNN are combinations
    of differences between particles, so they can never move a straight rope sideways or lift a flat cloth. With `mirror`
    it is equivariant to reflection too: what the head moves to the side, it moves to the particle's or the object's own.

    Source: paper, III-B; the action-frame head and reflection are this project's.
    """

    def __init__(
        self,
        neighbors: int,
        hidden: int,
        layers: int,
        action_head: bool,
        picks: bool = False,
        pool: bool = True,
        mirror: bool = False,
    ):
        super().__init__()
        self.neighbors, self.picks, self.pool, self.mirror = neighbors, picks, pool, mirror
        self.embed = nn.Linear(FEATURES + PICK_FEATURES * picks, hidden)
        self.layers = nn.ModuleList(Layer(hidden, pool) for _ in range(layers))
        self.lift = small_linear(hidden, 1)
        self.head = None
        if action_head:
            self.head = nn.Sequential(nn.Linear(hidden, hidden), nn.SiLU(), small_linear(hidden, 3))

    def forward(
        self,
        positions: torch.Tensor,
        strokes: Strokes,
        rest: Rest | None = None,
        grasp: torch.Tensor | None = None,
        known: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Positions [B, N, 3] (m) after strokes [B].

        `rest` is the objects' (by default the positions themselves), `grasp` [B] the particle that a pick holds (by default
        the nearest to the stroke's start), `known` [B, H] what else is known of each object, added to all its features.
        """
        rest = rest or Rest.of(positions, self.neighbors)
        neighbors = rest.neighbors
        lengths = [DECIMETRE] * 4 + [1.0] * 4 + [DECIMETRE, 1.0]
        features, sides = canonical_action(positions, strokes, self.mirror)
        features = features * torch.tensor(lengths, dtype=positions.dtype, device=positions.device)
        if self.picks:
            features = torch.cat([features, scaled_pick_features(positions, strokes, rest.positions, grasp)], -1)
        h = self.embed(features)
        if known is not None:
            h = h + known[:, None]
        x = start = (positions - positions.mean(1, keepdim=True)) * DECIMETRE
        rest2 = (x[:, :, None] - gather_neighbors(x, neighbors)).square().sum(-1, keepdim=True)
        for layer in self.layers:
            h, x = layer(h, x, rest2, neighbors)
        if self.head is not None:
            ahead, aside = self.head(h).split([1, 2], -1)
            planar = torch.cat([ahead, (aside * sides).sum(-1, keepdim=True)], -1)
            planar = planar @ strokes.rotation.transpose(1, 2)
            x = x + torch.cat([planar, self.lift(h)], -1)
        else:
            x = x + torch.cat([torch.zeros_like(x[..., :2]), self.lift(h)], -1)
        return positions + (x - start) / DECIMETRE
