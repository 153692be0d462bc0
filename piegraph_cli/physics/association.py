"""Which observed points belong to which particle: rigid alignment, then soft assignment calibrated in the first frame.

One state at a time, in PyTorch. A surface is a place and a unit normal per point, [P, 6]. What is done with the
setpoints found here is in `follower`.
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
INERTIA = 0.02  # weight of staying where it was, beside a weight of one for all particles and one for all points
_METRIC = torch.tensor([1.0, 1.0, 1.0, 0.02, 0.02, 0.02])  # opposite normals are as far apart as 4 cm
_SOFT_METRIC = torch.tensor([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
NEIGHBOURS = 12  # particles that, with a particle, tell how its surroundings have turned
RIGID_SHARE = 0.1  # weight of the whole object's rotation beside theirs


def thin(cloud: np.ndarray, count: int) -> Tensor:
    """At most `count` points of a cloud [P, 3], the same ones every time, as float32."""
    chosen = np.random.default_rng(0).permutation(len(cloud))[:count]
    return torch.as_tensor(np.asarray(cloud, np.float32)[chosen])


def align(
    particles: Tensor, cloud: Tensor, seen: Tensor, whole: int, upright: bool = False, rounds: int = 10
) -> Tensor:
    """Move particles [N, 6] rigidly onto a cloud [P, 6]: two-sided trimmed iterative closest points.

    Both are places (m) and unit normals. Every particle that is `seen` [N] is paired with its nearest point and every
    point with its nearest particle; the farthest fifth of each is left out, so that what is stray does not pull. Where
    little is seen of the `whole` points that the object has, a pull back to the start decides what these leave open.
    """
    start, count = particles[:, :3], len(particles)
    shares = (
        seen / count,
        torch.full((len(cloud),), 1 / max(len(cloud), whole)),
        torch.full((count,), INERTIA / count),
    )
    weights = torch.cat(shares)
    always = torch.ones(count, dtype=torch.bool)
    for _ in range(rounds):
        distance = torch.cdist(particles * _METRIC, cloud * _METRIC)
        (to_point, point), (to_particle, particle) = _nearest(distance, 1), _nearest(distance, 0)
        usual = to_point[seen] if seen.any() else to_point
        near = torch.cat([to_point <= _usual(usual), to_particle <= _usual(to_particle), always])
        places = particles[:, :3]
        source = torch.cat([places, places[particle], places])
        target = torch.cat([cloud[point, :3], cloud[:, :3], start])
        rotation, translation = kabsch(source[None], target[None], (weights * near)[None], upright)
        particles = moved(particles, rotation[0], translation[0])
        if float((particles[:, :3] - places).abs().max()) < ALIGNED:
            break
    return particles


def _nearest(distance: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """What `min` along an axis returns, in half of the time."""
    return distance.amin(axis), torch.from_numpy(distance.numpy().argmin(axis))


def _usual(distance: Tensor) -> float:
    """The quantile `TRIM` of distances [P], in half of PyTorch's time."""
    place = TRIM * (len(distance) - 1)
    low, high = int(place), min(int(place) + 1, len(distance) - 1)
    sorted_there = np.partition(distance.numpy(), (low, high))
    return float(sorted_there[low] + (place - low) * (sorted_there[high] - sorted_there[low]))


def moved(particles: Tensor, rotation: Tensor, translation: Tensor) -> Tensor:
    """Places and normals [N, 6] turned by a rotation [3, 3] and shifted by a translation [3] (m)."""
    return torch.cat([particles[:, :3] @ rotation.T + translation, particles[:, 3:] @ rotation.T], 1)


def misfit(particles: Tensor, cloud: Tensor, seen: Tensor, share: float = TRIM) -> float:
    """Mean distance (m) between particles and a cloud, [N, 6] and [P, 6], both ways, each of its nearest `share`.

    Normals count as in `align`. Particles that are not `seen` [N] explain points, but need none near them.
    """
    distance = torch.cdist(particles * _METRIC, cloud * _METRIC)
    sides = (distance.amin(1)[seen] if seen.any() else distance.amin(1), distance.amin(0))
    return sum(float(side.sort().values[: max(1, int(share * len(side)))].mean()) for side in sides) / 2


