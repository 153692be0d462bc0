"""What training minimises."""

import torch

from piegraph_cli.dynamics.egnn import DECIMETRE, gather_neighbors


def dynamics_loss(
    predicted: torch.Tensor, target: torch.Tensor, neighbors: torch.Tensor, shape_weight: float
) -> torch.Tensor:
    """Mean squared particle error plus `shape_weight` times the summed squared error of neighbour offsets, in dm^2.

    predicted, target [B, N, 3] (m); neighbors [B, N, k]. Source: paper, Eq. 6-8.
    """
    error = (predicted - target) * DECIMETRE
    shape = (error[:, :, None] - gather_neighbors(error, neighbors)).square().sum((-1, -2))
    return (error.square().sum(-1) + shape_weight * shape).mean()
