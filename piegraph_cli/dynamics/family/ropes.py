"""Random ropes on a table and random pushes of them, moved by this project's springs alone.

Length, shape at rest, particles, bending, friction, pusher and strokes are drawn. Source of the motion: `dynamics.sms`.
"""

import numpy as np
import torch

from piegraph_cli.dynamics.family.drawn import TRAITS, Drawn, between, random_strokes
from piegraph_cli.dynamics.sms import STABLE, moved, object_springs, push_params, stiffness_of
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PUSH
from piegraph_cli.physics.springs import SpringGraph

SPAN = (0.1, 1.0)
"""Longest springs as a share of the rope, from, to, even in the logarithm: the longer, the less it bends."""
SPACINGS = 2.2
"""Of the particles, that springs reach over at least."""
STIFFNESS = (0.05, STABLE)
"""Of springs, as a share of what they bear, from, to, even in the logarithm."""
DAMPING = (4.2, 0.6)
"""Velocity kept in an iteration: mean and deviation of its logit."""
FRICTION = (2.5e-5, 0.7)
"""With the table, mu g dt^2 [m]: median, and deviation of its logarithm."""
REACH = (0.017, 0.35)
"""Distance of the pusher's middle from the rope's [m]: median, and deviation of its logarithm."""
GRIP = (0.4, 0.5)
"""Friction with the pusher: median, and deviation of its logarithm."""
SOFTNESS = (6e-4, 1.15)
"""Friction over stiffness [m], by which it bends: median, and deviation of its logarithm, as they come out."""
LENGTH = (0.2, 0.8)
"""Of ropes [m], from, to, even in the logarithm."""
CURL = 0.5
"""Share of ropes that are not straight at rest."""
THICK, THIN = 0.01, 0.7
"""Farthest that particles lie off the middle line [m], and share of ropes whose particles lie on it, evenly."""
HIGH = 0.03
"""Greatest height of the particles [m]."""
STROKE = (0.04, 0.3)
"""Length of strokes [m], from, to, even in the logarithm."""
OBJECTS, ALIKE, ROWS = 8, 32, 4
"""Of a chunk: shapes, ropes of that shape with numbers of their own, and strokes in a row of each."""
RIM = 0.002
"""Metres between points of a rope that a stroke is laid out by, at most."""

SEEN = {
    "length [m]": LENGTH,
    "share that is not straight at rest": CURL,
    "farthest that particles lie off the middle line [m]": THICK,
    "height of particles [m], up to": HIGH,
    "longest springs as a share of the rope (bending)": SPAN,
    "stiffness of springs as a share of what they bear": STIFFNESS,
    "velocity kept in an iteration, mean and deviation of its logit": DAMPING,
    "friction with the table [m per iteration squared], median and deviation of its logarithm": FRICTION,
    "distance of the pusher's middle from the rope's [m], median and deviation of its logarithm": REACH,
    "friction with the pusher, median and deviation of its logarithm": GRIP,
    "length of strokes [m]": STROKE,
}
"""As it is written into a prior's file."""


def draw_ropes(rng: np.random.Generator, particles: int) -> list[Drawn]:
    """Ropes of several shapes, many of each, that differ in what they are made of, and strokes of each, in a row."""
    drawn = []
    for _ in range(OBJECTS):
        rest, length = random_rope(rng, particles)
        span = max(between(rng, *SPAN), SPACINGS / (particles - 1))
        graph = object_springs(rest, span * length)
        drawn += simulated(rng, graph, span, random_numbers(rng, ALIKE), np.repeat(rest[None], ALIKE, 0), ROWS)
    return drawn


def random_rope(rng: np.random.Generator, particles: int) -> tuple[np.ndarray, float]:
    """Particles [N, 3] (m) of a rope at rest, and its length (m)."""
    length, even = between(rng, *LENGTH), rng.random() < THIN
    at = np.linspace(0, 1, particles) if even else np.sort(rng.uniform(0, 1, particles))
    fine = np.linspace(0, 1, 200)
    waves = np.cos(np.pi * np.arange(1, 4) * fine[:, None]) @ (rng.normal(0, 0.8, 3) / np.arange(1, 4))
    heading = rng.uniform(0, 2 * np.pi) + waves * (rng.random() < CURL)
    line = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), 0) * (length / len(fine))
    aside = np.column_stack([-np.sin(heading), np.cos(heading)])
    off = np.zeros(particles) if even else rng.uniform(-1, 1, particles) * rng.uniform(0, THICK)
    x, y = (np.interp(at, fine, c) + off * np.interp(at, fine, a) for c, a in zip(line.T, aside.T, strict=True))
    return np.column_stack([x - x.mean(), y - y.mean(), np.full(particles, rng.uniform(0, HIGH))]), length


