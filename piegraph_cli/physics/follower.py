"""The particles of a track on their way from one cloud to the next: where they go, and what is known of them there.

What the cameras do not see of the object does not pull: its particles follow their springs, and its share of the first
frame's cloud is put in from where the particles have carried it. After a loss the object is looked for anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from piegraph_cli.physics.association import SoftAssignment, align, misfit, moved, thin
from piegraph_cli.physics.finding import find
from piegraph_cli.physics.params import GuidanceParams, TrackParams
from piegraph_cli.physics.rigid import kabsch
from piegraph_cli.physics.simulation import check_stability
from piegraph_cli.physics.spring_kernel import drive, guide
from piegraph_cli.physics.springs import SpringGraph, stability_bound
from piegraph_cli.physics.visibility import View, look, normals

FEWEST_POINTS = 20  # a cloud of fewer says too little about a pose: the frame counts as unseen
GRASP_RADIUS = 0.02  # metres from the hand to the particles it holds
GRASP_GAIN = 3.0  # gain of a held particle, times that of a seen one
SETTLED = 1e-4  # metres; assignment goes on to the next scale once no particle moves further in a round
WHOLE = 1.0  # share of particles and points that a shape has to explain: a fifth may be an end that has bent
RIGID_ENOUGH = 1.05  # times the misfit of the deformed shape up to which the undeformed one is taken
EVERY, FINE = 2, 6  # which points of the surface are aligned at last, in how many rounds
EXPLAINED = 0.012  # metres from the carried surface, beyond which a point is of something else, or newly in view
ALMOST_ALL = 0.95  # share of what is seen of the object, and of the cloud, that lies in the other where it is not lost
NOISE = 0.002  # metres that noise adds to the misfit of the first frame, whose points the particles are
ODD, LOST = 1.5, 2.0  # times the usual misfit, beyond which a frame is not usual, and the object is lost
LEAP = 0.1  # metres in a frame, further than a hand moves anything: a thing that looks alike from two sides was turned
RARELY_SEEN = 0.35  # share of the particles; where fewer were seen, the object is looked for anew when more are


@dataclass(frozen=True)
class Found:
    """One frame of a track."""

    positions: np.ndarray
    """[N, 3] float32, metres."""
    residual: float
    """Metres, mean distance of what is seen to the nearest point of the cloud; 0 where nothing is."""
    weight: np.ndarray
    """[N] float32 in 0..1: how much of what a particle saw in the first frame it still sees; 0 for hidden ones."""
    misfit: float
    """Metres between particles and cloud, both ways; 0 where there is no cloud."""
    held: bool
    """Whether there is no usable cloud."""
    lost: bool
    """Whether the object is not where it was looked for."""


class Follower:
    """The particles on their way from cloud to cloud."""

    def __init__(
        self,
        first: np.ndarray,
        graph: SpringGraph,
        cloud: np.ndarray,
        views: Sequence[View],
        params: TrackParams,
        upright: bool,
    ):
        """`first` [N, 3] (m): the particles in the first frame's cloud [P, 3], which cameras see as in `views`.

        An `upright` object is never lifted, and turns about the vertical alone.
        """
        self.params, self.graph = params, graph
        self.positions = torch.as_tensor(first, dtype=torch.float32)
        stiffness = min(params.stiffness, 0.8 * stability_bound(graph, params.damping, GRASP_GAIN * params.gain))
        self.settling = GuidanceParams(stiffness=stiffness, gain=params.gain, damping=params.damping)
        check_stability(graph, self.settling, GRASP_GAIN)
        self.moving = self.settling.model_copy(update={"iterations": params.iterations})
        self.upright = upright
        self.soft, self.lost, self.share = None, False, 1.0
        if params.association == "soft":
            self.density = min(1.0, params.points / len(cloud))
            surface = self._surface(cloud, views)
            self.soft = SoftAssignment(self.positions, surface, params.scales)
            everything = torch.ones(len(first), dtype=torch.bool)
            self.usual = [misfit(self._particles(), surface, everything) + NOISE]

    def at(self, frame: int, cloud: np.ndarray, views: Sequence[View], grip: "Grip") -> Found:
        """Move on to the next cloud [P, 3] (m). In the first frame the particles are as chosen."""
        grip.update(frame, self.positions)
        held = len(cloud) < FEWEST_POINTS
        weight, fit = torch.ones(len(self.positions)), 0.0
        if self.soft is not None:
            fit = self.usual[0]
        if held:
            weight, fit, self.share = self._hold(grip), 0.0, 0.0
        elif frame > 0 and self.soft is not None:
            weight, fit = self._follow(self.soft, self._surface(cloud, views), views, grip)
        elif frame > 0:
            nearest = cKDTree(cloud).query(self.positions.numpy())[1]
            self._settle(torch.as_tensor(cloud[nearest], dtype=torch.float32), weight, grip)
        positions, seen = self.positions.numpy().copy(), weight.numpy().copy()
        near = cKDTree(cloud).query(positions)[0] if seen.any() else None
        residual = 0.0 if near is None else float(np.average(near, weights=seen))
        return Found(positions, residual, seen, fit, held, self.lost and not held)

    def _surface(self, cloud: np.ndarray, views: Sequence[View]) -> Tensor:
        """Places and normals [P, 6] of a cloud thinned as the first frame's was: to fewer points where less is seen."""
        count = min(self.params.points, max(FEWEST_POINTS, round(self.density * len(cloud))))
        points = thin(cloud, count)
        return torch.cat([points, torch.as_tensor(normals(cloud, points.numpy(), views), dtype=torch.float32)], 1)

    def _particles(self) -> Tensor:
        assert self.soft is not None
        return self.soft.oriented(self.positions, self.soft.rotations(self.positions))

    def _hold(self, grip: "Grip") -> Tensor:
        """Nothing is seen: the particles stay, but for those in the hand and what these drag along."""
        unseen = torch.zeros(len(self.positions))
        if grip.holds:
            self._settle(self.positions, unseen, grip)
        return unseen

    def _settle(self, setpoint: Tensor, weight: Tensor, grip: "Grip") -> None:
        setpoint, gain = grip.override(setpoint, weight)
        self.positions = guide(self.positions[None], setpoint[None], self.graph, self.settling, gain[None])[0]

    def _follow(self, soft: SoftAssignment, cloud: Tensor, views: Sequence[View], grip: "Grip") -> tuple[Tensor, float]:
        """The weight [N] of each particle in a cloud [P, 6], and the misfit; the object is sought where it was lost."""
        before = self.positions
        limit = LOST * float(np.median(self.usual))
        searched = self.lost or self.share < RARELY_SEEN
        if searched:
            self.positions = find(soft, before, cloud, views, self.upright, limit)
        weight, fit = self._carry(soft, cloud, views, grip)
        astray = fit > limit and not self._in_cloud(soft, cloud, views)
        if astray and not searched:
            self.positions = find(soft, before, cloud, views, self.upright, limit)
            weight, fit = self._carry(soft, cloud, views, grip)
            astray = fit > limit and not self._in_cloud(soft, cloud, views)
        leapt = float((self.positions - before).norm(dim=1).mean()) > LEAP and not searched
        self.lost = (astray or leapt) and not grip.holds
        if self.lost:
            self.positions, self.share = before, 0.0
            return torch.zeros_like(weight), fit
        if fit < ODD * float(np.median(self.usual)):
            self.usual.append(fit)
        self.share = float((weight > 0).float().mean())
        return weight, fit

    def _in_cloud(self, soft: SoftAssignment, cloud: Tensor, views: Sequence[View]) -> bool:
        """Whether object and cloud [P, 6] lie in one another, whichever way they face: a rope that has rolled is not lost."""
        carried = soft.carried(self.positions, soft.rotations(self.positions))
        there = carried[_seen(carried[:, :3], views)]
        return all(float(_near(a, b).float().mean()) >= ALMOST_ALL for a, b in ((cloud, carried), (there, cloud)))

    def _carry(self, soft: SoftAssignment, cloud: Tensor, views: Sequence[View], grip: "Grip") -> tuple[Tensor, float]:
        """Rigid alignment, then soft assignment at one scale after the other, then the first frame's shape on trial."""
        for _ in range(2):  # what is seen is another at the new place
            particles = align(self._particles(), cloud, _seen(self.positions, views), len(soft.owner), self.upright)
            self.positions = particles[:, :3]
        velocity, near = torch.zeros_like(self.positions), cloud
        for turns, scale in zip(self.params.turns, self.params.scales, strict=True):
            rotations = soft.rotations(self.positions)
            carried = soft.carried(self.positions, rotations)
            seen, absent = _seen(self.positions, views), ~_seen(carried[:, :3], views)
            if scale != self.params.scales[0]:
                near = _explained(cloud, carried)
            for _ in range(turns):
                before = self.positions
                whole = torch.cat([near, soft.carried(before, rotations)[absent]])
                seen_at, share = soft.setpoint(before, whole, scale, rotations)
                setpoint, gain = grip.override(seen_at, share * seen)
                self.positions, velocity = drive(before, velocity, setpoint, self.graph, self.moving, gain)
                if float((self.positions - before).abs().max()) < SETTLED:
                    break
        if not grip.holds:
            self._prefer_rest_shape(soft, near, views)
        seen = _seen(self.positions, views)
        return share * seen, misfit(self._particles(), cloud, seen)

    def _prefer_rest_shape(self, soft: SoftAssignment, cloud: Tensor, views: Sequence[View]) -> None:
        """Take the first frame's shape, moved rigidly, where it explains the cloud as well.

        What a hand hides pulls its surroundings out of shape, and springs can fold over and stay folded; a shape that
        nothing asks for is dropped here, so it is not carried on. Objects that did bend are explained worse by it.
        """
        rotation, translation = kabsch(soft.rest[None], self.positions[None], None, self.upright)
        rigid = soft.oriented(soft.rest @ rotation[0].T + translation[0], rotation.expand(len(soft.rest), 3, 3))
        rigid = align(rigid, cloud, _seen(rigid[:, :3], views), len(soft.owner), self.upright)
        bent = misfit(self._particles(), cloud, _seen(self.positions, views), WHOLE)
        if misfit(rigid, cloud, _seen(rigid[:, :3], views), WHOLE) <= RIGID_ENOUGH * bent:
            surface = soft.carried(rigid[:, :3], soft.rotations(rigid[:, :3]))[::EVERY]
            fitted = align(surface, cloud, _seen(surface[:, :3], views), len(soft.owner), self.upright, FINE)
            rotation, translation = kabsch(surface[None, :, :3], fitted[None, :, :3], None, self.upright)
            self.positions = moved(rigid, rotation[0], translation[0])[:, :3]


