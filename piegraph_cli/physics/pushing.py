"""The spring-mass system pushed over a table by a disc, or drawn by a hand: readable and differentiable.

The reference in PyTorch, as `simulation`, whose units it has. Heights do not change in it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from piegraph_cli.errors import UsageError
from piegraph_cli.physics.simulation import SHORTEST, check_bound, check_state, springs_of
from piegraph_cli.physics.springs import SpringGraph


@dataclass(frozen=True)
class PushParams:
    """A spring object on a table, pushed by an upright disc or held by a hand.

    Numbers may be tensors with a gradient, each a scalar or one of every scene [B].
    """

    stiffness: float | Tensor = 0.15
    """α = k dt²/m of every spring, dimensionless."""
    damping: float | Tensor = 0.8
    """δ, the share of a velocity kept per iteration, dimensionless, in (0, 1]."""
    friction: float | Tensor = 0.0
    """μ g dt², what Coulomb friction with the table takes of a velocity per iteration, metres."""
    radius: float | Tensor = 0.01
    """Radius of the pusher and of what the particles stand for, metres: as near as its middle comes to the contour."""
    grip: float | Tensor = 0.0
    """Coulomb coefficient of the pusher, dimensionless."""
    tension_only: bool = False
    """Springs pull but never push, as in cloth."""
    settle: int | None = None
    """Iterations that a scene goes on for after its disc has stopped, whatever others do; None: to the path's end."""

    def numbers(self) -> tuple[float | Tensor, ...]:
        """Stiffness, damping, friction, radius, grip."""
        return self.stiffness, self.damping, self.friction, self.radius, self.grip


def _slow(velocity: Tensor, friction: float | Tensor) -> Tensor:
    """What Coulomb friction with the table leaves of planar velocities [N, 2, B], metres per iteration."""
    speed = (velocity * velocity).sum(1, keepdim=True).clamp_min(SHORTEST**4).sqrt()
    return velocity * (1 - friction / speed).clamp_min(0)


class _Contour:
    """The segments that a pusher touches, and how its contact with them moves their ends."""

    def __init__(self, graph: SpringGraph, device: torch.device):
        self.first, self.second = torch.as_tensor(graph.touched.T.copy(), device=device)

    def contact(
        self, x: Tensor, velocity: Tensor, centre: Tensor, motion: Tensor, radius: float | Tensor, grip: float | Tensor
    ) -> Tensor:
        """How particles [N, 2, B] move for no segment to be inside the disc at centre [2, B], which has moved by motion.

        The disc drags what it touches along, by at most `grip` times what it moves it aside. Of several segments that
        move a particle the mean counts, those more that are deeper inside: all that meet in it are touched where it is.
        """
        start, along = x[self.first], x[self.second] - x[self.first]
        square = (along * along).sum(1, keepdim=True).clamp_min(SHORTEST**2)
        share = (((centre - start) * along).sum(1, keepdim=True) / square).clamp(0, 1)
        offset = start + share * along - centre
        middle = (offset * offset).sum(1) < SHORTEST**2  # no way out is the shortest there: take the one along x
        offset = offset + SHORTEST * torch.stack([middle, torch.zeros_like(middle)], dim=1)
        distance = (offset * offset).sum(1, keepdim=True).clamp_min(SHORTEST**2).sqrt()
        depth = (radius - distance).clamp_min(0)
        normal = offset / distance
        slip = (1 - share) * velocity[self.first] + share * velocity[self.second] - motion
        aside = torch.stack([-normal[:, 1], normal[:, 0]], dim=1)
        slip = (slip * aside).sum(1, keepdim=True)
        push = normal * depth - aside * torch.minimum(torch.maximum(slip, -grip * depth), grip * depth)
        push = push / ((1 - share) ** 2 + share**2)
        moved, whole = torch.zeros_like(x), torch.zeros_like(x[:, :1])
        for particles, part in ((self.first, 1 - share), (self.second, share)):
            moved = moved.index_add(0, particles, push * part * part * depth)
            whole = whole.index_add(0, particles, part * depth)
        return moved / whole.clamp_min(SHORTEST**2)


