"""A sheet that is followed through colour images: every visible pixel tells how its pattern moves, and physics the rest.

Each frame the cloth is first carried on as one by gravity, friction and the hand (the prior); then optical flow from the
image before, depth and silhouettes correct it; then the same with flow from a picture of the sheet (the atlas), which knows
no drift. What no camera sees is moved by its constraints alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.physics.sheet_atlas import Atlas
from piegraph_cli.physics.sheet_fit import keep_silhouette, lie_in_depth
from piegraph_cli.physics.sheet_flow import Flow
from piegraph_cli.physics.sheet_images import Shot, completed
from piegraph_cli.physics.sheet_kernel import Cloth
from piegraph_cli.physics.sheet_mesh import SheetMesh
from piegraph_cli.physics.sheet_surface import Sums, Surface, faces_of, shades_before, visible

GRASP, REACH = 0.018, 0.035
"""Metres seen from above within which a hand holds all layers of the sheet, and, where there is nothing, the nearest node."""
LEAP = 0.15
"""Metres that a hand moves in a frame, beyond which it is measured wrongly."""
AROUND, ALONG, ALONG_SHARE = 0.06, 0.01, 0.7
"""Metres about a hand in which cloth goes along that it may hold still, and how differently: metres, and share of the way."""
DRIVEN, STIRS = 6.0, 0.004
"""Pixels by which a node's flow is sure enough to drive the cloth, and metres from which a node moves; `FEW` of them do."""
FEW = 3
TAUT, SLACK = 1.15, 0.01
"""How far from the hand the sheet reaches, in lengths of it as it lay flat and metres: what goes farther is told wrongly."""
SETTLING = 0.4
"""Seconds that pass for a sheet that is let go."""
RESTING = 2
"""Frames without motion after which the atlas takes what it has not seen yet."""
LONGEST_STEP = 0.5
"""Seconds between two frames, at most: what moves longer comes to rest."""
GAIN, FULL = 0.3, 6.0
"""Share of the way to its target that a node goes in each sweep, and the summed weight from which it goes all of that."""
FOLDED = 0.012
"""Metres above the table from which a sheet is folded or lifted."""
AWAY = 1.0
"""Metres that no node moves in a frame: a state that does is none."""


@dataclass(frozen=True)
class Hand:
    """The hand of all frames."""

    position: np.ndarray
    """[F, 3] metres, NaN where unknown."""
    holds: np.ndarray
    """[F] bool: where it holds the sheet."""
    near: np.ndarray
    """[F] bool: where it is so near to the sheet, from then on, that it may hold it still."""
    came: int
    """The first frame in which it was near: before, nothing moves but shadows."""


