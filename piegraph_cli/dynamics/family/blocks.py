"""Random rigid things on a table and random pushes of them, moved by analytic quasi-static pushing alone.

Outlines, sizes, particles, pressure, friction, pusher and strokes are drawn. Source of the motion: `rigid_kernel`.
"""

import math
from dataclasses import replace

import numpy as np
import torch

from piegraph_cli.dynamics.family.drawn import TOUCHING, TRAITS, Drawn, random_strokes
from piegraph_cli.dynamics.family.outlines import KINDS, SIZE, along, filled, pieces, random_outline
from piegraph_cli.dynamics.rigid_kernel import push
from piegraph_cli.params import PUSH
from piegraph_cli.physics.rigid import moved_in_plane
from piegraph_cli.physics.springs import farthest_point_sample

FRICTION = (0.25, 0.5)
"""With the pusher: median, and deviation of its logarithm."""
PRESSURE = (0.8, 0.15)
"""Turning length as a share of the radius of gyration: median (that of even pressure), and deviation of its logarithm."""
REACH = (0.007, 0.45)
"""The pusher's radius [m]: median, and deviation of its logarithm."""
OFF = 0.08
"""Deviation of the centre of friction from the middle, as a share of the radius of gyration."""
HIGH = 0.03
"""Greatest height of the particles [m]."""
LENGTH = (0.012, 0.15)
"""Of strokes [m], from, to."""
SPACED = 0.7
"""Share of blocks whose particles are as far apart as they can be; those of others lie at random."""
OBJECTS, STROKES = 64, 16
"""Of a chunk, and of each of its objects."""
STRIDE = 1e-3
"""Metres of the pusher in a step of the integration."""
RIM = 0.002
"""Metres between points of an outline that a stroke is laid out by, at most."""
_POINTS = 200
"""Points of the inside that particles are chosen of, beside those of the outline."""

SEEN = {
    "outlines": list(KINDS),
    "size [m], root of the area": SIZE,
    "height of particles [m], up to": HIGH,
    "friction with the pusher, median and deviation of its logarithm": FRICTION,
    "turning length / radius of gyration, median and deviation of its logarithm": PRESSURE,
    "pusher's radius [m], median and deviation of its logarithm": REACH,
    "centre of friction from the middle, deviation as a share of the radius of gyration": OFF,
    "length of strokes [m]": LENGTH,
    "share of strokes that begin in contact": TOUCHING,
}
"""As it is written into a prior's file."""


def draw_blocks(rng: np.random.Generator, particles: int) -> list[Drawn]:
    """Blocks with so many particles, and strokes of each."""
    return [draw_block(rng, particles, STROKES) for _ in range(OBJECTS)]


def draw_block(rng: np.random.Generator, particles: int, strokes: int) -> Drawn:
    """A block and strokes of it from one pose; a stroke may pass beside it."""
    outline = random_outline(rng)
    inner = filled(rng, outline, max(_POINTS, particles))
    middle, gyration = inner.mean(0), math.sqrt(inner.var(0).sum())
    drawn = np.clip(rng.normal(0, 1, 3), -2, 2)
    friction, c, reach = (m * math.exp(s * t) for (m, s), t in zip((FRICTION, PRESSURE, REACH), drawn, strict=True))
    numbers = [friction, c * gyration, reach, *(middle + rng.normal(0, OFF * gyration, 2))]
    rim = along(outline, RIM)
    start, end = random_strokes(rng, rim, np.full(strokes, reach), LENGTH)
    x = _particles(rng, inner, rim, particles)
    x = np.concatenate([x, np.full((particles, 1), rng.uniform(0, HIGH))], 1)
    edges = _tensor(np.concatenate([outline, np.roll(outline, -1, 0)], 1))
    made = _pushed(edges, _tensor(numbers).repeat(strokes, 1), x, start, end)
    return replace(made, traits=np.pad(drawn, (0, TRAITS - 3)))


def simulated(
    rng: np.random.Generator,
    edges: torch.Tensor,
    numbers: torch.Tensor,
    spread: tuple[float, float, float],
    particles: np.ndarray,
    count: int,
    like: np.ndarray | None = None,
) -> Drawn:
    """Random strokes [count] of a body with these particles [N, 3] (m); edges [E, 4] and numbers [5] as for `push`.

    In each stroke the first three numbers are others: `spread` are deviations of their logarithms. `like` [K, 2] (m): how
    far before they touch, and for how long from there on, most strokes are to go; by default they are any.
    """
    rows = numbers.repeat(count, 1)
    rows[:, :3] *= _tensor(np.exp(rng.normal(0, 1, (count, 3)) * spread))
    rim = pieces(edges.numpy().astype(float).reshape(-1, 2, 2), RIM)
    start, end = random_strokes(rng, rim, rows[:, 2].double().numpy(), LENGTH, like)
    return _pushed(edges, rows, particles, start, end)


def _pushed(
    edges: torch.Tensor, numbers: torch.Tensor, particles: np.ndarray, start: np.ndarray, end: np.ndarray
) -> Drawn:
    """Particles [N, 3] (m) of a body under strokes [S], each with its own numbers [S, 5]."""
    count = len(start)
    ends = _tensor(np.concatenate([start, end], 1))
    moved = push(edges, torch.zeros(count, 3), ends, numbers, STRIDE).numpy()
    after = np.stack([moved_in_plane(particles[:, :2], motion) for motion in moved])
    before = np.broadcast_to(particles, (count, *particles.shape))
    return Drawn(
        rest=particles,
        before=before,
        after=np.concatenate([after, before[..., 2:]], 2),
        start=start,
        end=end,
        mode=np.full(count, PUSH),
        held=np.zeros((count, 2), bool),
        traits=np.zeros(TRAITS),
    )


def _tensor(array: np.ndarray | list[float]) -> torch.Tensor:
    return torch.as_tensor(np.asarray(array, np.float32))


def _particles(rng: np.random.Generator, inner: np.ndarray, rim: np.ndarray, count: int) -> np.ndarray:
    """Particles [count, 2] (m) of a block: of its inside and outline, evenly or at random."""
    if rng.random() >= SPACED:
        return rng.permutation(inner)[:count]
    points = rng.permutation(np.concatenate([inner, rim[:: int(rng.integers(2, 8))]]) if rng.random() < 0.7 else inner)
    return points[farthest_point_sample(np.pad(points, ((0, 0), (0, 1))), count)]
