"""Poses (x, y, yaw) of bodies in the plane, as batches."""

import math

import torch
from torch import Tensor


def seen_from(poses: Tensor, points: Tensor) -> Tensor:
    """Points [B, 2] (m) in the frames of bodies at poses [B, 3]."""
    cosine, sine = poses[:, 2].cos(), poses[:, 2].sin()
    x, y = (points - poses[:, :2]).unbind(1)
    return torch.stack([cosine * x + sine * y, cosine * y - sine * x], 1)


def in_frame(poses: Tensor, others: Tensor) -> Tensor:
    """Other poses [B, 3] (m, rad) as seen from poses [B, 3]; turns from -pi to pi."""
    turn = torch.remainder(others[:, 2:] - poses[:, 2:] + math.pi, 2 * math.pi) - math.pi
    return torch.cat([seen_from(poses, others[:, :2]), turn], 1)


def pose_after(poses: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Poses [B, 3] of bodies whose particles went from before to after [B, N, 2]."""
    a, b = before - before.mean(1, keepdim=True), after - after.mean(1, keepdim=True)
    yaw = torch.atan2((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(1), (a * b).sum((1, 2)))
    cosine, sine = yaw.cos(), yaw.sin()
    x, y = (poses[:, :2] - before.mean(1)).unbind(1)
    place = torch.stack([cosine * x - sine * y, sine * x + cosine * y], 1)
    return torch.cat([after.mean(1) + place, (poses[:, 2] + yaw)[:, None]], 1)