def soft_means(particles: Tensor, cloud: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Mean of the points [P, 6] assigned to each particle [N, 6], and the sum of their weights: [N, 3] m, [N].

    Both are places (m) and unit normals. A point divides itself among the particles by a Gaussian of width `scale` (m),
    or goes to none of them. A particle that gets nothing stays in place. Source: coherent point drift (Myronenko and
    Song, 2010), expectation step; normals are ours: without them a side that comes into view pulls on the top.
    """
    nodes, points = particles * _SOFT_METRIC / scale, cloud * _SOFT_METRIC / scale
    exponent = torch.addmm(-0.5 * nodes.square().sum(1)[:, None], nodes, points.t())
    exponent -= 0.5 * points.square().sum(1)
    kernel = exponent.clamp_(FAR, 0).exp_()
    per_point = 1 / (kernel.sum(0) + OUTLIER_SHARE)
    total = kernel @ per_point
    means = kernel @ (cloud[:, :3] * per_point[:, None]) / total.clamp_min(1e-9)[:, None]
    return torch.where(total[:, None] > 1e-6, means, particles[:, :3]), total


class SoftAssignment:
    """Soft assignment that returns each particle to its own place, however the points lie around it.

    The mean of the points near a particle is not the particle: at an edge it lies inside, on uneven sampling beside
    it. That offset is known in the frame the particles were chosen in; turned with the object, it is taken off ever
    after. Without this the particles creep towards the middle of the object.
    """

    def __init__(self, positions: Tensor, cloud: Tensor, scales: tuple[float, ...]):
        """Positions [N, 3] (m) and cloud [P, 6] of the first frame, scales: the widths (m) to calibrate."""
        self.rest = positions
        distance = torch.cdist(cloud[:, :3], positions)
        self.owner = distance.argmin(1)
        self.beside, self.cloud_normals = cloud[:, :3] - positions[self.owner], cloud[:, 3:]
        self.normals = cloud[distance.argmin(0), 3:]
        near = cKDTree(positions.numpy()).query(positions.numpy(), k=min(NEIGHBOURS + 1, len(positions)))[1]
        self.near = torch.as_tensor(near).reshape(len(positions), -1)
        self.offset, self.total = {}, {}
        for scale in scales:
            means, total = soft_means(torch.cat([positions, self.normals], 1), cloud, scale)
            self.offset[scale], self.total[scale] = means - positions, total.clamp_min(1e-6)

    def rotations(self, positions: Tensor) -> Tensor:
        """How the surroundings of each particle have turned since the first frame: [N, 3, 3].

        A thin object leaves the turn about its own axis open there; the rotation of the whole decides it.
        """
        whole = best_rotation(self._about_mean(self.rest[None]).transpose(1, 2) @ self._about_mean(positions[None]))
        rest, now = self._about_mean(self.rest[self.near]), self._about_mean(positions[self.near])
        prior = RIGID_SHARE * rest.square().sum((1, 2))[:, None, None] * whole.transpose(1, 2)
        return best_rotation(rest.transpose(1, 2) @ now + prior)

    def oriented(self, positions: Tensor, rotations: Tensor) -> Tensor:
        """Particles [N, 3] (m) with their normals as their surroundings have turned, [N, 6]."""
        return torch.cat([positions, (rotations @ self.normals[:, :, None])[:, :, 0]], 1)

    def carried(self, positions: Tensor, rotations: Tensor) -> Tensor:
        """The first frame's cloud [P, 6], each of its points carried along by the particle nearest to it there."""
        turned = rotations[self.owner]
        places = positions[self.owner] + (turned @ self.beside[:, :, None])[:, :, 0]
        return torch.cat([places, (turned @ self.cloud_normals[:, :, None])[:, :, 0]], 1)

    def setpoint(self, positions: Tensor, cloud: Tensor, scale: float, rotations: Tensor) -> tuple[Tensor, Tensor]:
        """Where the particles [N, 3] (m) belong in a cloud [P, 6], and the share of its first weight each still has.

        The share, [N], is at most 1. rotations: what `rotations` returned, for these or slightly earlier positions.
        """
        means, total = soft_means(self.oriented(positions, rotations), cloud, scale)
        offset = (rotations @ self.offset[scale][:, :, None])[:, :, 0]
        return means - offset, (total / self.total[scale]).clamp_max(1)

    @staticmethod
    def _about_mean(points: Tensor) -> Tensor:
        return points - points.mean(1, keepdim=True)
