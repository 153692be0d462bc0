"""The rope and the T-shirt of DaXBench as environments: its frame and units turned into ours, strokes turned into its.

DaXBench runs in a process of its own (daxbench_child.py); talking to that one is daxbench_process.py's work.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.environments import daxbench_child
from piegraph_cli.environments.base import Environment, Motion, check_state, stroke_frames
from piegraph_cli.environments.daxbench_process import Process, finite, whole
from piegraph_cli.environments.daxbench_setup import installation, problem
from piegraph_cli.environments.params import DaXBenchOptions
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.physics.springs import farthest_point_sample

CHILD = Path(daxbench_child.__file__)
GOAL_STROKES = 2
_MOST_PARTICLES = 100_000
_CENTRE = 0.5
"""Of DaXBench's unit box, along x and z."""
_PUSHER_RADIUS = 0.015
"""Of the disc inside the rope's square pusher, which does not turn, in DaXBench's units.

With the disc around it, random strokes would miss; a corner that starts on the rope only takes it along.
"""
_WALL_MARGIN = 0.01
"""Metres that picks stay away from the walls of the T-shirt's box, at which picker and cloth stop."""


class Task(NamedTuple):
    """How a task of DaXBench appears here."""

    mode: int
    size: float
    """Metres that the undeformed object measures along the longer of its two sides."""


TASKS = {"rope": Task(PUSH, 0.4), "tshirt": Task(PICK, 0.3)}


class Frame(NamedTuple):
    """From DaXBench's frame (y up, centre of its box at 0.5) to ours (z up, metres, origin in the middle of the table)."""

    scale: float
    """Metres per unit of DaXBench."""
    table: float
    """Height y of the undeformed object's underside."""

    @classmethod
    def of(cls, rest: np.ndarray, size: float) -> "Frame":
        """The frame in which the undeformed particles [P, 3] measure `size` (m) and lie on the table."""
        extent = np.ptp(rest.astype(np.float64), axis=0)
        return cls(size / float(max(extent[0], extent[2])), float(rest[:, 1].min()))

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """DaXBench's points [..., 3] in metres: (x, y, z) becomes (x, -z, y), which keeps right-handedness."""
        x, y, z = np.moveaxis(points.astype(np.float64), -1, 0)
        return self.scale * np.stack([x - _CENTRE, _CENTRE - z, y - self.table], -1)

    def to_daxbench(self, point: np.ndarray) -> list[float]:
        """A point [2] (m) on the table as [x, y, z] of DaXBench, which sets the height itself."""
        return [float(point[0]) / self.scale + _CENTRE, 0.0, _CENTRE - float(point[1]) / self.scale]


