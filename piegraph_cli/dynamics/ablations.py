"""Graph networks that the paper compares with: the stroke as nodes, and no equivariance."""

import torch
from torch import nn

from piegraph_cli.dynamics.action import PICK_FEATURES
from piegraph_cli.dynamics.egnn import DECIMETRE, Layer, Rest, gather_neighbors, scaled_pick_features, small_linear
from piegraph_cli.dynamics.stroke import Strokes


class ActionNodeEGNN(nn.Module):
    """An EGNN that sees the stroke as two more nodes, its start and its end, in place of canonical actions.

    Both send messages to every particle and stay where they are; differences to them are what lets particles move as one.
    Source: paper, IV-B, ablation EGNN+G.
    """

    def __init__(self, neighbors: int, hidden: int, layers: int, picks: bool = False, pool: bool = True):
        super().__init__()
        self.neighbors, self.picks = neighbors, picks
        self.embed = nn.Linear(5 + PICK_FEATURES * picks, hidden)
        self.layers = nn.ModuleList(Layer(hidden, pool) for _ in range(layers))
        self.lift = small_linear(hidden, 1)

    def forward(
        self,
        positions: torch.Tensor,
        strokes: Strokes,
        rest: Rest | None = None,
        grasp: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """As `EGNN.forward`."""
        rest = rest or Rest.of(positions, self.neighbors)
        batch, particles, _ = positions.shape
        middle = positions.mean(1, keepdim=True)
        ends = torch.cat([strokes.ends, middle[..., 2:].expand(-1, 2, -1)], -1)
        kinds = torch.eye(3, dtype=positions.dtype, device=positions.device)
        kinds = torch.cat([kinds[:1].expand(particles, -1), kinds[1:]])[None].expand(batch, -1, -1)
        x = torch.cat([positions, ends], 1)
        mode = strokes.mode.to(positions)[:, None, None].expand(-1, particles + 2, -1)
        features = torch.cat([kinds, x[..., 2:] * DECIMETRE, mode], -1)
        if self.picks:
            more = scaled_pick_features(positions, strokes, rest.positions, grasp)
            features = torch.cat([features, torch.nn.functional.pad(more, (0, 0, 0, 2))], -1)
        h = self.embed(features)
        x = (x - middle) * DECIMETRE
        start, x, fixed = x[:, :particles], x[:, :particles], x[:, particles:]
        sent = torch.arange(particles, particles + 2, device=positions.device).expand(batch, particles, 2)
        neighbors = torch.cat([rest.neighbors.expand(batch, -1, -1), sent], -1)
        nodes, action = torch.cat([x, fixed], 1), h[:, particles:]
        rest2 = (x[:, :, None] - gather_neighbors(nodes, neighbors)).square().sum(-1, keepdim=True)
        for layer in self.layers:
            h, x = layer(h, nodes, rest2, neighbors)
            h, nodes = torch.cat([h, action], 1), torch.cat([x, fixed], 1)
        lift = self.lift(h[:, :particles])
        x = x + torch.cat([torch.zeros_like(x[..., :2]), lift], -1)
        return positions + (x - start) / DECIMETRE


class GNN(nn.Module):
    """A graph network without equivariance: it sees particles and stroke along the world's axes, from the object's middle."""

    def __init__(self, neighbors: int, hidden: int, layers: int, picks: bool = False, pool: bool = True):
        super().__init__()
        self.neighbors, self.picks = neighbors, picks
        self.embed = nn.Linear(8 + PICK_FEATURES * picks, hidden)
        self.pool = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(layers)) if pool else None
        self.edges = nn.ModuleList(nn.Linear(4, hidden, bias=False) for _ in range(layers))
        self.receive = nn.ModuleList(nn.Linear(hidden, hidden) for _ in range(layers))
        self.send = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(layers))
        self.update = nn.ModuleList(
            nn.Sequential(nn.Linear(2 * hidden, hidden), nn.SiLU(), nn.Linear(hidden, hidden)) for _ in range(layers)
        )
        self.head = nn.Sequential(nn.Linear(hidden, hidden), nn.SiLU(), small_linear(hidden, 3))

    def forward(
        self,
        positions: torch.Tensor,
        strokes: Strokes,
        rest: Rest | None = None,
        grasp: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """As `EGNN.forward`."""
        rest = rest or Rest.of(positions, self.neighbors)
        batch, particles, _ = positions.shape
        middle = positions[..., :2].mean(1)
        ends = (strokes.ends - middle[:, None]).flatten(1) * DECIMETRE
        x = torch.cat([positions[..., :2] - middle[:, None], positions[..., 2:]], -1) * DECIMETRE
        shared = torch.cat([ends, strokes.mode.to(positions)[:, None]], -1)[:, None].expand(-1, particles, -1)
        features = torch.cat([x, shared], -1)
        if self.picks:
            features = torch.cat([features, scaled_pick_features(positions, strokes, rest.positions, grasp)], -1)
        h = self.embed(features)
        neighbors = rest.neighbors.expand(batch, -1, -1)
        offset = x[:, :, None] - gather_neighbors(x, neighbors)
        edge = torch.cat([offset, (offset.square().sum(-1, keepdim=True) + 1e-12).sqrt()], -1)
        for k, (edges, receive, send, update) in enumerate(
            zip(self.edges, self.receive, self.send, self.update, strict=True)
        ):
            if self.pool is not None:
                h = h + self.pool[k](h.mean(1, keepdim=True))
            message = receive(h)[:, :, None] + gather_neighbors(send(h), neighbors) + edges(edge)
            h = h + update(torch.cat([h, torch.nn.functional.silu(message).mean(2)], -1))
        return positions + self.head(h) / DECIMETRE
