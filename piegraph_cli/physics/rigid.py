"""Rigid motion between two sets of corresponding points (Kabsch), batched, in PyTorch; and in the plane."""

import math

import numpy as np
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


def planar_fit(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The motion (x, y (m), yaw) of the plane that brings points [N, 2] nearest to others in the same order."""
    a, b = source - source.mean(0), target - target.mean(0)
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    return np.array([*(target.mean(0) - moved_in_plane(source.mean(0), np.array([0.0, 0.0, yaw]))), yaw])


def moved_in_plane(points: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Points [..., 2] (m) turned about the origin by a motion's yaw (rad), then shifted by its x, y (m)."""
    cosine, sine = math.cos(motion[2]), math.sin(motion[2])
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + motion[:2]
