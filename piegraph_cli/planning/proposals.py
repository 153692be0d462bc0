"""Strokes by contact: a heading, a lateral offset and a length become a push that starts just off the object."""

import math
from dataclasses import dataclass

import torch

CLEARANCE = 0.008
"""Metres between the pusher's start and its first contact."""


@dataclass(frozen=True)
class PushSpace:
    """The proposals [B, 3]: heading [rad], lateral offset as a share of the object's half width (-1 to 1), length [m]."""

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

        First contact is that of a disc against the particles; since these are samples of a surface, the disc is wider
        than the pusher by half their spacing. Infeasible: the disc passes by, or an end leaves the workspace.
        """
        heading, share, length = proposals.unbind(-1)
        along = torch.stack([heading.cos(), heading.sin()], -1)
        across = torch.stack([-heading.sin(), heading.cos()], -1)
        planar = positions[..., :2]
        centre = planar.mean(1)
        relative = planar - centre[:, None]
        depth = (relative * along[:, None]).sum(-1)
        side = (relative * across[:, None]).sum(-1)
        middle, half = (side.amax(1) + side.amin(1)) / 2, (side.amax(1) - side.amin(1)) / 2
        offset = middle + share * half
        radius = self.pusher_radius + half_spacing(positions[0])
        reach = radius**2 - (side - offset[:, None]).square()
        contact = torch.where(reach > 0, depth - reach.clamp(min=0).sqrt(), torch.inf).amin(1)
        hit = contact.isfinite()
        first = torch.where(hit, contact, 0.0) - CLEARANCE
        start = centre + along * first[:, None] + across * offset[:, None]
        end = start + along * length[:, None]
        strokes = torch.cat([start, end, torch.zeros_like(length)[:, None]], -1)
        return strokes, hit & self._inside(start) & self._inside(end)

    def _inside(self, points: torch.Tensor) -> torch.Tensor:
        xmin, xmax, ymin, ymax = self.workspace[:4]
        x, y = points.unbind(-1)
        return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)


def half_spacing(positions: torch.Tensor) -> float:
    """Half the median distance [m] of a particle [N, 3] to its nearest neighbour."""
    distances = torch.cdist(positions, positions)
    distances.fill_diagonal_(torch.inf)
    return float(distances.amin(1).median()) / 2
