"""Particles that follow an object through a recording: the spring-mass system guided to one cloud after another.

Two ways to find the setpoint of a frame: soft assignment (`soft`, the default) and the paper's nearest observed point
(`nearest`). The residual of both only says how near the particles lie to the cloud: particles that slid along the
surface have a small one too, so it is no measure of accuracy; `doubt` is the figure to go by.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.follower import Follower, Found, Grip
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.physics.sheet import Hand
from piegraph_cli.physics.sheet_tracking import follow_sheet, taken_for_sheet
from piegraph_cli.physics.springs import SpringGraph, build_springs
from piegraph_cli.physics.trust import expected_error
from piegraph_cli.physics.visibility import View

LEAST_RADIUS = 0.03  # metres, of the springs
HOLDS = 0.045  # metres between a hand as it is measured and the sheet that it holds
RATE = 5.0  # frames a second, where no times are told


@dataclass(frozen=True, eq=False)
class TrackResult:
    """The tracked particles of one recording."""

    positions: np.ndarray
    """[F, N, 3] float32, metres; a particle keeps its index."""
    residual: np.ndarray
    """[F] float32, metres: mean distance from a seen particle to the nearest point of the cloud; 0 in held frames."""
    weight: np.ndarray
    """[F, N] float32 in 0..1: how much of what a particle saw in the first frame it still sees; 0 where it is hidden."""
    misfit: np.ndarray
    """[F] float32, metres between particles and cloud, both ways; 0 in held frames."""
    held: np.ndarray
    """[F] bool: frames without a usable cloud, in which the particles stayed where they were."""
    lost: np.ndarray
    """[F] bool: frames whose cloud is not explained by the object, wherever it is put: the particles stayed."""
    doubt: np.ndarray
    """[F] float32, metres: how far off the particles are expected to be, see `trust`."""
    springs: SpringGraph
    """Springs of the returned particles, at rest in the first frame."""
    sheet: bool
    """Whether it was followed as a sheet."""


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
    views: Sequence[Sequence[View]] | None = None,
    time: np.ndarray | None = None,
) -> TrackResult:
    """Follow material points of an object through its clouds, [P_f, 3] metres each, table at z = 0.

    hand [F, 3] metres, grasp [F] bool: while grasp holds, the particles within 2 cm of where the hand closed move as
    the hand does. progress wraps the clouds (tqdm, say). views: per frame what each camera sees; without
    them everything counts as seen. With colour images among them a sheet is followed as one: `time` [F] (s; by default
    5 Hz) is what its physics goes by. A frame of fewer than 20 points is held. Raises DataError for non-finite points,
    naming the frame, and for a first cloud with too few of them.

    Source: paper, III-D and Eq. 4. `soft` is ours: with the nearest point, chosen once a frame, particles slide along
    the surface and lose the object's motion by centimetres.
    """
    _check(clouds, hand, grasp)
    views = [()] * len(clouds) if views is None else views
    sheet = taken_for_sheet(clouds[0], views[0], params)
    if sheet:
        time = np.arange(len(clouds)) / RATE if time is None else time
        frames = _sheet(clouds, views, time, params, _near(clouds, hand, grasp), progress)
    else:
        with torch.inference_mode():
            frames = _solid(clouds, views, params, hand, grasp, progress)
    positions, weight = (np.array([getattr(f, name) for f in frames]) for name in ("positions", "weight"))
    residual, misfit = (np.array([getattr(f, name) for f in frames], np.float32) for name in ("residual", "misfit"))
    held, lost = (np.array([getattr(f, name) for f in frames]) for name in ("held", "lost"))
    shown = slice(params.particles)
    springs = build_springs(positions[0, shown], spring_radius(positions[0, shown]))
    doubt = expected_error(positions, weight, misfit, held | lost)
    return TrackResult(positions[:, shown], residual, weight[:, shown], misfit, held, lost, doubt, springs, sheet)


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


def _solid(
    clouds: Sequence[np.ndarray],
    views: Sequence[Sequence[View]],
    params: TrackParams,
    hand: np.ndarray | None,
    grasp: np.ndarray | None,
    progress: Callable[[Sequence[np.ndarray]], Iterable[np.ndarray]],
) -> list[Found]:
    upright = params.mode == "push" or (params.mode == "auto" and grasp is None)
    follower, grip = _first(clouds[0], views[0], params, upright), Grip(hand, grasp)
    return [follower.at(f, cloud, views[f], grip) for f, cloud in enumerate(progress(clouds))]


def _sheet(
    clouds: Sequence[np.ndarray],
    views: Sequence[Sequence[View]],
    time: np.ndarray,
    params: TrackParams,
    hand: Hand | None,
    progress: Callable[[Sequence[np.ndarray]], Iterable[np.ndarray]],
) -> list[Found]:
    try:
        return follow_sheet(clouds, views, time, hand, params.particles, progress)
    except DataError as error:
        raise DataError(error.message, where=error.where or "frame 0", hint=error.hint) from None


def _near(clouds: Sequence[np.ndarray], hand: np.ndarray | None, grasp: np.ndarray | None) -> Hand | None:
    """The hand of picks, and where it may hold the object: from a grasp on, for as long as it is near to the cloud."""
    if hand is None or grasp is None:
        return None
    known = [bool(len(cloud)) and bool(np.isfinite(place).all()) for cloud, place in zip(clouds, hand, strict=True)]
    apart = [
        cKDTree(cloud).query(place)[0] if seen else np.inf
        for cloud, place, seen in zip(clouds, hand, known, strict=True)
    ]
    near = np.array(apart) < HOLDS
    came = int(near.argmax())
    for frame in range(len(near)):  # one that only comes near has nothing yet
        near[frame] = bool(grasp[frame]) or (bool(near[frame]) and frame > 0 and bool(near[frame - 1]))
    return Hand(hand, grasp, near, came)


def _first(cloud: np.ndarray, views: Sequence[View], params: TrackParams, upright: bool) -> Follower:
    try:
        first = choose_particles(cloud, params.tracked if params.association == "soft" else params.particles)
        return Follower(first, build_springs(first, spring_radius(first)), cloud, views, params, upright)
    except DataError as error:
        hint = "start at a frame that shows the whole object, track fewer particles, or use finer voxels in fuse"
        raise DataError(error.message, where="frame 0", hint=hint) from None