def push(
    positions: Tensor,
    path: Tensor,
    graph: SpringGraph,
    params: PushParams = PushParams(),
    held: Tensor | None = None,
) -> Tensor:
    """Push a spring object over a table with an upright disc, one iteration per point of its path.

    positions: [B, N, 3] metres, at rest; path: [B, T, 2] metres, centre of the disc per iteration: repeat the last one
    to let the object come to rest. What of the graph's contour is in the disc is put out of it, once per iteration.
    held: [B, N] bool, particles that a hand holds and carries along the path; where a scene has any, there is no disc in
    it. Returns [B, N, 3]:
    heights stay, as what lies on a table and is pushed or drawn keeps its own. Differentiable, also in the numbers of
    `params`. Raises UsageError for an unstable stiffness (with the bound) or a path that moves further than the disc's
    radius in one iteration, which would jump over particles.
    Source: paper, Eq. 3, with contact and friction as the external forces (baselines SMS).
    """
    until = check_push(positions, path, graph, params)[:, 5]
    springs, contour = springs_of(graph, positions.dtype, positions.device), _Contour(graph, positions.device)
    x, height = positions.permute(1, 2, 0).contiguous().split([2, 1], dim=1)
    velocity = torch.zeros_like(x)
    grip = None if held is None else held.t()[:, None]
    radius = params.radius if held is None else params.radius * ~held.any(1)
    last = path[:, 0].t()
    for t, centre in enumerate(path.permute(1, 2, 0)):
        before, motion, goes_on = x, centre - last, t <= until
        force = springs.acceleration(torch.cat([x, height], 1), params.stiffness, params.tension_only)[:, :2]
        velocity = _slow(params.damping * (velocity + force), params.friction)
        velocity = torch.where(goes_on, velocity, 0.0)
        x = x + velocity
        out = contour.contact(x, velocity, centre, motion, radius, params.grip)
        out = torch.where(goes_on, out, 0.0)
        x, velocity = x + out, velocity + out
        if grip is not None:
            x, velocity = torch.where(grip, before + motion, x), torch.where(grip, 0.0, velocity)
        last = centre
    return clear(torch.cat([x, height], 1).permute(2, 0, 1).contiguous(), path[:, -1], radius)


def clear(positions: Tensor, centre: Tensor, radius: float | Tensor) -> Tensor:
    """Particles [B, N, 3] put out of upright discs at centre [B, 2] (m) with radius (m; or [B]), the shortest way.

    Contact with the contour, which bends where particles are moved by several segments, leaves them up to 2 mm inside.
    """
    radius = torch.as_tensor(radius).to(positions).reshape(-1, 1)
    offset = positions[..., :2] - centre[:, None]
    distance = offset.square().sum(-1).clamp_min(SHORTEST**2).sqrt()
    out = torch.where(distance < radius, radius / distance - 1, 0.0)[..., None] * offset
    return positions + torch.nn.functional.pad(out, (0, 1))


def check_push(positions: Tensor, path: Tensor, graph: SpringGraph, params: PushParams) -> Tensor:
    """Refuse what `push` cannot work with: see there. Returns the numbers of every scene and its last iteration [B, 6]."""
    check_state(positions, graph)
    batch = len(positions)
    given = [torch.as_tensor(value).detach().to(positions).expand(batch) for value in params.numbers()]
    numbers = torch.stack(given, 1)
    stride = float((path[:, 1:] - path[:, :-1]).norm(dim=-1).max()) if path.shape[1] > 1 else 0.0
    radius = float(numbers[:, 3].min())
    if stride > radius:
        raise UsageError(
            f"the pusher moves {stride:.4f} m in one iteration, further than its radius of {radius:.4g} m",
            hint="more iterations along the path",
        )
    stiffness, damping = numbers[(numbers[:, 0] * numbers[:, 1] / (1 + numbers[:, 1])).argmax(), :2].tolist()
    check_bound(graph, stiffness, damping, 0.0)
    moves = (path[:, 1:] != path[:, :-1]).any(-1)
    stops = (
        (moves * torch.arange(1, path.shape[1], device=path.device)).amax(1) if path.shape[1] > 1 else numbers[:, 0] * 0
    )
    until = (
        torch.full_like(numbers[:, :1], path.shape[1]) if params.settle is None else (stops + params.settle)[:, None]
    )
    return torch.cat([numbers, until.to(numbers)], 1)
