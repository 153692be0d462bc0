"""What training minimises."""

import torch

from piegraph_cli.dynamics.egnn import DECIMETRE, gather_neighbors


def dynamics_loss(
    predicted: torch.Tensor,
    target: torch.Tensor,
    neighbors: torch.Tensor,
    shape_weight: float,
    seen: torch.Tensor | None = None,
) -> torch.Tensor:
    """Mean squared particle error plus `shape_weight` times the summed squared error of neighbour offsets, in dm^2.

    predicted, target [B, N, 3] (m); neighbors [B, N, k]; seen [B, N], particles that count (default: all). Source: paper, Eq. 6-8.
    """
    error = (predicted - target) * DECIMETRE
    bent = (error[:, :, None] - gather_neighbors(error, neighbors)).square().sum(-1)
    if seen is not None:
        bent = bent * gather_neighbors(seen[..., None].to(bent), neighbors)[..., 0]
    return mean_seen(error.square().sum(-1) + shape_weight * bent.sum(-1), seen).mean()


def mean_seen(errors: torch.Tensor, seen: torch.Tensor | None) -> torch.Tensor:
    """Mean [B] of errors [B, N] over the particles that are seen [B, N], None for all; 0 where none is."""
    if seen is None:
        return errors.mean(-1)
    return (errors * seen).sum(-1) / seen.sum(-1).clamp_min(1)
