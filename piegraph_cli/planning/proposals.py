"""Strokes by contact: a heading, a lateral offset and a length become a push that starts just off the object."""

import math
from dataclasses import dataclass

import torch

CLEARANCE = 0.008
"""Metres between the pusher's start and its first contact."""


MARGIN = 0.002
"""Metres added to the pusher's radius for what the particles do not show of the object."""

NEIGHBORS = 8
"""Particles joined to each one to fill the gaps between them."""


@dataclass(frozen=True)
class PushSpace:
    """The proposals [B, 3]: heading [rad], lateral offset as a share of the object's half width (-1 to 1), length [m]."""

    edges: torch.Tensor
    """[E, 2] particles between which the object has no gap, see `solid_edges`."""
    min_length: float
    max_length: float
    pusher_radius: float
    workspace: tuple[float, ...]
    """xmin, xmax, ymin, ymax, ... [m]: a stroke's ends stay inside."""

    def sample(self, shape: tuple[int, ...], generator: torch.Generator) -> torch.Tensor:
        """Uniform proposals [*shape, 3]."""
        unit = torch.rand(*shape, 3, generator=generator)
        low = torch.tensor([-math.pi, -1.0, self.min_length])
        high = torch.tensor([math.pi, 1.0, self.max_length])
        return low + unit * (high - low)

    def clip(self, proposals: torch.Tensor) -> torch.Tensor:
        """Proposals brought back into the space; headings wrap around."""
        heading, offset, length = proposals.unbind(-1)
        heading = torch.remainder(heading + math.pi, 2 * math.pi) - math.pi
        return torch.stack([heading, offset.clamp(-1, 1), length.clamp(self.min_length, self.max_length)], -1)

    def strokes(self, positions: torch.Tensor, proposals: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Strokes [B, 5] (m) on positions [B, N, 3] (m), and whether each is feasible [B].

        First contact is that of the pusher's disc against the particles and the edges between them. Infeasible: the disc
        passes by, or an end leaves the workspace.
        """
        heading, share, length = proposals.unbind(-1)
        along = torch.stack([heading.cos(), heading.sin()], -1)
        across = torch.stack([-heading.sin(), heading.cos()], -1)
        planar = self._filled(positions[..., :2])
        centre = planar.mean(1)
        relative = planar - centre[:, None]
        depth = (relative * along[:, None]).sum(-1)
        side = (relative * across[:, None]).sum(-1)
        middle, half = (side.amax(1) + side.amin(1)) / 2, (side.amax(1) - side.amin(1)) / 2
        offset = middle + share * half
        reach = (self.pusher_radius + MARGIN) ** 2 - (side - offset[:, None]).square()
        contact = torch.where(reach > 0, depth - reach.clamp(min=0).sqrt(), torch.inf).amin(1)
        hit = contact.isfinite()
        first = torch.where(hit, contact, 0.0) - CLEARANCE
        start = centre + along * first[:, None] + across * offset[:, None]
        end = start + along * length[:, None]
        strokes = torch.cat([start, end, torch.zeros_like(length)[:, None]], -1)
        return strokes, hit & self._inside(start) & self._inside(end)

    def _filled(self, planar: torch.Tensor) -> torch.Tensor:
        """Particles [B, N, 2] and points on the edges between them."""
        first, second = planar[:, self.edges[:, 0]], planar[:, self.edges[:, 1]]
        return torch.cat([planar, *((1 - t) * first + t * second for t in (0.25, 0.5, 0.75))], 1)

    def _inside(self, points: torch.Tensor) -> torch.Tensor:
        xmin, xmax, ymin, ymax = self.workspace[:4]
        x, y = points.unbind(-1)
        return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)


def solid_edges(positions: torch.Tensor) -> torch.Tensor:
    """Edges [E, 2] from each particle of [N, 3] (m) to near ones: at most twice the usual spacing long in the plane."""
    distances = torch.cdist(positions[:, :2], positions[:, :2])
    distances.fill_diagonal_(torch.inf)
    near = distances.topk(min(NEIGHBORS, len(positions) - 1), largest=False)
    spacing = torch.cdist(positions, positions).fill_diagonal_(torch.inf).amin(1).median()
    owner = torch.arange(len(positions))[:, None].expand_as(near.indices)
    pairs = torch.stack([owner, near.indices], -1)[near.values <= 2 * spacing]
    return torch.unique(pairs.sort(-1).values, dim=0)