def _seen(positions: Tensor, views: Sequence[View]) -> Tensor:
    """Which of the points [P, 3] (m) could be in the cloud: not those that are hidden. What is not there is missed."""
    return torch.as_tensor(~look(positions.numpy(), views).hidden)


def _explained(cloud: Tensor, carried: Tensor) -> Tensor:
    """The points of a cloud [P, 6] near the carried surface [Q, 6]; all of them where they are the smaller part."""
    near = _near(cloud, carried)
    return cloud[near] if near.float().mean() > 0.5 else cloud


def _near(points: Tensor, others: Tensor) -> Tensor:
    """Which of the points [P, 6] lie within `EXPLAINED` of one of the others [Q, 6]: [P] bool."""
    distance = cKDTree(others[:, :3].numpy()).query(points[:, :3].numpy(), distance_upper_bound=EXPLAINED)[0]
    return torch.as_tensor(np.isfinite(distance))


class Grip:
    """The particles in the hand and where it takes them; ours, for picks: there the hand hides what it moves."""

    def __init__(self, hand: np.ndarray | None, grasp: np.ndarray | None):
        self.hand, self.grasp = hand, grasp
        self.closed = self.holds = False

    def update(self, frame: int, positions: Tensor) -> None:
        """Close around the particles [N, 3] near the hand, carry them, or let go."""
        if self.hand is None or self.grasp is None or not self.grasp[frame]:
            self.closed = self.holds = False
            return
        hand = torch.as_tensor(self.hand[frame], dtype=positions.dtype)
        if not self.closed:
            self.offset = positions - hand
            self.inside = self.offset.norm(dim=1) < GRASP_RADIUS
            self.closed, self.holds = True, bool(self.inside.any())
        self.target = hand + self.offset

    def override(self, setpoint: Tensor, gain: Tensor) -> tuple[Tensor, Tensor]:
        """Setpoint [N, 3] and gain factor [N] with the held particles' own in place."""
        if not self.holds:
            return setpoint, gain
        return torch.where(self.inside[:, None], self.target, setpoint), torch.where(self.inside, GRASP_GAIN, gain)
