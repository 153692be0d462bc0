"""What every environment has in common: strokes as actions, the loop around one stroke, random strokes by contact.

No physics here: an environment gives its geometry and carries out checked strokes.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import gymnasium
import numpy as np

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PUSH, mode_word

if TYPE_CHECKING:
    from piegraph_cli.environments.render import Print

FRAME_RATE = 5.0
PUSHER_RADIUS = 0.01
CLEARANCE = 0.008
"""Metres between the pusher's start and its first contact in random strokes."""
TIP_HEIGHT = 0.018
"""Height of the pusher's middle while it pushes, metres."""
STROKE_LENGTHS = (0.03, 0.14)
"""Of random pushes where an environment names no others, metres."""
PICK_LENGTHS = (0.05, 0.25)
"""Of random picks, metres."""
REACH = 0.35
"""Of environments that name no other, metres."""
_GONE = 10.0
_TRIES = 1000


@dataclass(frozen=True)
class Motion:
    """What happened in one stroke at 5 Hz; the first and the last frame are the stroke's ends, both at rest."""

    shapes: np.ndarray
    """[F, ...] the object's configuration per frame, as `particles` and `surface` take it."""
    pusher: np.ndarray
    """[F, 3] the pusher's or gripper's middle, metres."""
    grasped: bool = False


@dataclass(frozen=True)
class GoalState:
    """The object as it lies at a goal."""

    particles: np.ndarray
    """[N, 3] float32, metres."""
    shape: np.ndarray
    """Its configuration there, as `particles` and `surface` take it."""
    copies: np.ndarray
    """[K, N, 3] float32, metres: the particles in every way of lying there that no cloud can tell apart."""


