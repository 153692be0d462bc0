"""Which observed points belong to which particle: rigid alignment, then soft assignment calibrated in the first frame.

One state at a time, in PyTorch. What is done with the setpoints found here is in `tracking`.
"""

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from piegraph_cli.physics.rigid import best_rotation, kabsch

OUTLIER_SHARE = 0.1 * float(np.exp(-0.5 * 2.5**2))  # weight of "no particle": a tenth of a particle 2.5 σ away
FAR = -60.0  # exponents end here, since processors are slow at numbers too small to be normal
TRIM = 0.8  # share of pairs, the nearest ones, that an alignment uses
ALIGNED = 1e-4  # metres; an alignment that moves no particle further has converged
NEIGHBOURS = 12  # particles that, with a particle, tell how its surroundings have turned
RIGID_SHARE = 0.1  # weight of the whole object's rotation beside theirs


def thin(cloud: np.ndarray, count: int) -> Tensor:
    """At most `count` points of a cloud [P, 3], the same ones every time, as float32."""
    chosen = np.random.default_rng(0).permutation(len(cloud))[:count]
    return torch.as_tensor(np.asarray(cloud, np.float32)[chosen])


def align(positions: Tensor, cloud: Tensor, rounds: int = 10) -> Tensor:
    """Move particles [N, 3] rigidly onto a cloud [P, 3] (m): two-sided trimmed iterative closest points.

    Every particle is paired with its nearest point and every point with its nearest particle, both sides weighing the
    same; the farthest fifth of each is left out, so that what is hidden or stray does not pull.
    """
    sides = torch.cat([torch.full((len(side),), 1 / len(side)) for side in (positions, cloud)])
    for _ in range(rounds):
        distance = torch.cdist(positions, cloud)
        to_point, point = distance.min(1)
        to_particle, particle = distance.min(0)
        near = torch.cat([to_point <= to_point.quantile(TRIM), to_particle <= to_particle.quantile(TRIM)])
        source = torch.cat([positions, positions[particle]])
        target = torch.cat([cloud[point], cloud])
        rotation, translation = kabsch(source[None], target[None], (sides * near)[None])
        before, positions = positions, positions @ rotation[0].T + translation[0]
        if float((positions - before).abs().max()) < ALIGNED:
            break
    return positions


def misfit(positions: Tensor, cloud: Tensor) -> float:
    """Mean distance (m) between particles [N, 3] and a cloud [P, 3], both ways, each without its farthest fifth."""
    distance = torch.cdist(positions, cloud)
    sides = (distance.amin(1), distance.amin(0))
    return sum(float(side.sort().values[: max(1, int(TRIM * len(side)))].mean()) for side in sides) / 2


def soft_means(positions: Tensor, cloud: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Mean of the points [P, 3] assigned to each particle [N, 3], and the sum of their weights: [N, 3] m, [N].

    A point divides itself among the particles by a Gaussian of width `scale` (m), or goes to none of them. A particle
    that gets nothing stays in place. Source: coherent point drift (Myronenko and Song, 2010), expectation step.
    """
    particles, points = positions / scale, cloud / scale
    exponent = torch.addmm(-0.5 * particles.square().sum(1)[:, None], particles, points.t())
    exponent -= 0.5 * points.square().sum(1)
    kernel = exponent.clamp_(FAR, 0).exp_()
    per_point = 1 / (kernel.sum(0) + OUTLIER_SHARE)
    total = kernel @ per_point
    means = kernel @ (cloud * per_point[:, None]) / total.clamp_min(1e-9)[:, None]
    return torch.where(total[:, None] > 1e-6, means, positions), total


class SoftAssignment:
    """Soft assignment that returns each particle to its own place, however the points lie around it.

    The mean of the points near a particle is not the particle: at an edge it lies inside, on uneven sampling beside
    it. That offset is known in the frame the particles were chosen in; turned with the object, it is taken off ever
    after. Without this the particles creep towards the middle of the object.
    """

    def __init__(self, positions: Tensor, cloud: Tensor, scales: tuple[float, ...]):
        """positions [N, 3] and cloud [P, 3] of the first frame, scales: the widths (m) to calibrate."""
        self.rest = positions
        near = cKDTree(positions.numpy()).query(positions.numpy(), k=min(NEIGHBOURS + 1, len(positions)))[1]
        self.near = torch.as_tensor(near).reshape(len(positions), -1)
        self.offset, self.total = {}, {}
        for scale in scales:
            means, total = soft_means(positions, cloud, scale)
            self.offset[scale], self.total[scale] = means - positions, total.clamp_min(1e-6)

    def rotations(self, positions: Tensor) -> Tensor:
        """How the surroundings of each particle have turned since the first frame: [N, 3, 3].

        A thin object leaves the turn about its own axis open there; the rotation of the whole decides it.
        """
        whole = best_rotation(self._about_mean(self.rest[None]).transpose(1, 2) @ self._about_mean(positions[None]))
        rest, now = self._about_mean(self.rest[self.near]), self._about_mean(positions[self.near])
        prior = RIGID_SHARE * rest.square().sum((1, 2))[:, None, None] * whole.transpose(1, 2)
        return best_rotation(rest.transpose(1, 2) @ now + prior)

    def setpoint(self, positions: Tensor, cloud: Tensor, scale: float, rotations: Tensor) -> tuple[Tensor, Tensor]:
        """Where the particles [N, 3] belong in a cloud [P, 3] (m), and the share of its first weight each still has.

        The share, [N], is at most 1. rotations: what `rotations` returned, for these or slightly earlier positions.
        """
        means, total = soft_means(positions, cloud, scale)
        offset = (rotations @ self.offset[scale][:, :, None])[:, :, 0]
        return means - offset, (total / self.total[scale]).clamp_max(1)

    @staticmethod
    def _about_mean(points: Tensor) -> Tensor:
        return points - points.mean(1, keepdim=True)
