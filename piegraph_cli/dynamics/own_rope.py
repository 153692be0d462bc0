"""A rope that a prior of ropes is to learn: what is none is refused, its springs are fitted, its strokes simulated."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.optimize import differential_evolution
from scipy.spatial.distance import cdist

from piegraph_cli.dynamics.doubts import at_bounds, unexplained
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.family.ropes import (
    DAMPING,
    FRICTION,
    GRIP,
    REACH,
    SPACINGS,
    SPAN,
    STIFFNESS,
    pushed,
    random_numbers,
    simulated,
    traits_of,
)
from piegraph_cli.dynamics.own import HINT, SIMULATED, Own, is_chain, stroke_parts
from piegraph_cli.dynamics.prior import Chunk
from piegraph_cli.dynamics.sms import object_springs
from piegraph_cli.errors import DataError
from piegraph_cli.physics.springs import SpringGraph

SPANS = np.geomspace(*SPAN, 7)
"""Reaches of springs that are tried, as shares of the rope."""
FAR = 2.5
"""Deviations that a number may be from the middle of its family."""
MOST = 60
"""Strokes that numbers are fitted to, about: whole sequences, evenly spread."""
SHAPES, ROWS = 8, 3
"""Sequences whose states simulated strokes begin in, at most; strokes in a row from each."""
KNOWN = np.array([0.2, 0.2, 0.2, 0.07, 0.2])
"""Deviations of the numbers in simulated strokes (of logarithms, and of damping's logit), where there are strokes."""
_OPTIMISER: dict[str, Any] = {"popsize": 4, "maxiter": 25, "tol": 1e-3, "polish": False, "rng": 0, "init": "sobol"}
_NAMES = ("damping", "friction with the table", "reach of the pusher", "friction with the pusher")


@dataclass(frozen=True)
class Fit:
    """The springs of a rope."""

    span: float
    """Longest springs as a share of the rope."""
    numbers: np.ndarray
    """[5] as `ropes.random_numbers` has them."""
    error: float
    """Mean particle error of the strokes (m)."""
    motion: float
    """Mean motion of the particles in them (m)."""
    doubts: list[str]
    """What the user is told of it."""


def check_rope(data: Sequences) -> None:
    """Refuse a recording of something else than a rope that is pushed. Raises `DataError`."""
    hint = "train without --from: the prior is for ropes"
    if data.picks:
        raise DataError("strokes that hold the object; the prior is for ropes that are pushed", hint=hint)
    if not is_chain(data.rest[0]):
        raise DataError("particles do not lie along a line; the prior is for ropes", hint=hint)


def own_rope(data: Sequences, neighbors: int, seed: int) -> Own:
    """The rope of a recording: springs fitted to its strokes; without any, all that the family has."""
    rng = np.random.default_rng([seed, len(data.strokes)])
    if not len(data.strokes):
        return _unknown(rng, data, neighbors)
    fit = fitted(data)
    like = stroke_parts(data, float(fit.numbers[3]))
    chosen = np.unique(np.linspace(0, len(data.rest) - 1, SHAPES).astype(int))
    count = SIMULATED // (len(chosen) * ROWS)
    drawn, traits = [], np.zeros(4)
    for index in chosen:
        graph = springs_of(data.rest[index], fit.span)
        states = data.positions[data.strokes[data.owner == index]].reshape(-1, *data.rest[index].shape)
        before = states[rng.integers(0, len(states), count)] if len(states) else data.rest[[index] * count]
        drawn += simulated(rng, graph, fit.span, varied(rng, fit.numbers, count), before, ROWS, like)
        traits = traits_of(graph, fit.span, fit.numbers[None])[0]
    return Own(torch.as_tensor(traits, dtype=torch.float32), Chunk.of(drawn, neighbors), fit.doubts)


def _unknown(rng: np.random.Generator, data: Sequences, neighbors: int) -> Own:
    drawn = []
    for span in SPANS:
        graph, count = springs_of(data.rest[0], span), SIMULATED // (len(SPANS) * ROWS)
        drawn += simulated(rng, graph, span, random_numbers(rng, count), data.rest[[0] * count], ROWS)
    return Own(torch.zeros(len(drawn[0].traits)), Chunk.of(drawn, neighbors), [])


def varied(rng: np.random.Generator, numbers: np.ndarray, count: int) -> np.ndarray:
    """Numbers [count, 5] about those [5] of one rope."""
    away = rng.normal(0, 1, (count, 5)) * KNOWN
    rows = numbers * np.exp(away)
    rows[:, 0] = np.minimum(rows[:, 0], STIFFNESS[1])
    rows[:, 1] = numbers[1] + away[:, 1]
    return rows


def springs_of(rest: np.ndarray, span: float) -> SpringGraph:
    """The springs of a rope at rest [N, 3] (m) that reach over `span` of its length, and over several spacings."""
    apart = cdist(rest, rest)
    spacing = float(np.median(np.partition(apart, 1, axis=1)[:, 1]))
    return object_springs(rest, max(span * _length(rest), SPACINGS * spacing))


def _length(rest: np.ndarray) -> float:
    """How long a rope [N, 3] (m) is: the longest way through its springs."""
    from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

    ways = dijkstra(minimum_spanning_tree(cdist(rest, rest)), directed=False)
    return float(ways[np.isfinite(ways)].max())


class _Strokes:
    """The strokes that springs are fitted to, and the springs of their ropes at every reach."""

    def __init__(self, data: Sequences):
        owners = np.unique(data.owner)
        few = max(1, MOST * len(owners) // len(data.strokes))
        self.owners = owners[np.unique(np.linspace(0, len(owners) - 1, few).astype(int))]
        self.owner = data.owner
        self.graphs = {(q, k): springs_of(data.rest[q], span) for q in self.owners for k, span in enumerate(SPANS)}
        strokes = data.whole().planar
        self.start, self.end = strokes.start.numpy(), strokes.end.numpy()
        self.before, self.after = (data.positions[k] for k in data.strokes.T)
        seen = np.ones(self.before.shape[:2], bool) if data.seen is None else data.seen[data.strokes].all(1)
        self.weights = seen / seen.sum(1, keepdims=True).clip(1)

    def errors(self, x: np.ndarray) -> np.ndarray:
        """[K, strokes] metres: how far off candidates [K, 6] leave the particles."""
        numbers, level, found = numbers_of(x), _level(x), []
        for q in self.owners:
            mine = np.flatnonzero(self.owner == q)
            error = np.empty((len(x), len(mine)))
            for k in np.unique(level):
                sets = np.flatnonzero(level == k)
                rows, every = np.repeat(numbers[sets], len(mine), 0), np.tile(mine, len(sets))
                moved = pushed(self.graphs[q, k], rows, self.before[every], self.start[every], self.end[every])
                apart = np.linalg.norm(moved - self.after[every], axis=-1)
                error[sets] = (apart * self.weights[every]).sum(1).reshape(len(sets), -1)
            found.append(error)
        return np.concatenate(found, 1)


def fitted(data: Sequences) -> Fit:
    """Springs whose strokes end nearest to those of a recording; numbers that strokes do not tell stay near the middle.

    Raises `DataError` where all of them leave most of the motion.
    """
    strokes = _Strokes(data)

    def score(columns: np.ndarray) -> np.ndarray:
        error = strokes.errors(columns.T)
        return error.shape[1] * np.log(error.mean(1) + 1e-3) + 0.5 * np.square(columns[2:]).sum(0)

    bounds = [(0.0, 1.0), (0.0, 1.0), *[(-FAR, FAR)] * 4]
    best = differential_evolution(score, bounds, vectorized=True, updating="deferred", **_OPTIMISER).x[None]
    error = float(strokes.errors(best).mean())
    motion = float(np.linalg.norm(strokes.after - strokes.before, axis=-1).mean())
    wrong = unexplained(error, motion, "springs", "rope")
    if wrong:
        raise DataError(wrong, hint=HINT)
    ended = list(zip(_NAMES, np.abs(best[0, 2:]) / FAR, strict=True))
    return Fit(float(SPANS[_level(best)[0]]), numbers_of(best)[0], error, motion, at_bounds(ended, "rope"))


def _level(x: np.ndarray) -> np.ndarray:
    return np.minimum((x[:, 0] * len(SPANS)).astype(int), len(SPANS) - 1)


def numbers_of(x: np.ndarray) -> np.ndarray:
    """Numbers [K, 5] of candidates [K, 6]: reach of springs and stiffness within their ranges, deviations of the others."""
    low, high = np.log(STIFFNESS)
    others = [m * np.exp(s * x[:, k]) for k, (m, s) in enumerate((FRICTION, REACH, GRIP), 3)]
    return np.column_stack([np.exp(low + (high - low) * x[:, 1]), DAMPING[0] + DAMPING[1] * x[:, 2], *others])