class Environment(gymnasium.Env):
    """One `step` is one stroke: `start` [2] and `end` [2] (m, world) of the pusher or gripper, and `mode` (0 push, 1 pick).

    Observation: the object's particles, float32 [N, 3] (m, world), material points that keep their index. There is
    no reward: planners judge particles themselves. One seed gives one result, bit for bit.

    Source: paper, section "Simulated Experiments" (pusher and picker agents).
    """

    modes: tuple[int, ...] = (PUSH,)
    """What it can do, its main mode first."""
    pusher_radius = PUSHER_RADIUS
    stroke_lengths = STROKE_LENGTHS
    """Of random pushes, metres."""
    reach = REACH
    """No particle gets further from the origin in x or y by random strokes and goals, metres."""
    walls: tuple[float, float, float, float] | None = None
    """xmin, xmax, ymin, ymax that the tool stays inside, metres; None where nothing stops it."""
    triangles: np.ndarray
    """[T, 3] of `surface`, facing outwards."""
    color = (0.035, 0.13, 0.52)
    """Linear RGB of the object in recordings."""

    def __init__(self, particles: int):
        if particles < 4:
            raise UsageError(f"{particles} particles cannot show a pose", hint="use 4 or more; the paper uses 50")
        table = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
        modes = gymnasium.spaces.Discrete(len(self.modes), start=min(self.modes))
        self.action_space = gymnasium.spaces.Dict({"start": table, "end": table, "mode": modes})
        self.observation_space = gymnasium.spaces.Box(-_GONE, _GONE, (particles, 3), np.float32)

    def printed(self, texture: Literal["faint", "print"], rng: np.random.Generator) -> "Print":
        """The pattern of its surface in recordings. Raises UsageError for an object that has none."""
        raise UsageError(f"{type(self).__name__} has no patterns", hint="leave simulate.texture out")

    def step(self, action: dict) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Carry out one stroke.

        The info holds what happened on the way at 5 Hz, first and last frame at the stroke's ends: `frames` [F, N, 3]
        float32 (m), `times` [F] (s), `pusher` [F, 3] (m), `shapes` [F, ...]; further `blocked` (a push started on the
        object), `start_used` [2] (m; then moved back along the stroke until it is free) and `grasped` (a pick holds
        something). Raises UsageError for an impossible stroke, and DataError when the simulation diverged: the state
        is then the one before the stroke.
        """
        start, end, mode = self._check(action)
        before = self.get_state()
        used = self._free_start(start, end) if mode == PUSH else start
        motion = self._push(used, end) if mode == PUSH else self._pick(start, end)
        frames = self.particles(motion.shapes)
        if not np.isfinite(motion.shapes).all() or np.abs(frames).max() > _GONE:
            self.set_state(before)
            raise DataError(
                f"the simulation diverged in a {mode_word(mode)} from {start.round(3)} to {end.round(3)}",
                type(self).__name__,
                "another seed, or softer options of the environment",
            )
        info = {
            "frames": frames,
            "times": np.arange(len(frames)) / FRAME_RATE,
            "pusher": motion.pusher,
            "shapes": motion.shapes,
            "start_used": used,
            "blocked": bool((used != start).any()),
            "grasped": motion.grasped,
        }
        return frames[-1], 0.0, False, False, info

    def check(self) -> None:
        """Raise what would fail every stroke, before there is one; here, nothing would."""

    @abstractmethod
    def particles(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """Particles of shapes [..., *shape] (by default the current one), float32 [..., N, 3] (m)."""

    @abstractmethod
    def surface(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """Vertices of the surface that cameras see, float32 [..., V, 3] (m), as for `particles`."""

    @abstractmethod
    def get_state(self) -> dict[str, np.ndarray]:
        """Everything a stroke's outcome depends on."""

    @abstractmethod
    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Return to a state of `get_state`, bit for bit. Raises DataError for one that is not finite."""

    @abstractmethod
    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """Particles of a goal that can be reached from the current state, float32 [N, 3] (m); the state stays."""

    def goal_state(self, rng: np.random.Generator) -> GoalState:
        """The goal that `goal` draws from the same generator, as cameras could see it; the state stays.

        Raises `UsageError` where an environment tells its goals by particles alone.
        """
        message = f"{type(self).__name__} tells its goals by particles alone: cameras cannot be shown them"
        raise UsageError(message, "plan.look", "--look particles, or --goal FILE")

    @abstractmethod
    def _push(self, start: np.ndarray, end: np.ndarray) -> Motion:
        """Push from a free start [2] to an end [2] (m)."""

    def _pick(self, start: np.ndarray, end: np.ndarray) -> Motion:
        """Grasp what is at start [2], carry it to end [2] (m) and let it go."""
        raise NotImplementedError

    def _outline(self) -> tuple[np.ndarray, float]:
        """Points [P, 2] (m) and the radius (m) around each that together cover the object as seen from above."""
        raise NotImplementedError

    def sample_stroke(self, rng: np.random.Generator, mode: int | None = None) -> dict:
        """A random stroke that touches the object: an action for `step`, in the environment's main mode by default.

        Pushes: the heading is uniform, the lateral offset uniform over the object's silhouette along it, the length
        uniform in `stroke_lengths`, and the start 8 mm before first contact. Picks: a random particle is carried 5-25 cm in
        a random direction. Strokes that could carry the object out of reach are redrawn.
        """
        mode = self.modes[0] if mode is None else mode
        for _ in range(_TRIES):
            start, end = self._random_push(rng) if mode == PUSH else self._random_pick(rng)
            if np.isfinite(start).all() and self.keeps_reach(start, end, mode):
                return {"start": start, "end": end, "mode": mode}
        raise DataError("no random stroke keeps the object in reach", type(self).__name__, "reset the environment")

    def _random_push(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Start and end [2] (m) of a push; infinite where its line falls into a gap of the silhouette."""
        points, radius = self._outline()
        heading, length = rng.uniform(-math.pi, math.pi), rng.uniform(*self.stroke_lengths)
        along = np.array([math.cos(heading), math.sin(heading)])
        across = np.array([-along[1], along[0]])
        offset = rng.uniform(*_span(points @ across))
        contact = first_contact(points, radius + self.pusher_radius, offset * across, along)
        start = offset * across + (contact - CLEARANCE) * along
        return start, start + length * along

    def _random_pick(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        start = rng.choice(self.particles())[:2].astype(np.float64)
        heading, length = rng.uniform(-math.pi, math.pi), rng.uniform(*PICK_LENGTHS)
        return start, start + length * np.array([math.cos(heading), math.sin(heading)])

    def keeps_reach(self, start: np.ndarray, end: np.ndarray, mode: int) -> bool:
        """Whether the object stays within `reach` of the origin if all of it moved with the stroke."""
        along = end - start
        advance = along * max(0.0, 1 - CLEARANCE / np.linalg.norm(along)) if mode == PUSH else along
        points = self._outline()[0] if mode == PUSH else start[None]
        return bool((np.abs(points + advance) <= self.reach).all())

    def _free_start(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The start [2], moved back along the stroke until the pusher's disc is off the object."""
        points, radius = self._outline()
        along = (end - start) / np.linalg.norm(end - start)
        reach = radius + self.pusher_radius
        free = start.copy()
        for _ in range(_TRIES):
            deepest = reach - np.linalg.norm(points - free, axis=1).min()
            if deepest <= 0:
                break
            free -= along * max(deepest, 1e-3)
        return free

    def _check(self, action: dict) -> tuple[np.ndarray, np.ndarray, int]:
        """Start [2], end [2] (m) and mode of an action; UsageError if it is no stroke that this environment knows."""
        start, end = (np.array(action[key], np.float64) for key in ("start", "end"))
        mode = int(action["mode"])
        if mode not in self.modes:
            known = " or ".join(mode_word(m) for m in self.modes)
            raise UsageError(
                f"{type(self).__name__} knows no {mode_word(mode)}", hint=f"{known} strokes in this environment"
            )
        if start.shape != (2,) or end.shape != (2,) or not np.isfinite([start, end]).all():
            raise UsageError(f"a stroke needs two finite planar points, got start {start}, end {end}")
        if np.linalg.norm(end - start) < 1e-3:
            raise UsageError(
                "the stroke is shorter than 1 mm and so has no heading", hint="move its end away from its start"
            )
        return start, end, mode


def _span(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def first_contact(points: np.ndarray, reach: float, through: np.ndarray, along: np.ndarray) -> float:
    """How far from `through` [2] in direction `along` [2] a disc first comes within `reach` (m) of points [P, 2].

    Infinite where the line misses all of them.
    """
    relative = points - through
    depth, side = relative @ along, relative @ np.array([-along[1], along[0]])
    gap = reach**2 - side**2
    hit = gap > 0
    return float((depth[hit] - np.sqrt(gap[hit])).min()) if hit.any() else math.inf


def stroke_frames(length: float) -> int:
    """5 Hz frames that a push of that length (m) takes: 0.8 s for 3 cm, 2 s for 14 cm."""
    return math.ceil((0.5 + 10.0 * length) * FRAME_RATE - 1e-9)


def check_state(state: dict[str, np.ndarray], names: tuple[str, ...], where: str) -> None:
    """Refuse a state that lacks one of the names or holds a value that is not finite. Raises DataError."""
    for name in names:
        if name not in state or not np.isfinite(state[name]).all():
            raise DataError(
                f"its {name} is missing or not finite: not a state of this environment",
                where,
                "use what get_state gave",
            )
