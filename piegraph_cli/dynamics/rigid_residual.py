"""A rigid body that is pushed, and a Gaussian process on what its analytic model leaves: how strokes really ended."""

import math
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.poses import in_frame, pose_after, seen_from
from piegraph_cli.dynamics.rigid_body import RigidBody, carry

MOST = 200
"""Strokes that are remembered: as many of all, evenly spread."""
FEWEST = 4
"""Strokes below which nothing is learned of what is left."""
GATE = 0.01
"""Metres that particles are moved by the analytic model from which what it leaves is as likely as anywhere."""
_GROUPS = (slice(0, 2), slice(2, 4), slice(4, 7))
"""Of the features: where the stroke begins, its direction, and how the body is moved."""
_MIDDLE = np.array([1.0, 1.0, -0.7, math.log(0.003), math.log(0.003)])
_SPREAD = np.array([1.0, 1.0, 1.0, 1.0, 0.7])
"""Of the logarithms of three lengths, of what is left and of the noise [m], before any stroke is seen."""
_BOUNDS = [(-2.0, 4.0)] * 3 + [(-9.0, -3.0)] * 2


class RigidResidual(RigidBody):
    """A `RigidBody`, and what it leaves of the motion of its body, told by strokes like it.

    What is left is the pose after the stroke less the predicted one, in the body's frame before it, its turn times the
    radius of gyration. Its covariance falls with the distance between strokes in the body's frame, and goes to zero with
    the predicted motion. The paper has no such model.
    """

    learned: ClassVar[dict[str, tuple[int, ...]]] = RigidBody.learned | {
        "known": (0, 7),
        "weights": (0, 3),
        "inverse": (0, 0),
        "lengths": (3,),
        "left": (),
    }

    def fit(self, data: Sequences, corners: np.ndarray | None = None) -> tuple[float, float]:
        """As for `RigidBody`, then what is left of the same strokes, its five numbers by their posterior.

        The error is that of strokes left out one by one of what is learned of them. Nothing is learned where that is no
        smaller than the error without.
        """
        error, bent = super().fit(data, corners)
        poses, ends, before, after = self.scene(data)
        chosen = torch.linspace(0, len(poses) - 1, min(len(poses), MOST)).long()
        poses, ends, before, after = poses[chosen], ends[chosen], before[chosen], after[chosen]
        moved = super().moved(poses, ends)
        radius = self.gyration()
        features, gate = self._features(poses, ends, moved)
        left = in_frame(poses, pose_after(poses, before, after)) - in_frame(poses, moved)
        left = left.double() * torch.tensor([1.0, 1.0, radius], dtype=torch.float64)
        if len(poses) < FEWEST:
            return error, bent
        numbers = _most_likely(features.double(), gate.double(), left)
        covariance = _covariance(features.double(), gate.double(), numbers)
        inverse = torch.linalg.inv(covariance)
        weights = inverse @ left
        without = weights / inverse.diagonal()[:, None]
        if float(without.norm(dim=1).mean()) >= float(left.norm(dim=1).mean()):
            return error, bent
        self.known, self.weights = features, (weights * gate[:, None]).float()
        self.inverse = (inverse * gate[:, None] * gate).float()
        self.lengths, self.left = torch.tensor(np.exp(numbers[:3])).float(), torch.tensor(math.exp(numbers[3])).float()
        told = self._put(poses, in_frame(poses, pose_after(poses, before, after)), -without.float())
        return float((carry(before, poses, told) - after).norm(dim=-1).mean()), bent

    def moved(self, poses: Tensor, ends: Tensor) -> Tensor:
        """As for `RigidBody`, put right by what strokes like these left."""
        moved = super().moved(poses, ends)
        if not len(self.known):
            return moved
        features, gate = self._features(poses, ends, moved)
        left = self.left**2 * gate[:, None] * (_alike(features, self.known, self.lengths) @ self.weights)
        return self._put(poses, in_frame(poses, moved), left)

    def _put(self, poses: Tensor, motion: Tensor, left: Tensor) -> Tensor:
        """Poses [B, 3] after motions [B, 3] in the body's frame and what is added to them (m)."""
        motion = motion + left / left.new_tensor([1.0, 1.0, self.gyration()])
        cosine, sine = poses[:, 2].cos(), poses[:, 2].sin()
        x, y, yaw = motion.unbind(1)
        return poses + torch.stack([cosine * x - sine * y, sine * x + cosine * y, yaw], 1)

    def _features(self, poses: Tensor, ends: Tensor, moved: Tensor) -> tuple[Tensor, Tensor]:
        """What tells strokes apart [B, 7], see `_GROUPS`, and how far [B] what is left is to be expected, 0 to 1."""
        start, end = (seen_from(poses, points) for points in (ends[:, :2], ends[:, 2:]))
        along, radius = end - start, self.gyration()
        motion = in_frame(poses, moved) * moved.new_tensor([1.0, 1.0, radius])
        length = along.norm(dim=1, keepdim=True).clamp_min(1e-9)
        features = torch.cat([start / radius, along / length, motion / radius], 1)
        return features, (motion.norm(dim=1) / GATE).tanh()


def _alike(features: Tensor, others: Tensor, lengths: Tensor) -> Tensor:
    """How alike strokes [A, 7] and others [B, 7] are, 0 to 1 [A, B]."""
    scaled = [
        torch.cat([x[:, g] / length for g, length in zip(_GROUPS, lengths, strict=True)], 1) for x in (features, others)
    ]
    return (-0.5 * (scaled[0][:, None] - scaled[1][None]).square().sum(-1)).exp()


def _covariance(features: Tensor, gate: Tensor, numbers: np.ndarray) -> Tensor:
    """Of what is left of strokes [S, 7], with noise [S, S] (m^2), under logarithms of the five numbers."""
    lengths = torch.tensor(np.exp(numbers[:3]), dtype=features.dtype)
    alike = math.exp(2 * numbers[3]) * gate[:, None] * gate * _alike(features, features, lengths)
    return alike + (math.exp(2 * numbers[4]) + 1e-12) * torch.eye(len(gate), dtype=features.dtype)


def _most_likely(features: Tensor, gate: Tensor, left: Tensor) -> np.ndarray:
    """Logarithms of the five numbers under which what is left [S, 3] (m), and they, are most likely."""
    from scipy.optimize import minimize  # planning does without

    def cost(numbers: np.ndarray) -> float:
        factor = torch.linalg.cholesky(_covariance(features, gate, numbers))
        whitened = torch.linalg.solve_triangular(factor, left, upper=False)
        likely = 0.5 * whitened.square().sum() + 3 * factor.diagonal().log().sum()
        return float(likely) + 0.5 * float((((numbers - _MIDDLE) / _SPREAD) ** 2).sum())

    starts = [_MIDDLE + np.array([k, k, k, 0, 0]) for k in (-1.0, 0.0, 0.7)]
    found = [minimize(cost, start, method="L-BFGS-B", bounds=_BOUNDS) for start in starts]
    return min(found, key=lambda one: one.fun).x