def random_numbers(rng: np.random.Generator, count: int) -> np.ndarray:
    """Numbers [count, 5] of ropes: stiffness as a share of what springs bear, logit of damping, friction, reach, grip."""
    normal = np.clip(rng.normal(0, 1, (count, 4)), -2, 2)
    low, high = np.log(STIFFNESS)
    stiffness = np.exp(rng.uniform(low, high, count))
    damping = DAMPING[0] + DAMPING[1] * normal[:, 0]
    others = [m * np.exp(s * normal[:, k]) for k, (m, s) in enumerate((FRICTION, REACH, GRIP), 1)]
    return np.column_stack([stiffness, damping, *others])


def simulated(
    rng: np.random.Generator,
    graph: SpringGraph,
    span: float,
    numbers: np.ndarray,
    before: np.ndarray,
    rows: int,
    like: np.ndarray | None = None,
) -> list[Drawn]:
    """Ropes with numbers [B, 5] and the same springs, `span` of their length, each pushed `rows` times from [B, N, 3] (m).

    `like` [K, 2] (m) as for `random_strokes`.
    """
    states, starts, ends = [before], [], []
    for _ in range(rows):
        strokes = [
            random_strokes(rng, dense(x, graph), reach, STROKE, like)
            for x, reach in zip(states[-1], numbers[:, 3:4], strict=True)
        ]
        start, end = (np.concatenate(part) for part in zip(*strokes, strict=True))
        states.append(pushed(graph, numbers, states[-1], start, end))
        starts.append(start)
        ends.append(end)
    every, begins, finishes = np.stack(states, 1), np.stack(starts, 1), np.stack(ends, 1)
    traits = traits_of(graph, span, numbers)
    push, free = np.full(rows, PUSH), np.zeros((rows, 2), bool)
    return [
        Drawn(every[k, 0], every[k, :-1], every[k, 1:], begins[k], finishes[k], push, free, traits[k])
        for k in range(len(before))
    ]


def dense(particles: np.ndarray, graph: SpringGraph) -> np.ndarray:
    """Points [P, 2] (m) of a rope [N, 3] (m): its particles and what joins them."""
    first, second = particles[graph.touched, :2].transpose(1, 0, 2)
    parts = max(1, int(np.ceil(np.linalg.norm(second - first, axis=1).max() / RIM)))
    at = np.linspace(0, 1, parts + 1)[:, None, None]
    return (first + (second - first) * at).reshape(-1, 2)


def pushed(
    graph: SpringGraph, numbers: np.ndarray, before: np.ndarray, start: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Particles [B, N, 3] (m) of ropes with numbers [B, 5] after strokes from start to end [B, 2] (m)."""
    strokes = Strokes.of(start.astype(np.float32), end.astype(np.float32), PUSH)
    params = push_params(graph, torch.as_tensor(numbers))
    return moved(torch.as_tensor(before.astype(np.float32)), strokes, graph, params).numpy()


def traits_of(graph: SpringGraph, span: float, numbers: np.ndarray) -> np.ndarray:
    """Traits [B, TRAITS] of ropes with numbers [B, 5]: reach of springs, friction over stiffness, reach, grip."""
    low, high = np.log(SPAN)
    middle, spread = np.array([SOFTNESS, REACH, GRIP]).T
    drawn = np.column_stack([numbers[:, 2] / stiffness_of(graph, torch.as_tensor(numbers)).numpy(), numbers[:, 3:]])
    traits = np.full((len(numbers), TRAITS), 4 * (np.log(span) - (low + high) / 2) / (high - low))
    traits[:, 1:] = np.log(drawn / middle) / spread
    return np.clip(traits, -2, 2)