class DaXBench(Environment):
    """A task of DaXBench; its shape is all of DaXBench's particles, float32 [P, 3] (m).

    DaXBench is slow to start and slow to step: the process is started by the first `reset`, and by a `reset` after it
    broke. Every call that needs it raises DataError when it crashes, hangs or says what it should not.

    Source: paper, section "Simulated Experiments" (rope and T-shirt); the mapping is this project's (docs/daxbench.md).
    """

    triangles = np.empty((0, 3), np.int64)

    def __init__(self, particles: int = 50, options: DaXBenchOptions = DaXBenchOptions(), task: str = "rope"):
        self.modes = (TASKS[task].mode,)
        super().__init__(particles)
        self.options, self.task, self._count = options, task, particles
        self._name = f"daxbench-{task}"
        python, self._repo = installation(options, task)
        self._command = [str(python), str(CHILD), task, str(self._repo)]
        self._process: Process | None = None
        self._frame: Frame | None = None
        self._shape = np.empty((0, 3), np.float32)
        self._chosen = np.empty(0, np.int64)
        self._spacing = 0.0

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """What DaXBench's own reset with a random seed gives, once it is at rest."""
        super().reset(seed=seed)
        if self._process is None or not self._process.running:
            self._process = self._start()
        rest, cloud = self._process.ask("reset", self._read_reset, seed=int(self.np_random.integers(2**31)))
        self._frame = Frame.of(rest, TASKS[self.task].size)
        self._shape = self._world(cloud)
        # chosen on the undeformed object: one index is one material point whatever the seed
        lying = self._frame.to_world(rest)
        self._chosen = farthest_point_sample(lying, self._count)
        self._spacing = float(np.median(cKDTree(lying).query(lying, k=2)[0][:, 1]))
        if TASKS[self.task].mode == PUSH:
            self.pusher_radius = _PUSHER_RADIUS * self._frame.scale
        else:
            wall = _CENTRE * self._frame.scale - _WALL_MARGIN
            self.walls = (-wall, wall, -wall, wall)
        return self.particles(), {}

    def check(self) -> None:
        """Start DaXBench, as far as its modules, and end it again. Raises MissingError with what is missing."""
        self._start().stop()

    def particles(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """Particles of clouds [..., P, 3] (m; by default the current one), float32 [..., N, 3] (m)."""
        self._ready()
        return (self._shape if shapes is None else shapes)[..., self._chosen, :].astype(np.float32)

    def surface(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """DaXBench gives particles only: raises UsageError."""
        raise UsageError("DaXBench's objects cannot be rendered", self._name, "simulate without --render")

    def get_state(self) -> dict[str, np.ndarray]:
        """DaXBench's own state, array by array, in its units."""
        return self._ready().ask("get_state", _read_state)

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Return to a state of `get_state`, bit for bit. Raises DataError for one that is not finite or not its own."""
        now = self.get_state()
        check_state(state, tuple(now), self._name)
        for name, array in now.items():
            given = state[name]
            if (given.shape, given.dtype) != (array.shape, array.dtype):
                raise DataError(
                    f"its {name} is {given.dtype} {given.shape}, not {array.dtype} {array.shape}",
                    self._name,
                    "use what get_state gave",
                )
        packed = {name: daxbench_child.pack(state[name]) for name in now}
        self._shape = self._world(self._ready().ask("set_state", self._read_cloud, state=packed))

    def goal(self, rng: np.random.Generator) -> np.ndarray:
        """What two random strokes make of the object, float32 [N, 3] (m); the state stays."""
        before = self.get_state()
        try:
            for _ in range(GOAL_STROKES):
                self.step(self.sample_stroke(rng))
            return self.particles()
        finally:
            if self._process is not None and self._process.running:
                self.set_state(before)

    def close(self) -> None:
        """End DaXBench's process; `reset` starts another."""
        if self._process is not None:
            self._process.stop()

    def _push(self, start: np.ndarray, end: np.ndarray) -> Motion:
        return self._stroke(start, end)

    def _pick(self, start: np.ndarray, end: np.ndarray) -> Motion:
        return self._stroke(start, end)

    def _stroke(self, start: np.ndarray, end: np.ndarray) -> Motion:
        process, frame = self._ready(), self._frame
        assert frame is not None
        frames = stroke_frames(float(np.linalg.norm(end - start)))

        def read(reply: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, bool]:
            clouds = whole(reply["frames"], (frames + 1, *self._shape.shape))
            tool = finite(whole(reply["tool"], (frames + 1, 3)))
            if not isinstance(reply["grasped"], bool):
                raise ValueError("grasped is neither true nor false")
            return clouds, tool, reply["grasped"]

        points = {"start": frame.to_daxbench(start), "end": frame.to_daxbench(end)}
        clouds, tool, grasped = process.ask("step", read, **points, frames=frames)
        shapes = self._world(clouds)
        self._shape = shapes[-1]
        return Motion(shapes, frame.to_world(tool), grasped)

    def _outline(self) -> tuple[np.ndarray, float]:
        self._ready()
        return self._shape[:, :2].astype(np.float64), self._spacing

    def keeps_reach(self, start: np.ndarray, end: np.ndarray, mode: int) -> bool:
        if mode == PUSH:
            return super().keeps_reach(start, end, mode)
        assert self.walls is not None
        xmin, xmax, ymin, ymax = self.walls
        return bool(xmin <= end[0] <= xmax and ymin <= end[1] <= ymax)

    def _world(self, points: np.ndarray) -> np.ndarray:
        assert self._frame is not None
        return self._frame.to_world(points).astype(np.float32)

    def _ready(self) -> Process:
        if self._process is None or not self._process.running or self._frame is None:
            raise UsageError("DaXBench is not running", self._name, "reset the environment first")
        return self._process

    def _start(self) -> Process:
        process = Process(self._command, self._name, self.options.timeout)
        process.ask("start", self._read_start)
        return process

    def _read_start(self, reply: dict[str, Any]) -> None:
        if (reply["protocol"], reply["task"]) != (daxbench_child.PROTOCOL, self.task):
            raise ValueError(f"it speaks protocol {str(reply['protocol'])[:20]} for {str(reply['task'])[:20]}")
        self._refuse(reply)

    def _read_reset(self, reply: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        self._refuse(reply)
        return _read_reset(reply)

    def _refuse(self, reply: dict[str, Any]) -> None:
        if "problem" in reply:
            raise problem(reply, self._command[0], self._repo, self._name)

    def _read_cloud(self, reply: dict[str, Any]) -> np.ndarray:
        return finite(whole(reply["particles"], self._shape.shape))


def _read_reset(reply: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The undeformed and the current particles, [P, 3] each."""
    rest = finite(daxbench_child.unpack(reply["rest"]))
    if rest.ndim != 2 or rest.shape[1] != 3 or not 4 <= len(rest) <= _MOST_PARTICLES:
        raise ValueError(f"particles of shape {rest.shape}")
    if not max(np.ptp(rest[:, 0]), np.ptp(rest[:, 2])) > 0:
        raise ValueError("an object without extent")
    return rest, finite(whole(reply["particles"], rest.shape))


def _read_state(reply: dict[str, Any]) -> dict[str, np.ndarray]:
    if not isinstance(reply["state"], dict) or "x" not in reply["state"]:
        raise ValueError("a state without particles")
    return {name: daxbench_child.unpack(packed) for name, packed in reply["state"].items()}
