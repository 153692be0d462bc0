"""How far particles are from a goal."""

from collections.abc import Callable

import numpy as np
import torch

from piegraph_cli.errors import DataError
from piegraph_cli.physics.springs import farthest_point_sample

Cost = Callable[[torch.Tensor], torch.Tensor]


def make_cost(kind: str, goal: torch.Tensor, particles: int) -> Cost:
    """A function from positions [B, N, 3] (m) to their distance from the goal [G, 3] or [K, N, 3] (m): [B].

    `distance`: mean distance of corresponding particles, to the nearest of the goal's poses [K, N, 3]; `chamfer`: sum of the
    two mean nearest-point distances; `emd`: mean distance under the best one-to-one assignment (earth mover's distance),
    the goal thinned to N points. Source: paper, III-E and IV-A.
    """
    if len(goal) == 0 or not torch.isfinite(goal).all():
        raise DataError("the goal has no points, or points that are not finite", hint="give another --goal")
    if kind == "chamfer":
        return lambda positions: _chamfer(positions, goal)
    if kind == "emd":
        if len(goal) < particles:
            raise DataError(
                f"the goal has {len(goal)} points, fewer than the {particles} particles", hint="--cost chamfer"
            )
        thinned = goal[torch.as_tensor(farthest_point_sample(goal.cpu().numpy(), particles))]
        return lambda positions: _earth_mover(positions, thinned)
    poses = goal if goal.dim() == 3 else goal[None]
    if poses.shape[1] != particles:
        raise DataError(
            f"the goal has {poses.shape[1]} points, the object {particles} particles: they do not correspond",
            hint="use --cost emd",
        )
    return lambda positions: torch.stack([(positions - pose).norm(dim=-1).mean(-1) for pose in poses]).amin(0)


def _chamfer(positions: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
    distances = torch.cdist(positions, goal.expand(len(positions), -1, -1))
    return distances.amin(1).mean(-1) + distances.amin(2).mean(-1)


def _earth_mover(positions: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
    from scipy.optimize import linear_sum_assignment  # takes a fifth of a second, and other costs do without

    distances = torch.cdist(positions, goal.expand(len(positions), -1, -1)).cpu().numpy()
    means = [matrix[linear_sum_assignment(matrix)].mean() for matrix in distances]
    return torch.as_tensor(np.array(means, np.float32), device=positions.device)
