"""The constraints of a sheet's cloth, solved in turn, as kernels.

One thread each: they are solved one after the other, each with what those before it left. Only a CPU runs them.
"""

from typing import Any

import numpy as np
import warp as wp

from piegraph_cli.kernels.lanes import start_warp
from piegraph_cli.physics.sheet_mesh import SheetMesh

GRAVITY = 9.81
FRICTION = 0.6
KEPT = 0.95
"""Share of the velocity that is left after a step."""
FASTEST = 0.8
"""Metres a second; what is pulled out of a false place by its constraints is faster."""
CALM, CALMED = 2, 0.3
"""In how many first steps of a frame what share of the velocity is left: corrections from images left constraints broken."""
STEP = 0.01
"""Seconds."""
SWEEPS = 12
ROUNDS, PLAIN_ROUNDS, AFTER = 20, 60, 5
"""Of a correction: sweeps with data, of a sheet without a pattern, which is drawn along by its border; and without data."""

KERNEL: dict[str, Any] = {"module": "unique", "enable_backward": False}
TINY = wp.constant(1e-9)
KINDS = {"float32": wp.float32, "int32": wp.int32, "int64": wp.int64, "bool": wp.bool}


@wp.struct
class Constraints:
    """What holds a sheet together, in the order in which it is solved."""

    pairs: wp.array2d(dtype=wp.int32)
    """[C, 2]."""
    rest: wp.array(dtype=wp.float32)
    """[C] metres."""
    pulls: wp.array(dtype=wp.float32)
    """[C] share of the error that is taken away where a pair is too far apart."""
    pushes: wp.array(dtype=wp.float32)
    """[C] the same where it is too near."""


@wp.func
def solve(x: wp.array(dtype=wp.vec3), free: wp.array(dtype=wp.float32), c: Constraints):
    for k in range(c.rest.shape[0]):
        i = c.pairs[k, 0]
        j = c.pairs[k, 1]
        total = free[i] + free[j]
        if total > 0.0:
            way = x[j] - x[i]
            length = wp.length(way)
            error = length - c.rest[k]
            share = c.pulls[k]
            if error < 0.0:
                share = c.pushes[k]
            move = way * (share * error / (total * wp.max(length, TINY)))
            x[i] = x[i] + free[i] * move
            x[j] = x[j] - free[j] * move


@wp.func
def lie_on_table(x: wp.array(dtype=wp.vec3), since: wp.array(dtype=wp.vec3), half: float, friction: float):
    """Nothing gets below the table; what presses on it slides less."""
    for i in range(x.shape[0]):
        p = x[i]
        below = half - p[2]
        if below > 0.0:
            slid = wp.vec3(p[0] - since[i][0], p[1] - since[i][1], 0.0)
            kept = wp.min(1.0, friction * below / wp.max(wp.length(slid), TINY))
            x[i] = wp.vec3(p[0] - kept * slid[0], p[1] - kept * slid[1], half)


@wp.kernel(**KERNEL)
def fall(
    x: wp.array(dtype=wp.vec3),
    before: wp.array(dtype=wp.vec3),
    velocity: wp.array(dtype=wp.vec3),
    free: wp.array(dtype=wp.float32),
    carried: wp.array(dtype=wp.vec3),
    c: Constraints,
    half: float,
    friction: float,
    steps: int,
    step: float,
):
    """Let time pass; what is held, free 0, is carried on by an equal part of the way at every step."""
    for s in range(steps):
        for i in range(x.shape[0]):
            before[i] = x[i]
            if free[i] > 0.0:
                velocity[i] = velocity[i] - wp.vec3(0.0, 0.0, GRAVITY * step)
                x[i] = x[i] + velocity[i] * step
            else:
                x[i] = x[i] + carried[i] / float(steps)
        for _sweep in range(SWEEPS):
            solve(x, free, c)
            lie_on_table(x, before, half, friction)
        kept = KEPT
        if s < CALM:
            kept = CALMED
        for i in range(x.shape[0]):
            v = (x[i] - before[i]) * (kept / step)
            velocity[i] = v * wp.min(1.0, FASTEST / wp.max(wp.length(v), TINY))


@wp.kernel(**KERNEL)
def correct(
    x: wp.array(dtype=wp.vec3),
    target: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    across: wp.array(dtype=wp.float32),
    along: wp.array(dtype=wp.float32),
    free: wp.array(dtype=wp.float32),
    c: Constraints,
    half: float,
    rounds: int,
):
    """Draw to targets and keep the cloth together, in turn."""
    for r in range(rounds + AFTER):
        if r < rounds:
            for i in range(x.shape[0]):
                way = target[i] - x[i]
                out = normals[i] * wp.dot(way, normals[i])
                x[i] = x[i] + free[i] * (across[i] * out + along[i] * (way - out))
        solve(x, free, c)
        for i in range(x.shape[0]):
            if x[i][2] < half:
                x[i] = wp.vec3(x[i][0], x[i][1], half)


def memory_of(values: np.ndarray, vectors: bool = False) -> wp.array:
    """An array of numbers, or of `vectors` [..., 3], as Warp sees it, in its own memory: it has to outlive that.

    To have Warp copy it takes longer than most of the kernels.
    """
    assert values.flags.c_contiguous
    kind, shape = (wp.vec3, values.shape[:-1]) if vectors else (KINDS[values.dtype.name], values.shape)
    return wp.array(ptr=values.ctypes.data, dtype=kind, shape=shape, device=wp.get_device("cpu"))


class Cloth:
    """A sheet's kernels with their memory; positions are those of the middle of the sheet, float32 [N, 3] (m)."""

    def __init__(self, mesh: SheetMesh):
        start_warp()
        self.mesh = mesh
        self.constraints = Constraints()
        self.constraints.pairs = wp.array(mesh.pairs, dtype=wp.int32, device="cpu")
        for name in ("rest", "pulls", "pushes"):
            setattr(self.constraints, name, wp.array(getattr(mesh, name), dtype=wp.float32, device="cpu"))

    def fallen(
        self, x: np.ndarray, velocity: np.ndarray, free: np.ndarray, carried: np.ndarray, seconds: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (m/s) after some time; what is not free [N] (1 or 0) is carried by [N, 3] (m)."""
        steps = max(1, round(seconds / STEP))
        given = [np.array(values, np.float32) for values in (x, x, velocity, free, carried)]
        memory = [memory_of(values, values.ndim > 1) for values in given]
        wp.launch(fall, 1, [*memory, self.constraints, self.mesh.half, FRICTION, steps, STEP], device="cpu")
        return given[0], given[2]

    def corrected(
        self,
        x: np.ndarray,
        target: np.ndarray,
        normals: np.ndarray,
        gains: tuple[np.ndarray, np.ndarray],
        free: np.ndarray,
        plain: bool,
    ) -> np.ndarray:
        """Positions drawn to a target [N, 3] (m), with gains [N] (0..1) along unit `normals` [N, 3] and within the sheet."""
        given = [np.array(values, np.float32) for values in (x, target, normals, *gains, free)]
        memory = [memory_of(values, values.ndim > 1) for values in given]
        rounds = PLAIN_ROUNDS if plain else ROUNDS
        wp.launch(correct, 1, [*memory, self.constraints, self.mesh.half, rounds], device="cpu")
        return given[0]
