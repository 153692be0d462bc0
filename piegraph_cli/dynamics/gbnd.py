"""Graph-based neural dynamics: messages between near particles and nodes on the tool, frame by frame.

Source: the baselines PropNet and AdaptiGraph, in the sizes that docs/method.md gives.
"""

import math

import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import DECIMETRE, gather_neighbors, small_linear
from piegraph_cli.dynamics.examples import Step, Window
from piegraph_cli.dynamics.losses import mean_seen
from piegraph_cli.dynamics.params import GBNDParams
from piegraph_cli.params import PICK

ROUNDS = 3
"""Propagation steps."""
TOOL_HEIGHT = 0.01
"""Metres above the table."""
RING = 4
"""Nodes on the tool, around its axis."""
SCALE = 20.0
"""Displacements of one frame are some centimetres: in the network they are in units of 5 cm."""


def _encoder(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(True), nn.Linear(width, width), nn.ReLU(True))


class GBND(nn.Module):
    """Particles one frame later, from their last frames and the tool's motion."""

    def __init__(self, params: GBNDParams):
        super().__init__()
        self.params = params
        width = params.hidden
        self.nodes = _encoder(3 * params.history + 1 + 2 + 3 + 1, width)
        self.edges = _encoder(3 + 1 + 1, width)
        self.receive, self.send = nn.Linear(width, width), nn.Linear(width, width, bias=False)
        self.relate = nn.Linear(width, width, bias=False)
        self.update = nn.Linear(2 * width, width)
        self.head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), small_linear(width, 3))

    def tool(self, hand: Tensor, mode: Tensor) -> Tensor:
        """Nodes [B, RING, 3] (m) on a tool at `hand` [B, 2] (m): around a pusher, all in one place where it holds."""
        angles = torch.arange(RING, device=hand.device) * (2 * math.pi / RING)
        ring = self.params.pusher * torch.stack([angles.cos(), angles.sin()], -1).to(hand)
        place = hand[:, None] + torch.where((mode == PICK)[:, None, None], torch.zeros_like(ring), ring)
        return torch.nn.functional.pad(place, (0, 1), value=TOOL_HEIGHT)

    def neighbors(self, positions: Tensor) -> tuple[Tensor, Tensor]:
        """The nearest other particles [B, N, k] of every particle, and how far away they are [B, N, k] (m)."""
        count = min(self.params.neighbors, positions.shape[1] - 1)
        distances = torch.cdist(positions, positions)
        distances.diagonal(dim1=-2, dim2=-1).fill_(torch.inf)
        nearest, neighbors = distances.topk(count, largest=False)
        return neighbors, nearest

    def graph(self, positions: Tensor, tool: Tensor) -> tuple[Tensor, Tensor]:
        """Neighbours [B, N, k + RING] of every particle, the tool's nodes (from index N on) last, and which are near."""
        neighbors, nearest = self.neighbors(positions)
        apart = torch.cdist(positions[..., :2], tool[..., :2])
        number = positions.shape[1] + torch.arange(RING, device=tool.device).expand(apart.shape)
        return torch.cat([neighbors, number], -1), torch.cat([nearest, apart], -1) < self.params.radius

    @staticmethod
    def links(neighbors: Tensor, near: Tensor) -> tuple[Tensor, Tensor]:
        """Receivers and senders [E] of the edges that are near, of `graph`: what is not near costs nothing.

        Rows of particles [B * N], and of particles and tool [B * (N + RING)].
        """
        _, particles, _ = near.shape
        scene, particle, slot = near.nonzero(as_tuple=True)
        return scene * particles + particle, scene * (particles + RING) + neighbors[scene, particle, slot]

    def step(self, past: Tensor, hand: Tensor, after: Tensor, mode: Tensor) -> Tensor:
        """Particles [B, N, 3] one frame later; past [B, frames, N, 3], hand and where it goes [B, 2] (m), mode [B]."""
        x = past[:, -1]
        batch, particles, _ = x.shape
        place = self.tool(hand, mode)
        receiver, sender = self.links(*self.graph(x.detach(), place))
        before = 3 * self.params.history
        moved = (past[:, 1:] - past[:, :-1]).transpose(1, 2).flatten(2) * SCALE
        own = torch.cat([moved, x[..., 2:] * DECIMETRE], -1)
        own = torch.nn.functional.pad(own, (0, 6)) + x.new_tensor([0.0] * (before + 1) + [1, 0, 0, 0, 0, 0])
        motion = torch.nn.functional.pad((after - hand) * SCALE, (0, 1))
        kind = x.new_tensor([0.0] * before + [TOOL_HEIGHT * DECIMETRE, 0, 1]).expand(batch, -1)
        tool = self.nodes(torch.cat([kind, motion, mode[:, None].to(x)], -1))
        first = self.nodes(own.flatten(0, 1))
        there = torch.cat([x, place], 1).flatten(0, 1)
        offset = (x.flatten(0, 1).index_select(0, receiver) - there.index_select(0, sender)) * DECIMETRE
        is_tool = (sender % (particles + RING) >= particles).to(x)[:, None]
        edges = self.edges(torch.cat([offset, (offset.square().sum(-1, keepdim=True) + 1e-12).sqrt(), is_tool], -1))
        relation, of_tool = self.relate(edges), self.send(tool)[:, None].expand(-1, RING, -1)
        unchanging, of_sum = self.update.weight.split(first.shape[1], 1)
        kept, h = torch.nn.functional.linear(first, unchanging, self.update.bias), first
        for _ in range(ROUNDS):
            sent = torch.cat([self.send(h).view(batch, particles, -1), of_tool], 1).flatten(0, 1)
            message = self.receive(h).index_select(0, receiver).add_(relation).add_(sent.index_select(0, sender))
            gathered = torch.zeros_like(first).index_add_(0, receiver, message.relu_())
            h = torch.relu(kept + gathered @ of_sum.T + h)
        return x + self.head(h).view_as(x) / SCALE

    def loss(self, window: Window, step: Step | None = None) -> Tensor:
        """Mean squared particle error plus `edge_weight` times that of neighbours' distances, in dm^2.

        Of `step` in place of the network's own, where one is given.
        """
        step = step or self.step
        past, total = window.past, window.past.new_zeros(())
        for k in range(window.future.shape[1]):
            target, seen = window.future[:, k], window.known(k)
            x = step(past, window.hand[:, k], window.hand[:, k + 1], window.mode)
            error = mean_seen(((x - target) * DECIMETRE).square().sum(-1), seen)
            neighbors, _ = self.neighbors(target)
            lengths = [
                ((p[:, :, None] - gather_neighbors(p, neighbors)).square().sum(-1) + 1e-12).sqrt() for p in (x, target)
            ]
            stretch = ((lengths[0] - lengths[1]) * DECIMETRE).square()
            if seen is not None:
                stretch = stretch * gather_neighbors(seen[..., None].to(stretch), neighbors)[..., 0]
            stretch = mean_seen(stretch.mean(-1), seen)
            total = total + ((error + self.params.edge_weight * stretch) * window.valid[:, k]).mean()
            past = torch.cat([past[:, 1:], x[:, None]], 1)
        return total / window.future.shape[1]
