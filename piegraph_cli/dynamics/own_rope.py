"""A rope that a prior of ropes is to learn: what is none is refused, its springs are fitted, its strokes simulated."""

import numpy as np
import torch

from piegraph_cli.dynamics.doubts import at_bounds, unexplained
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.family.ropes import STIFFNESS, random_numbers, simulated, traits_of
from piegraph_cli.dynamics.own import HINT, SIMULATED, Own, is_chain, stroke_parts
from piegraph_cli.dynamics.prior import Chunk
from piegraph_cli.dynamics.spring_fit import SPANS, Fit, fitted, springs_of
from piegraph_cli.errors import DataError

SHAPES, ROWS = 8, 3
"""Sequences whose states simulated strokes begin in, at most; strokes in a row from each."""
KNOWN = np.array([0.2, 0.2, 0.2, 0.07, 0.2])
"""Deviations of the numbers in simulated strokes (of logarithms, and of damping's logit), where there are strokes."""


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
    fit = rope_fit(data)
    numbers = fit.numbers[:5]
    like = stroke_parts(data, float(numbers[3]))
    chosen = np.unique(np.linspace(0, len(data.rest) - 1, SHAPES).astype(int))
    count = SIMULATED // (len(chosen) * ROWS)
    drawn, traits = [], np.zeros(4)
    for index in chosen:
        graph = springs_of(data.rest[index], fit.span)
        states = data.positions[data.strokes[data.owner == index]].reshape(-1, *data.rest[index].shape)
        before = states[rng.integers(0, len(states), count)] if len(states) else data.rest[[index] * count]
        drawn += simulated(rng, graph, fit.span, varied(rng, numbers, count), before, ROWS, like)
        traits = traits_of(graph, fit.span, numbers[None])[0]
    return Own(torch.as_tensor(traits, dtype=torch.float32), Chunk.of(drawn, neighbors), at_bounds(fit.ended, "rope"))


def rope_fit(data: Sequences) -> Fit:
    """The springs of a rope that is pushed. Raises `DataError` where all of them leave most of the motion."""
    fit = fitted(data)
    wrong = unexplained(fit.error, fit.motion, "springs", "rope that was pushed")
    if wrong:
        raise DataError(wrong, hint=HINT)
    return fit


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
