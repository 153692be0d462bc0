"""Particles that follow an object through a recording: the spring-mass system guided to one cloud after another.

Two ways to find the setpoint of a frame: soft assignment (`soft`, the default) and the paper's nearest observed point
(`nearest`). The residual of both only says how near the particles lie to the cloud: particles that slid along the
surface have a small one too, so it is no measure of accuracy.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.association import SoftAssignment, align, misfit, thin
from piegraph_cli.physics.params import GuidanceParams, TrackParams
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.physics.rigid import rigid_projection
from piegraph_cli.physics.simulation import check_stability
from piegraph_cli.physics.spring_kernel import drive, guide
from piegraph_cli.physics.springs import SpringGraph, build_springs, stability_bound

FEWEST_POINTS = 20  # a cloud of fewer says too little about a pose: the frame counts as unseen
GRASP_RADIUS = 0.02  # metres from the hand to the particles it holds
GRASP_GAIN = 3.0  # gain of a held particle, times that of a seen one
LEAST_RADIUS = 0.03  # metres, of the springs
SETTLED = 1e-4  # metres; assignment goes on to the next scale once no particle moves further in a round
RIGID_ENOUGH = 1.05  # times the misfit of the deformed shape up to which the undeformed one is taken


@dataclass(frozen=True, eq=False)
class TrackResult:
    """The tracked particles of one recording."""

    positions: np.ndarray
    """[F, N, 3] float32, metres; a particle keeps its index."""
    residual: np.ndarray
    """[F] float32, metres: mean distance from a seen particle to the nearest point of the cloud; 0 in held frames."""
    weight: np.ndarray
    """[F, N] float32 in 0..1: how much of what a particle saw in the first frame it still sees; 0 in held frames."""
    held: np.ndarray
    """[F] bool: frames without a usable cloud, in which the particles stayed where they were."""
    springs: SpringGraph
    """Springs of the returned particles, at rest in the first frame."""


def spring_radius(positions: np.ndarray) -> float:
    """Radius (m) within which particles [N, 3] are joined: 2.2 times their spacing, but at least 3 cm."""
    if len(positions) < 2:
        return LEAST_RADIUS
    spacing = cKDTree(positions).query(positions, k=2)[0][:, 1]
    return max(LEAST_RADIUS, 2.2 * float(np.median(spacing)))


def track(
    clouds: Sequence[np.ndarray],
    params: TrackParams = TrackParams(),
    hand: np.ndarray | None = None,
    grasp: np.ndarray | None = None,
    progress: Callable[[Sequence[np.ndarray]], Iterable[np.ndarray]] = iter,
) -> TrackResult:
    """Follow material points of an object through its clouds, [P_f, 3] metres each, table at z = 0.

    hand [F, 3] metres, grasp [F] bool: while grasp holds, the particles within 2 cm of where the hand closed move as
    the hand does. progress wraps the clouds (tqdm, say). A frame of fewer than 20 points is held. Raises DataError
    for non-finite points, naming the frame, and for a first cloud with too few of them.

    Source: paper, III-D and Eq. 4. `soft` is ours: with the nearest point, chosen once a frame, particles slide along
    the surface and lose the object's motion by centimetres.
    """
    _check(clouds, hand, grasp)
    with torch.inference_mode():
        follower = _first(clouds[0], params)
        grip = _Grip(hand, grasp)
        frames = [_follow(follower, grip, frame, cloud) for frame, cloud in enumerate(progress(clouds))]
    positions, residual, weight, held = (np.array(column) for column in zip(*frames, strict=True))
    first = positions[0, : params.particles]
    springs = build_springs(first, spring_radius(first))
    shown = slice(params.particles)
    return TrackResult(positions[:, shown], residual.astype(np.float32), weight[:, shown], held, springs)


def _check(clouds: Sequence[np.ndarray], hand: np.ndarray | None, grasp: np.ndarray | None) -> None:
    if len(clouds) == 0:
        raise DataError("no frames to track", hint="a recording with at least one frame")
    for frame, cloud in enumerate(clouds):
        if np.ndim(cloud) != 2 or np.shape(cloud)[1] != 3:
            raise DataError(f"the cloud has shape {np.shape(cloud)}, expected [P, 3]", where=f"frame {frame}")
        if not np.isfinite(cloud).all():
            raise DataError("the cloud has non-finite points", where=f"frame {frame}", hint="run fuse again")
    if (hand is None) != (grasp is None):
        raise UsageError("hand positions and grasp flags go together, one of them is missing")
    if hand is None or grasp is None:
        return
    if hand.shape != (len(clouds), 3) or grasp.shape != (len(clouds),):
        raise DataError(f"hand {hand.shape} and grasp {grasp.shape} for {len(clouds)} frames")
    if not np.isfinite(hand[grasp]).all():
        raise DataError("the hand grasps at a non-finite position", hint="run hands again, or leave grasping out")


def _first(cloud: np.ndarray, params: TrackParams) -> "_Follower":
    try:
        return _Follower(cloud, params)
    except DataError as error:
        hint = "start at a frame that shows the whole object, track fewer particles, or use finer voxels in fuse"
        raise DataError(error.message, where="frame 0", hint=hint) from None


def _follow(
    follower: "_Follower", grip: "_Grip", frame: int, cloud: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, bool]:
    """Positions [N, 3], residual, weight [N] and "held" of one frame. In the first one the particles are as chosen."""
    grip.update(frame, follower.positions)
    held = len(cloud) < FEWEST_POINTS
    weight = torch.ones(len(follower.positions))
    if held:
        weight = follower.hold(grip)
    elif frame > 0:
        weight = follower.follow(cloud, grip)
    positions, seen = follower.positions.numpy().copy(), weight.numpy().copy()
    if not seen.any():
        return positions, 0.0, seen, held
    return positions, float(np.average(cKDTree(cloud).query(positions)[0], weights=seen)), seen, held


class _Follower:
    """The particles on their way from cloud to cloud."""

    def __init__(self, cloud: np.ndarray, params: TrackParams):
        soft = params.association == "soft"
        first = choose_particles(cloud, params.tracked if soft else params.particles)
        self.params = params
        self.positions = torch.as_tensor(first, dtype=torch.float32)
        self.graph = build_springs(first, spring_radius(first))
        stiffness = min(params.stiffness, 0.8 * stability_bound(self.graph, params.damping, GRASP_GAIN * params.gain))
        self.settling = GuidanceParams(stiffness=stiffness, gain=params.gain, damping=params.damping)
        check_stability(self.graph, self.settling, GRASP_GAIN)
        self.moving = self.settling.model_copy(update={"iterations": params.iterations})
        self.soft = SoftAssignment(self.positions, thin(cloud, params.points), params.scales) if soft else None

    def follow(self, cloud: np.ndarray, grip: "_Grip") -> Tensor:
        """Move on to the next cloud [P, 3]; returns the weight [N] of each particle in it."""
        if self.soft is not None:
            return self._follow_softly(self.soft, thin(cloud, self.params.points), grip)
        nearest = cKDTree(cloud).query(self.positions.numpy())[1]
        seen = torch.ones(len(self.positions))
        self._settle(torch.as_tensor(cloud[nearest], dtype=torch.float32), seen, grip)
        return seen

    def hold(self, grip: "_Grip") -> Tensor:
        """Nothing is seen: the particles stay, but for those in the hand and what these drag along."""
        unseen = torch.zeros(len(self.positions))
        if grip.holds:
            self._settle(self.positions, unseen, grip)
        return unseen

    def _settle(self, setpoint: Tensor, weight: Tensor, grip: "_Grip") -> None:
        setpoint, gain = grip.override(setpoint, weight)
        self.positions = guide(self.positions[None], setpoint[None], self.graph, self.settling, gain[None])[0]

    def _follow_softly(self, soft: SoftAssignment, cloud: Tensor, grip: "_Grip") -> Tensor:
        self.positions = align(self.positions, cloud)
        velocity = torch.zeros_like(self.positions)
        for turns, scale in zip(self.params.turns, self.params.scales, strict=True):
            rotations = soft.rotations(self.positions)
            for _ in range(turns):
                before = self.positions
                seen_at, seen = soft.setpoint(before, cloud, scale, rotations)
                setpoint, gain = grip.override(seen_at, seen)
                self.positions, velocity = drive(before, velocity, setpoint, self.graph, self.moving, gain)
                if float((self.positions - before).abs().max()) < SETTLED:
                    break
        if not grip.holds:
            self._prefer_rest_shape(soft.rest, cloud)
        return seen

    def _prefer_rest_shape(self, rest: Tensor, cloud: Tensor) -> None:
        """Take the first frame's shape, moved rigidly, where it explains the cloud as well.

        What a hand hides pulls its surroundings out of shape, and springs can fold over and stay folded; a shape that
        nothing asks for is dropped here, so it is not carried on. Objects that did bend are explained worse by it.
        """
        rigid = align(rigid_projection(rest, self.positions[None])[0], cloud)
        if misfit(rigid, cloud) <= RIGID_ENOUGH * misfit(self.positions, cloud):
            self.positions = rigid


class _Grip:
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