class Grip:
    """The nodes in the hand, which go where it goes; once it may have let go, as long as the cloth around them does too."""

    def __init__(self, hand: Hand | None, nodes: int):
        self.hand = hand
        self.held = np.zeros(nodes, bool)

    def carry(self, frame: int, x: np.ndarray, flow: Sums) -> np.ndarray | None:
        """Close, go on or let go: the way [3] (m) of the nodes of x [N, 3] (m) that are held, None where there are none."""
        if self.hand is None or not self.hand.near[frame]:
            self.held[:] = False
            return None
        place, before = self.hand.position[frame], self.hand.position[max(0, frame - 1)]
        way, holds = place - before, self.hand.holds[max(0, frame - 1) : frame + 1]
        known = bool(np.isfinite(way).all()) and np.linalg.norm(way) < LEAP
        if holds[-1] and not (holds[0] and self.held.any()):
            self.held = self._under(place, x) if np.isfinite(place).all() else np.zeros(len(x), bool)
            return None
        around = self._around(x, flow)
        if not holds[-1] and around.any():
            going = flow.mean()[around].mean(0)
            apart, far = float(np.linalg.norm(way - going)), float(np.linalg.norm(way))
            if np.linalg.norm(going) < STIRS or apart > max(ALONG, ALONG_SHARE * far):
                self.held[:] = False
        return way if known and self.held.any() else None

    def _around(self, x: np.ndarray, flow: Sums) -> np.ndarray:
        """Which nodes [N] about the hand are seen so well that they tell whether the cloth goes along; none of too few."""
        if not self.held.any():
            return self.held
        around = (flow.weight >= DRIVEN) & (np.linalg.norm(x - x[self.held].mean(0), axis=1) < AROUND)
        return around if around.sum() >= FEW else np.zeros(len(x), bool)

    @staticmethod
    def _under(place: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Which nodes [N] of x [N, 3] (m) a hand takes."""
        apart = np.linalg.norm(x[:, :2] - place[:2], axis=1)
        held = apart < GRASP
        if not held.any() and apart.min() < REACH:
            held[apart.argmin()] = True
        return held


@dataclass(frozen=True)
class State:
    """A sheet after a frame."""

    x: np.ndarray
    """[N, 3] float32, metres: the middle of the sheet."""
    normals: np.ndarray
    """[N, 3] unit normals."""
    surfaces: list[Surface]
    """What each camera sees of it."""


class SheetFollower:
    """A sheet on its way from frame to frame."""

    def __init__(self, mesh: SheetMesh, shots: Sequence[Shot], time: np.ndarray, hand: Hand | None):
        """`shots` of the first frame, in which the nodes lie where the mesh has them; `time` [F] (s) of all frames."""
        self.mesh, self.cloth, self.flow, self.atlas = mesh, Cloth(mesh), Flow(), Atlas(mesh)
        self.time, self.hand, self.grip = time, hand, Grip(hand, len(mesh.points))
        self.velocity, self.quiet, self.lifted = np.zeros_like(mesh.points), 0, False
        self.shots = list(shots)
        self.state = self._state(mesh.points)
        self.atlas.fill(self.state.surfaces, self.shots)

    def go_on(self, shots: Sequence[Shot], time: np.ndarray, hand: Hand | None) -> None:
        """The same sheet, where it is now, in further frames at `time` [F] (s): `shots` of the first of them, in which a
        hand may hold it already.
        """
        self.time, self.hand, self.grip = time, hand, Grip(hand, len(self.mesh.points))
        self.shots = list(shots)
        self.state = self._state(self.state.x)
        self.grip.carry(0, self.state.x, Sums(len(self.state.x)))

    def follow(self, frame: int, shots: Sequence[Shot]) -> State:
        """Move on to the next frame. No state leaves that is not finite: what failed is left out."""
        before, shots = self.state, list(shots)
        if self.hand is not None and frame < self.hand.came:
            self.shots = shots
            return before
        flow = Sums(len(before.x))
        for surface, old, now in zip(before.surfaces, self.shots, shots, strict=True):
            self.flow.onwards(surface, old, now, self._tells, flow)
        flow = flow.agreed()
        x = self._sane(self._prior(frame, before.x, flow), before.x)
        state = self._state(x)
        for k, surface in enumerate(state.surfaces):
            shots[k] = completed(shots[k], surface.flat, surface.depth)
        x = self._sane(self._corrected(x, before.x, flow, state, frame, shots), x)
        state, flow = self._state(x), Sums(len(x))
        for k, (surface, shades) in enumerate(zip(state.surfaces, self._carried(state), strict=True)):
            shots[k] = completed(shots[k], surface.flat, surface.depth, shades)
            self.flow.against(surface, shades, shots[k], self._tells, flow)
        x = self._sane(self._corrected(x, x, flow.agreed(), state, frame, shots), x)
        state, drift = self._state(x), Sums(len(x))
        for surface, now in zip(state.surfaces, shots, strict=True):
            self.flow.against(surface, self.atlas.drawn(surface), now, self._tells, drift)
        x = self._sane(self._corrected(x, x, drift.agreed(), state, frame, shots), x)
        self.state, self.shots = self._state(x), shots
        if self.quiet == RESTING:
            self.atlas.fill(self.state.surfaces, shots)
        return self.state

    def _tells(self, surface: Surface, some: np.ndarray) -> np.ndarray:
        """Which of `some` [Q] pixels show what goes where the sheet goes: a pattern, or folds; no shadow on what is flat."""
        return self.atlas.patterned(surface, some) | (surface.points[some, 2] > FOLDED)

    def _carried(self, state: State) -> list[np.ndarray]:
        """The shades [P] of the pixels of a state as the image before has them, NaN for what it does not show."""
        faces = [faces_of(self.mesh, self.state.x, self.state.normals, shot.lens) for shot in self.shots]
        return [
            shades_before(surface, old, shot, corners)
            for surface, old, shot, corners in zip(state.surfaces, self.state.surfaces, self.shots, faces, strict=True)
        ]

    def skip(self, frame: int) -> State:
        """A frame in which nothing is seen of the object: only the hand moves it."""
        nothing = Sums(len(self.state.x))
        self.state = self._state(self._sane(self._prior(frame, self.state.x, nothing), self.state.x))
        return self.state

    def _prior(self, frame: int, x: np.ndarray, flow: Sums) -> np.ndarray:
        """What gravity, friction, the hand and what `flow` tells of make of nodes [N, 3] until this frame.

        Nodes whose flow is sure are boundary conditions, as those in the hand; at rest all stay.
        """
        held, ways = self.grip.held.copy(), flow.mean()
        hand = self.grip.carry(frame, x, flow)
        driven = flow.weight >= DRIVEN
        stirred = int((np.linalg.norm(ways[driven], axis=1) > STIRS).sum()) >= FEW
        freed = hand is None and bool(held.any()) and self.lifted
        self.lifted = hand is not None or (self.lifted and bool(self.grip.held.any()))
        self.quiet = 0 if stirred or freed or hand is not None else self.quiet + 1
        if self.quiet:
            self.velocity[:] = 0
            return x
        if hand is not None:
            driven &= ~self._torn(x, hand, flow)
            ways[self.grip.held] = hand
            driven = driven | self.grip.held
        ways[~driven] = 0
        seconds = min(LONGEST_STEP, float(self.time[frame] - self.time[frame - 1]))
        seconds = max(SETTLING, seconds) if freed else seconds
        x, self.velocity = self.cloth.fallen(x, self.velocity, ~driven, ways, seconds)
        if not np.isfinite(self.velocity).all():
            self.velocity = np.zeros_like(x)
        return x

    def _torn(self, x: np.ndarray, hand: np.ndarray, flow: Sums) -> np.ndarray:
        """Leave out of `flow` the nodes [N] that it takes farther from those in the hand than the sheet reaches."""
        held = self.grip.held
        flat = np.linalg.norm(self.mesh.points - self.mesh.points[held].mean(0), axis=1)
        apart = np.linalg.norm(x + flow.mean() - (x[held].mean(0) + hand), axis=1)
        torn = (apart > TAUT * flat + SLACK) & (flow.weight > 0)
        flow.way[torn], flow.weight[torn] = 0.0, 0.0
        return torn

    def _state(self, x: np.ndarray) -> State:
        normals = self.mesh.normals(x)
        return State(x, normals, visible(self.cloth, x, normals, [shot.lens for shot in self.shots]))

    def _corrected(
        self, x: np.ndarray, start: np.ndarray, flow: Sums, state: State, frame: int, shots: list[Shot]
    ) -> np.ndarray:
        """Nodes [N, 3] drawn to where `flow` takes them from `start` [N, 3], and to depth and silhouettes.

        Depth tells nothing of where in its surface the sheet is: within it nodes go where flow and silhouettes draw them.
        """
        depth, rim = Sums(len(x)), Sums(len(x))
        hand = None if self.hand is None else self.hand.position[frame]
        for surface, shot in zip(state.surfaces, shots, strict=True):
            lie_in_depth(surface, shot, depth)
            keep_silhouette(surface, shot, hand, rim)
        weights = flow.weight, rim.weight / (1 + flow.weight), depth.weight / (1 + flow.weight)
        within, whole = weights[0] + weights[1], sum(weights)
        drawn = weights[0][:, None] * (start - x + flow.mean()) + weights[1][:, None] * rim.mean()
        along = drawn / np.maximum(within, 1e-12)[:, None]
        across = (drawn + weights[2][:, None] * depth.mean()) / np.maximum(whole, 1e-12)[:, None]
        way = along + state.normals * ((across - along) * state.normals).sum(1, keepdims=True)
        gains = GAIN * np.minimum(1.0, whole / FULL), GAIN * np.minimum(1.0, within / FULL)
        free = np.where(self.grip.held, 0.0, 1.0)
        return self.cloth.corrected(x, x + way, state.normals, gains, free, self.atlas.plain)

    @staticmethod
    def _sane(x: np.ndarray, before: np.ndarray) -> np.ndarray:
        """The new nodes, or those before where the new ones are no state of a sheet."""
        return x if np.isfinite(x).all() and np.abs(x - before).max() < AWAY else before
