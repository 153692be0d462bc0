"""Particle-Grid Neural Dynamics: particles carry features, a grid around them a velocity field that moves them, frame by frame.

Only grid nodes next to a particle are ever made: a few hundred of 125,000.
Source: the paper's baseline PGND; sizes and rules as the method notes in docs/method.md give them.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import DECIMETRE, small_linear
from piegraph_cli.dynamics.examples import Step, Window
from piegraph_cli.dynamics.losses import mean_seen
from piegraph_cli.dynamics.params import PGNDParams
from piegraph_cli.params import PICK

FRAME = 0.1
"""Seconds between frames, whatever the hand's pace was: pushes are quasi-static."""
OCTAVES = 5
NODES = 50
"""Grid nodes along each axis."""
WALL = 3
"""Nodes next to a wall of the grid, the table among them, through which nothing flows outwards."""


def _mlp(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in pairwise(sizes):
        layers += [nn.Linear(a, b), nn.ReLU(True)]
    return nn.Sequential(*layers[:-1])


RING = 4
HEIGHTS = (0.01, 0.03)
"""Points on a pusher: so many around its axis, at these heights above the table (m)."""


class Tool(NamedTuple):
    """Where the hand is [B, 2] (m), how it moves in one frame [B, 2] (m), and whether it holds [B]."""

    place: Tensor
    motion: Tensor
    holds: Tensor


class _Align(nn.Module):
    """A 3 x 3 matrix from a cloud [B, N, 3], near the identity: PointNet's T-net."""

    def __init__(self):
        super().__init__()
        self.points = nn.Sequential(_mlp(3, 64, 128, 1024))
        self.matrix = nn.Sequential(_mlp(1024, 512, 256), nn.ReLU(), small_linear(256, 9))

    def forward(self, points: Tensor) -> Tensor:
        matrix = self.matrix(self.points(points).amax(1).relu()).view(-1, 3, 3)
        return matrix + torch.eye(3, dtype=points.dtype, device=points.device)


def stencil(positions: Tensor, cell: float) -> tuple[Tensor, Tensor]:
    """Grid nodes [..., 27, 3] (int64) around positions [..., 3] (m) and their quadratic B-spline weights [..., 27]."""
    scaled = positions / cell
    base = (scaled - 0.5).floor()
    local = scaled - base
    weights = torch.stack([0.5 * (1.5 - local) ** 2, 0.75 - (local - 1) ** 2, 0.5 * (local - 0.5) ** 2], -1)
    steps = torch.arange(3, device=positions.device)
    offsets = torch.cartesian_prod(steps, steps, steps)
    x, y, z = weights.unbind(-2)
    product = x[..., :, None, None] * y[..., None, :, None] * z[..., None, None, :]
    return base.long()[..., None, :] + offsets, product.flatten(-3)


def active_nodes(nodes: Tensor) -> tuple[Tensor, Tensor]:
    """The distinct ones of nodes [B, K, 3], scene by scene: [B, M, 3], and where each of the K is among them [B, K].

    Scenes with fewer than M repeat a node that nothing points to.
    """
    inside = nodes.clamp(0, NODES - 1)
    corner = inside.amin((0, 1))
    size = inside.amax((0, 1)) - corner + 1
    x, y, z = (inside - corner).unbind(-1)
    linear = (x * size[1] + y) * size[2] + z
    taken = torch.zeros(len(nodes), int(size.prod()), dtype=torch.bool, device=nodes.device).scatter_(1, linear, True)
    number = taken.cumsum(1)
    code, end = taken.nonzero()[:, 1], number[:, -1].cumsum(0)
    begin = end - number[:, -1]
    most = torch.arange(int(number[:, -1].max()), device=nodes.device)
    code = code[torch.minimum(begin[:, None] + most, end[:, None] - 1)]
    found = torch.stack([code // (size[1] * size[2]), code // size[2] % size[1], code % size[2]], -1) + corner
    return found, number.gather(1, linear) - 1


class PGND(nn.Module):
    """The velocity field of a grid around particles, and the particles' motion in it."""

    def __init__(self, params: PGNDParams):
        super().__init__()
        self.params = params
        self.align = _Align()
        self.encode = _mlp(6 * (params.history + 1), 64, 128, 64)
        self.decode = nn.Sequential(_mlp(3 + 6 * OCTAVES + 64, 64, 64, 32), nn.ReLU(), small_linear(32, 3))

    def features(self, past: Tensor, centre: Tensor) -> Tensor:
        """Features [B, N, 64] of particles from their frames [B, frames, N, 3] (m, newest last), the object at `centre`.

        In decimetres inside, which replaces normalised layers: learning from metres takes several times as many steps.
        """
        x = past[:, 1:] - centre[:, None, None]
        velocity = 2 * (past[:, 1:] - past[:, :-1]) / FRAME
        x, velocity = x.flip(1), velocity.flip(1)
        aligned = x[:, 0] @ self.align(x[:, 0] * DECIMETRE)
        rows = [aligned, velocity[:, 0], *x[:, 1:].unbind(1), *velocity[:, 1:].unbind(1)]
        return self.encode(torch.cat(rows, -1) * DECIMETRE)

    def pusher(self, hand: Tensor, motion: Tensor) -> Tensor:
        """Frames [B, frames, P, 3] (m, newest last) of the points on a pusher that is at `hand` [B, 2] (m) now.

        It goes straight on, by `motion` [B, 2] (m) from frame to frame: its velocity is that of the step to come.
        """
        angles = torch.arange(RING, device=hand.device) * (2 * math.pi / RING)
        ring = self.params.pusher * torch.stack([angles.cos(), angles.sin()], -1).to(hand)
        back = torch.arange(self.params.frames - 1, -1, -1, device=hand.device).to(hand)
        axis = hand[:, None] - back[None, :, None] * motion[:, None]
        plane = (axis[:, :, None] + ring).repeat(1, 1, len(HEIGHTS), 1)
        heights = hand.new_tensor(HEIGHTS).repeat_interleave(RING).expand(*plane.shape[:-1])
        return torch.cat([plane, heights[..., None]], -1)

    def field(
        self, nodes: Tensor, positions: Tensor, counts: Tensor, features: Tensor, centre: Tensor, tool: Tool
    ) -> Tensor:
        """Velocities [B, M, 3] (m/s) at nodes [B, M, 3] (int64, numbers along the grid's axes).

        positions [B, P, 3] (m, of the grid's frame) of particles and the pusher's points, of which `counts` [B, P] are
        there, with their features [B, P, 64]; the object's centre [B, 3], on the table. Nodes near a tool that holds take
        its velocity.
        """
        grid, nodes = nodes, nodes.to(positions) * self.params.cell
        near = torch.cdist(nodes, positions.detach()).lt_(self.params.reach).mul_(counts[:, None])
        near /= near.sum(-1, keepdim=True).clamp_min_(1)
        # the first layer is linear: of a node's features it is the mean of what it makes of particles, of its place the
        # sum of what it makes of the three numbers, so that it is worked out for a hundred rows in place of all nodes
        layers = self.decode[0]
        assert isinstance(layers, nn.Sequential)
        first = layers[0]
        assert isinstance(first, nn.Linear)
        rows, which = [features @ first.weight[:, -features.shape[-1] :].T], [near]
        for axis in range(3):
            low, high = grid[..., axis].aminmax()
            along = torch.arange(int(low), int(high) + 1, device=nodes.device)
            place = (along.to(nodes) * self.params.cell - centre[:, axis, None])[..., None] * math.pi
            waves = torch.cat([place * 2**k for k in range(OCTAVES)], -1)
            of_axis = first.weight[:, axis : 3 + 6 * OCTAVES : 3]
            rows.append(torch.cat([place, waves.sin(), waves.cos()], -1) @ of_axis.T)
            which.append((grid[..., axis, None] == along).to(nodes))
        hidden = first.bias + torch.cat(which, -1) @ torch.cat(rows, 1)
        velocity = self.decode[1:](layers[1:](hidden))
        held = (nodes[..., :2] - tool.place[:, None]).norm(dim=-1, keepdim=True) < self.params.gripper
        held = held & tool.holds[:, None, None]
        rigid = torch.nn.functional.pad(tool.motion / FRAME, (0, 1))[:, None]
        velocity = torch.where(held, rigid, velocity)
        edge = (WALL + 0.5) * self.params.cell
        far = NODES * self.params.cell - edge
        velocity = torch.where(nodes < edge, velocity.clamp_min(0), velocity)
        return torch.where(nodes > far, velocity.clamp_max(0), velocity)

    def step(self, past: Tensor, hand: Tensor, after: Tensor, mode: Tensor) -> Tensor:
        """Particles [B, N, 3] one frame later, while the hand goes from `hand` to `after` [B, 2] (m); mode [B]."""
        cell, particles = self.params.cell, past.shape[2]
        picks = mode == PICK
        centre = torch.nn.functional.pad(past[:, -1].mean(1)[:, :2], (0, 1))
        origin = past.new_tensor([NODES * cell / 2, NODES * cell / 2, WALL * cell]) - centre
        pusher = self.pusher(hand, after - hand)
        # a pick has no pusher: a particle again in its place, which no node counts
        pusher = torch.where(picks[:, None, None, None], past[:, :, :1], pusher)
        both = torch.cat([past, pusher], 2)
        pushes = (~picks)[:, None].expand(-1, pusher.shape[2])
        counts = torch.cat([torch.ones_like(past[:, -1, :, 0], dtype=torch.bool), pushes], 1)
        x = both[:, -1] + origin[:, None]
        touched, weights = stencil(x[:, :particles], cell)
        nodes, place = active_nodes(touched.flatten(1, 2))
        tool = Tool(hand + origin[:, :2], after - hand, picks)
        velocity = self.field(nodes, x, counts, self.features(both, centre), centre + origin, tool)
        share = weights.new_zeros(*weights.shape[:2], nodes.shape[1]).scatter(2, place.view(weights.shape), weights)
        return past[:, -1] + FRAME * (share @ velocity)

    def loss(self, window: Window, step: Step | None = None) -> Tensor:
        """100 times the mean squared particle error (m^2) over the frames of a window.

        Of `step` in place of the network's own, where one is given.
        """
        step = step or self.step
        past, total = window.past, window.past.new_zeros(())
        for k in range(window.future.shape[1]):
            x = step(past, window.hand[:, k], window.hand[:, k + 1], window.mode)
            error = mean_seen((x - window.future[:, k]).square().sum(-1), window.known(k))
            total = total + 100 * (error * window.valid[:, k]).mean()
            past = torch.cat([past[:, 1:], x[:, None]], 1)
        return total / window.future.shape[1]
