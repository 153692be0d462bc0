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
    stroke_rotation,
)

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
    """Values [B, N, C] of every particle's neighbours [B, N, k]: [B, N, k, C]."""
    batch, particles, count = neighbors.shape
    offsets = torch.arange(batch, device=values.device)[:, None, None] * particles
    flat = values.reshape(batch * particles, -1).index_select(0, (neighbors + offsets).reshape(-1))
    return flat.view(batch, particles, count, -1)


class Layer(nn.Module):
    """One round of messages: features become h' [B, N, H], coordinates x' [B, N, 3].

    Message m_ij = silu(A h_i + B h_j + w [d, d0^2]); the linear layer comes after their mean, which costs k times less
    than one per edge. Source: paper, II-B (Satorras et al. 2021), with d taken anew in each layer.
    """

    def __init__(self, hidden: int):
        super().__init__()
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
        offset = x[:, :, None] - gather_neighbors(x, neighbors)
        distance = (offset.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        edge = self.distance(torch.cat([distance, rest2], -1))
        message = torch.nn.functional.silu(
            self.receive(h)[:, :, None] + gather_neighbors(self.send(h), neighbors) + edge
        )
        x = x + (offset / (distance + 1) * self.coordinate(message)).mean(2)
        return h + self.update(torch.cat([h, message.mean(2)], -1)), x


class EGNN(nn.Module):
    """Particles after a stroke, from particles before it.

    Equivariant to rotation about z, to translation in the plane and to the order of particles; z enters as a feature and
    leaves as an output of its own, since gravity points along it.

    `action_head` adds a displacement given in the stroke's frame: the coordinate updates of a plain EGNN are combinations
    of differences between particles, so they can never move a straight rope sideways or lift a flat cloth.

    Source: paper, III-B; the action-frame head is this project's.
    """

    def __init__(self, neighbors: int, hidden: int, layers: int, action_head: bool, picks: bool = False):
        super().__init__()
        self.neighbors, self.picks = neighbors, picks
        self.embed = nn.Linear(FEATURES + PICK_FEATURES * picks, hidden)
        self.layers = nn.ModuleList(Layer(hidden) for _ in range(layers))
        self.lift = nn.Linear(hidden, 1)
        self.head = nn.Sequential(nn.Linear(hidden, hidden), nn.SiLU(), nn.Linear(hidden, 2)) if action_head else None
        with torch.no_grad():
            for name, parameter in self.named_parameters():
                if name.startswith(("lift.", "head.2.")):
                    parameter.mul_(0.1 if name.endswith("weight") else 0.0)

    def forward(
        self,
        positions: torch.Tensor,
        strokes: torch.Tensor,
        rest: Rest | None = None,
        grasp: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Positions [B, N, 3] (m) after strokes [B, 7].

        `rest` is the objects' (by default the positions themselves), `grasp` [B] the particle that a pick holds (by default
        the nearest to the stroke's start).
        """
        rest = rest or Rest.of(positions, self.neighbors)
        neighbors = rest.neighbors
        scale = torch.tensor([DECIMETRE] * 4 + [1.0], dtype=positions.dtype, device=positions.device)
        features = canonical_action(positions, strokes) * scale
        if self.picks:
            grasp = grasped_particle(positions, strokes) if grasp is None else grasp
            more = pick_features(positions, strokes, rest.positions, grasp)
            features = torch.cat([features, more[..., :2], more[..., 2:] * DECIMETRE], -1)
        h = self.embed(features)
        x = start = (positions - positions.mean(1, keepdim=True)) * DECIMETRE
        rest2 = (x[:, :, None] - gather_neighbors(x, neighbors)).square().sum(-1, keepdim=True)
        for layer in self.layers:
            h, x = layer(h, x, rest2, neighbors)
        if self.head is not None:
            planar = self.head(h) @ stroke_rotation(strokes).transpose(1, 2)
            x = x + torch.cat([planar, self.lift(h)], -1)
        else:
            x = x + torch.cat([torch.zeros_like(x[..., :2]), self.lift(h)], -1)
        return positions + (x - start) / DECIMETRE
