"""Candidate strokes by contact: a few numbers become a push that starts just off the object, or a pick at a particle."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.kernels.lanes import in_parts
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.planning.path import hits, tool_boxes

CLEARANCE = 0.008
"""Metres between the pusher's start and its first contact."""

DEPTH = 0.7
"""How far a push goes into the object at least, in radii of the pusher. What only grazes it moves it by a millimetre or
two, where models promise centimetres, and planning then repeats a stroke that does nothing."""

NEIGHBORS = 8
"""Particles joined to each one to fill the gaps between them."""

TINY = torch.finfo(torch.float32).tiny
"""In place of zero under a root that nobody asks for: PyTorch takes four times as long for the root of zero."""

SHORTEST = 1e-6
"""Metres; below it a carry has no direction and gets that of x."""

PART = 64
"""Candidates whose contacts a core of a CPU looks for at a time, so that their points stay in its cache."""

NUMBERS = 5
"""Of a proposal: the mode, then of a push heading [rad], lateral offset as a share of the object's half width (-1 to 1),
length [m] and nothing; of a pick two shares (-1 to 1) of the object's half extents in x and y, which the nearest particle
is grasped to, and how far it is carried in x and y [m]."""


@dataclass(frozen=True)
class StrokeSpace:
    """The proposals [B, 5], see `NUMBERS`, and the strokes they stand for."""

    modes: tuple[int, ...]
    """0 push, 1 pick."""
    edges: torch.Tensor
    """[E, 2] particles between which the object has no gap, see `solid_edges`."""
    min_length: float
    """Of any stroke, metres."""
    max_length: float
    """Of a push, metres."""
    max_carry: float
    """Of a pick along x and along y, metres."""
    pusher_radius: float
    margin: float
    """How far the object reaches beyond its particles, metres."""
    workspace: tuple[float, ...]
    """xmin, xmax, ymin, ymax, ... [m]: a stroke's ends stay inside."""
    retreat: float = 0.0
    """How far a push goes back along itself before the tool rises, metres."""
    keep_out: tuple[tuple[float, ...], ...] = ()
    """xmin, xmax, ymin, ymax, zmin, zmax [m]: boxes that the tool does not enter."""

    @cached_property
    def _bounds(self) -> dict[int, tuple[torch.Tensor, torch.Tensor]]:
        """Of the four numbers of each mode."""
        carry = self.max_carry
        ranges = {
            PUSH: ([-math.pi, -1.0, self.min_length, 0.0], [math.pi, 1.0, self.max_length, 0.0]),
            PICK: ([-1.0, -1.0, -carry, -carry], [1.0, 1.0, carry, carry]),
        }
        device = self.edges.device
        return {
            m: (torch.tensor(low, device=device), torch.tensor(high, device=device))
            for m, (low, high) in ranges.items()
        }

    def sample(self, shape: tuple[int, ...], generator: torch.Generator) -> torch.Tensor:
        """Uniform proposals [*shape, 5], the modes equally often."""
        device = generator.device
        unit = torch.rand(*shape, 4, generator=generator, device=device)
        choice = torch.zeros(shape, device=device)
        if len(self.modes) > 1:
            choice = torch.randint(len(self.modes), shape, generator=generator, device=device)
        mode = torch.tensor(self.modes, device=device)[choice.long()]
        values = unit
        for m in self.modes:
            low, high = self._bounds[m]
            values = torch.where((mode == m)[..., None], low + unit * (high - low), values)
        return torch.cat([mode[..., None].to(values), values], -1)

    def refit(
        self,
        proposals: torch.Tensor,
        weights: torch.Tensor,
        noise: float | None,
        count: int,
        generator: torch.Generator,
    ) -> torch.Tensor:
        """Draw [count, H, 5] around weighted proposals [B, H, 5], weights [B] summing to 1, for each step of the horizon.

        The modes are drawn as often as their weight; the numbers from a Gaussian per mode, fitted to the weighted proposals,
        headings around that of the heaviest. `noise` fixes the deviation as a share of the range; None fits it too.
        """
        drawn = [self._refit_step(step, weights, noise, count, generator) for step in proposals.unbind(1)]
        return torch.stack(drawn, 1)

    def _refit_step(
        self,
        proposals: torch.Tensor,
        weights: torch.Tensor,
        noise: float | None,
        count: int,
        generator: torch.Generator,
    ) -> torch.Tensor:
        shares = torch.stack(
            [weights[proposals[:, 0] == m].sum() if self._mixed else weights.sum() for m in self.modes]
        )
        choice = torch.multinomial(shares, count, replacement=True, generator=generator)
        normal = torch.randn(count, 4, generator=generator, device=proposals.device)
        drawn = proposals.new_empty(count, NUMBERS)
        for k, mode in enumerate(self.modes):
            here: Any = slice(None)
            own: Any = slice(None)
            if self._mixed:
                here, own = choice == k, proposals[:, 0] == mode
                if not here.any():
                    continue
            values, weight = proposals[own, 1:].clone(), weights[own, None] / shares[k]
            if mode == PUSH:
                leader = values[weight[:, 0].argmax()[None], 0]
                values[:, 0] = leader + _wrap(values[:, 0] - leader)
            low, high = self._bounds[mode]
            mean = (weight * values).sum(0)
            deviation = _deviation(values, weight, mean) if noise is None else noise * (high - low)
            fresh = mean + deviation * normal[here]
            if mode == PUSH:
                fresh[:, 0] = _wrap(fresh[:, 0])
            drawn[here, 0] = float(mode)
            drawn[here, 1:] = torch.minimum(torch.maximum(fresh, low), high)
        return drawn

    @property
    def _mixed(self) -> bool:
        """Whether there is more than one mode. With one a GPU is never asked which candidates have it."""
        return len(self.modes) > 1

    def strokes(self, positions: torch.Tensor, proposals: torch.Tensor) -> tuple[Strokes, torch.Tensor]:
        """Strokes [B] on positions [B, N, 3] (m), and whether each is feasible [B].

        Infeasible: a push that passes by or grazes, see `DEPTH`, and what leaves the workspace or enters a box.
        """
        mode, ends = proposals[:, 0], proposals.new_zeros(2, len(proposals), 2)
        start, end, feasible = *ends, ends[0, :, 0] > 0
        for m, make in ((PUSH, self._pushes), (PICK, self._picks)):
            here = mode == m
            if self.modes == (m,):
                start, end, feasible = make(positions, proposals[:, 1:])
            elif m in self.modes and here.any():
                chosen = positions if here.all() else positions[here]
                start[here], end[here], feasible[here] = make(chosen, proposals[here, 1:])
        held = torch.zeros(len(mode), 2, dtype=torch.bool, device=mode.device)
        return Strokes(start, end, mode.long(), held), feasible & self.clear(start, end, mode)

    def clear(self, start: torch.Tensor, end: torch.Tensor, mode: torch.Tensor) -> torch.Tensor:
        """Whether the tool on the whole path of strokes from start to end [B, 2] (m) stays where it may go: [B]."""
        inside = self._inside(torch.stack([start, end]))
        if not self.keep_out and self.retreat <= self.min_length:
            return inside  # what goes back no further than it came stays between the ends
        along = end - start
        beyond = (self.retreat / along.norm(dim=-1).clamp_min(SHORTEST) - 1).clamp_min(0) * (mode == PUSH)
        begin = start - along * beyond[:, None]
        inside = inside & self._inside(torch.stack([begin, end]))
        return inside & ~hits(begin, end, mode == PICK, self._boxes) if self.keep_out else inside

    @cached_property
    def _boxes(self) -> torch.Tensor:
        return tool_boxes(self.keep_out, self.pusher_radius).to(self.edges.device)

    def _pushes(
        self, positions: torch.Tensor, numbers: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """First contact is that of the pusher's disc against the particles and the edges between them."""
        heading, share, length = numbers[:, :3].unbind(-1)
        cosine, sine = heading.cos(), heading.sin()
        along, across = torch.stack([cosine, sine], -1), torch.stack([-sine, cosine], -1)
        one_state = positions.stride(0) == 0  # as in the first step of a horizon
        planar = self._filled(positions[:1, :, :2] if one_state else positions[..., :2])
        centre = planar.mean(1)
        x, y = ((planar - centre[:, None])[..., axis].contiguous() for axis in (0, 1))

        def meet(part: slice) -> tuple[torch.Tensor, torch.Tensor]:
            here = slice(None) if one_state else part
            depth = x[here] * along[part, :1] + y[here] * along[part, 1:]
            side = x[here] * across[part, :1] + y[here] * across[part, 1:]
            middle, half = (side.amax(1) + side.amin(1)) / 2, (side.amax(1) - side.amin(1)) / 2
            offset = middle + share[part] * half
            return offset, _first_contacts(depth, side.sub_(offset[:, None]).square_(), self._reaches)

        parts = in_parts(meet, len(numbers), PART if numbers.device.type == "cpu" else len(numbers))
        offset, (contact, into) = (torch.cat(found, -1) for found in zip(*parts, strict=True))
        first = contact.nan_to_num(posinf=0.0) - CLEARANCE
        start = centre + along * first[:, None] + across * offset[:, None]
        return start, start + along * length[:, None], into < first + length

    @cached_property
    def _reaches(self) -> torch.Tensor:
        """Squared distances [2] (m2) between the middles of pusher and particle: where they touch, and where it has gone in."""
        radii = (self.pusher_radius + self.margin, (1 - DEPTH) * self.pusher_radius + self.margin)
        return torch.tensor([radius**2 for radius in radii], device=self.edges.device)

    def _picks(self, positions: torch.Tensor, numbers: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        planar = positions[..., :2]
        middle, half = (planar.amax(1) + planar.amin(1)) / 2, (planar.amax(1) - planar.amin(1)) / 2
        wanted = middle + numbers[:, :2] * half
        nearest = (planar - wanted[:, None]).norm(dim=-1).argmin(1)
        start = planar[torch.arange(len(planar), device=planar.device), nearest]
        distance = numbers[:, 2:].norm(dim=-1, keepdim=True)
        aside = (distance < SHORTEST) * numbers.new_tensor([SHORTEST, 0.0])
        carry = (numbers[:, 2:] + aside) * (self.min_length / distance.clamp_min(SHORTEST)).clamp_min(1)
        return start, start + carry, torch.ones_like(nearest, dtype=torch.bool)

    def _filled(self, planar: torch.Tensor) -> torch.Tensor:
        """Particles [B, N, 2] and points on the edges between them."""
        first, second = planar[:, self.edges[:, 0]], planar[:, self.edges[:, 1]]
        return torch.cat([planar, *((1 - t) * first + t * second for t in (0.25, 0.5, 0.75))], 1)

    def _inside(self, ends: torch.Tensor) -> torch.Tensor:
        """Whether both ends [2, B, 2] lie in the workspace."""
        low, high = self._corners
        return ((ends >= low) & (ends <= high)).all(-1).all(0)

    @cached_property
    def _corners(self) -> torch.Tensor:
        xmin, xmax, ymin, ymax = self.workspace[:4]
        return torch.tensor([[xmin, ymin], [xmax, ymax]], device=self.edges.device)


def _first_contacts(depth: torch.Tensor, apart: torch.Tensor, reaches: torch.Tensor) -> torch.Tensor:
    """How deep along its heading a disc's centre is when it meets a point of depth [B, M] (m) and squared distance to the
    side [B, M] (m2), for R squared reaches of the disc (m2): [R, B], infinite if it meets none."""
    reach = reaches[:, None, None] - apart
    met = depth - reach.clamp(min=TINY).sqrt_()
    return met.masked_fill_(reach <= 0, torch.inf).amin(-1)


def _wrap(angle: torch.Tensor) -> torch.Tensor:
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def _deviation(values: torch.Tensor, weight: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
    """Unbiased weighted standard deviation [4] of values [B, 4], at least 1e-4; 1e-4 for a single one."""
    variance = (weight * (values - mean).square()).sum(0)
    effective = 1 / weight.square().sum()
    return (variance * effective / (effective - 1).clamp_min(1e-6) * (effective > 1.001)).sqrt() + 1e-4


def solid_edges(positions: torch.Tensor) -> torch.Tensor:
    """Edges [E, 2] from each particle of [N, 3] (m) to near ones: at most twice the usual spacing long in the plane."""
    distances = torch.cdist(positions[:, :2], positions[:, :2])
    distances.fill_diagonal_(torch.inf)
    near = distances.topk(min(NEIGHBORS, len(positions) - 1), largest=False)
    spacing = torch.cdist(positions, positions).fill_diagonal_(torch.inf).amin(1).median()
    owner = torch.arange(len(positions), device=positions.device)[:, None].expand_as(near.indices)
    pairs = torch.stack([owner, near.indices], -1)[near.values <= 2 * spacing]
    return torch.unique(pairs.sort(-1).values, dim=0)
