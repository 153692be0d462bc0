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
from piegraph_cli.physics.sheet_images import Shot
from piegraph_cli.physics.sheet_kernel import Cloth
from piegraph_cli.physics.sheet_mesh import SheetMesh
from piegraph_cli.physics.sheet_surface import Sums, Surface, visible

GRASP, REACH = 0.018, 0.035
"""Metres seen from above within which a hand holds all layers of the sheet, and, where there is nothing, the nearest node."""
SETTLING = 0.4
"""Seconds that pass for a sheet that is let go."""
LONGEST_STEP = 0.5
"""Seconds between two frames, at most: what moves longer comes to rest."""
GAIN, FULL = 0.3, 6.0
"""Share of the way to its target that a node goes in each sweep, and the summed weight from which it goes all of that."""
ATLAS = 0.3
"""Weight of the atlas' flow beside that of depth and silhouettes."""
AWAY = 1.0
"""Metres that no node moves in a frame: a state that does is none."""


@dataclass(frozen=True)
class Hand:
    """The hand of all frames."""

    position: np.ndarray
    """[F, 3] metres, NaN where unknown."""
    holds: np.ndarray
    """[F] bool."""


class Grip:
    """The nodes in the hand: a boundary condition of the cloth."""

    def __init__(self, hand: Hand | None, nodes: int):
        self.hand = hand
        self.free = np.ones(nodes, np.float32)
        self.offset = np.zeros((nodes, 3), np.float32)
        self.closed = False

    def carry(self, frame: int, x: np.ndarray) -> np.ndarray:
        """Close, go on or let go: the way [N, 3] (m) of the nodes of x [N, 3] (m) that are held, 0 for the others."""
        way = np.zeros_like(x)
        holds = self.hand is not None and self.hand.holds[frame]
        if self.hand is None or not holds:
            self.closed, self.free = False, np.ones(len(x), np.float32)
            return way
        place = self.hand.position[frame].astype(np.float32)
        if not np.isfinite(place).all():
            return way
        if not self.closed:
            self._close(place, x)
            return way
        held = self.free == 0
        way[held] = place + self.offset[held] - x[held]
        return way

    def _close(self, place: np.ndarray, x: np.ndarray) -> None:
        """Take what is under the hand."""
        apart = np.linalg.norm(x[:, :2] - place[:2], axis=1)
        held = apart < GRASP
        if not held.any() and apart.min() < REACH:
            held[apart.argmin()] = True
        self.closed, self.offset = True, x - place
        self.free = np.where(held, 0.0, 1.0).astype(np.float32)


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
        self.velocity = np.zeros_like(mesh.points)
        self.shots = list(shots)
        self.state = self._state(mesh.points)
        self.atlas.fill(self.state.surfaces, self.shots)

    def follow(self, frame: int, shots: Sequence[Shot]) -> State:
        """Move on to the next frame. No state leaves that is not finite: what failed is left out."""
        before, shots = self.state, list(shots)
        x = self._sane(self._prior(frame, before.x), before.x)
        flow = Sums(len(x))
        for surface, old, now in zip(before.surfaces, self.shots, shots, strict=True):
            self.flow.onwards(surface, old, now, flow)
        x = self._sane(self._corrected(x, before.x, flow.agreed(), 1.0, self._state(x), frame, shots), x)
        state, drift = self._state(x), Sums(len(x))
        for surface, now in zip(state.surfaces, shots, strict=True):
            self.flow.against(surface, self.atlas.drawn(surface), now, drift)
        x = self._sane(self._corrected(x, x, drift.agreed(), ATLAS, state, frame, shots), x)
        self.state, self.shots = self._state(x), shots
        if self._at_rest(frame):
            self.atlas.fill(self.state.surfaces, shots)
        return self.state

    def skip(self, frame: int) -> State:
        """A frame in which nothing is seen of the object: only the hand moves it."""
        self.state = self._state(self._sane(self._prior(frame, self.state.x), self.state.x))
        return self.state

    def _prior(self, frame: int, x: np.ndarray) -> np.ndarray:
        """What gravity, friction and the hand make of nodes [N, 3] until this frame; at rest they stay."""
        way, moving = self.grip.carry(frame, x), self._moving(frame)
        if not moving:
            self.velocity[:] = 0
            return x
        seconds = min(LONGEST_STEP, float(self.time[frame] - self.time[frame - 1]))
        if not self.grip.closed:
            seconds = max(SETTLING, seconds)
        x, self.velocity = self.cloth.fallen(x, self.velocity, self.grip.free, way, seconds)
        if not np.isfinite(self.velocity).all():
            self.velocity = np.zeros_like(x)
        return x

    def _moving(self, frame: int) -> bool:
        """Whether a hand holds the sheet, or let it go just now."""
        return self.hand is not None and bool(self.hand.holds[max(0, frame - 1) : frame + 1].any())

    def _at_rest(self, frame: int) -> bool:
        """Whether the sheet was let go a frame ago."""
        return self.hand is not None and frame > 1 and bool(self.hand.holds[frame - 2]) and not self._moving(frame)

    def _state(self, x: np.ndarray) -> State:
        normals = self.mesh.normals(x)
        return State(x, normals, [visible(self.cloth, x, normals, shot.lens) for shot in self.shots])

    def _corrected(
        self, x: np.ndarray, start: np.ndarray, flow: Sums, share: float, state: State, frame: int, shots: list[Shot]
    ) -> np.ndarray:
        """Nodes [N, 3] drawn to where `flow` takes them from `start` [N, 3], and to depth and silhouettes."""
        fit = Sums(len(x))
        hand = None if self.hand is None else self.hand.position[frame]
        for surface, shot in zip(state.surfaces, shots, strict=True):
            lie_in_depth(surface, shot, fit)
            keep_silhouette(surface, shot, hand, fit)
        flowing = share * flow.weight
        fitting = fit.weight / (1 + flow.weight)
        total = np.maximum(flowing + fitting, 1e-12)[:, None]
        target = (flowing[:, None] * (start + flow.mean()) + fitting[:, None] * (x + fit.mean())) / total
        gain = GAIN * np.minimum(1.0, (flowing + fitting) / FULL)
        return self.cloth.corrected(x, target, gain, self.grip.free)

    @staticmethod
    def _sane(x: np.ndarray, before: np.ndarray) -> np.ndarray:
        """The new nodes, or those before where the new ones are no state of a sheet."""
        return x if np.isfinite(x).all() and np.abs(x - before).max() < AWAY else before
