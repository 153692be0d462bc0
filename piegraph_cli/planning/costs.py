"""How far particles are from a goal."""

from collections.abc import Callable

import torch

from piegraph_cli.errors import DataError

Cost = Callable[[torch.Tensor], torch.Tensor]


def make_cost(kind: str, goal: torch.Tensor, particles: int) -> Cost:
    """A function from positions [B, N, 3] (m) to their distance from the goal [G, 3] (m): [B].

    `distance`: mean distance of corresponding particles (G = N); `chamfer`: mean of the two mean nearest-point distances.
    Source: paper, III-E and IV-A.
    """
    if len(goal) == 0 or not torch.isfinite(goal).all():
        raise DataError("the goal has no points, or points that are not finite", hint="give another --goal")
    if kind == "chamfer":
        return lambda positions: _chamfer(positions, goal)
    if len(goal) != particles:
        raise DataError(
            f"the goal has {len(goal)} points, the object {particles} particles: they do not correspond",
            hint="use --cost chamfer",
        )
    return lambda positions: (positions - goal).norm(dim=-1).mean(-1)


def _chamfer(positions: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
    distances = torch.cdist(positions, goal.expand(len(positions), -1, -1))
    return 0.5 * (distances.amin(1).mean(-1) + distances.amin(2).mean(-1))
