"""Rigid motion between two sets of corresponding points (Kabsch), batched, in PyTorch."""

import torch
from torch import Tensor


def kabsch(
    source: Tensor, target: Tensor, weights: Tensor | None = None, upright: bool = False
) -> tuple[Tensor, Tensor]:
    """Best proper rotation R [B, 3, 3] and translation t [B, 3] (m), so that R x + t is closest to the target.

    An `upright` rotation turns about the vertical alone.

    source, target: [B, N, 3] metres; weights: [B, N] or [N], not negative. Never a reflection. Where points leave the
    rotation open (all on a line), one of the best is returned. Source: Kabsch (1976). The paper has no rigid fit: it
    is the oracle that guidance must agree with on a stiff object.
    """
    if weights is None:
        weights = torch.ones_like(source[..., 0])
    share = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-12)).expand(source.shape[:2])[..., None]
    source_mean, target_mean = (share * source).sum(1, keepdim=True), (share * target).sum(1, keepdim=True)
    covariance = (share * (source - source_mean)).transpose(1, 2) @ (target - target_mean)
    if upright:
        level = covariance[:, :2, :2]
        covariance = torch.nn.functional.pad(level, (0, 1, 0, 1))
        covariance[:, 2, 2] = level.abs().sum((1, 2)) + 1e-9
    rotation = best_rotation(covariance)
    translation = target_mean[:, 0] - (rotation @ source_mean[:, 0, :, None])[..., 0]
    return rotation, translation


def best_rotation(covariance: Tensor) -> Tensor:
    """Proper rotations [B, 3, 3] that maximise the trace of R times a covariance [B, 3, 3] (source by target)."""
    u, _, vt = torch.linalg.svd(covariance)
    sign = torch.ones_like(covariance[:, 0])
    sign[:, 2] = torch.linalg.det(u @ vt).sign()
    return vt.transpose(1, 2) @ (sign[..., None] * u.transpose(1, 2))


def rigid_projection(rest: Tensor, setpoint: Tensor) -> Tensor:
    """The rest shape [N, 3] or [B, N, 3] moved rigidly as close as possible to the setpoint [B, N, 3]; metres."""
    rest = rest.expand_as(setpoint)
    rotation, translation = kabsch(rest, setpoint)
    return rest @ rotation.transpose(1, 2) + translation[:, None]
