"""Springs alone, fitted to strokes: how far they reach, whether they push or only pull, and their numbers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial.distance import cdist
from torch import Tensor, nn

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.family.ropes import DAMPING, FRICTION, GRIP, REACH, SPACINGS, SPAN, STIFFNESS
from piegraph_cli.dynamics.params import SMSParams
from piegraph_cli.dynamics.sms import HOLD, moved, object_springs, push_params
from piegraph_cli.dynamics.stroke import Predict, Spread, Strokes
from piegraph_cli.physics.springs import SpringGraph

SPANS = np.geomspace(*SPAN, 7)
"""Reaches of springs that are tried, as shares of the object's length."""
FAR = 2.5
"""Deviations that a number may be from the middle of what ropes of the prior have."""
HOLDS = 0.5
"""Deviation of the logarithm of how near to a pick's start particles are held."""
MOST = 60
"""Strokes that numbers are fitted to, about: whole sequences, evenly spread."""
OTHERS = 4
"""Other springs that the strokes leave possible, which are kept for how far apart they let strokes end."""
ALIKE = 4
"""Strokes of a sequence err alike: for what is possible so many count as one."""
_OPTIMISER: dict[str, Any] = {"popsize": 4, "maxiter": 25, "tol": 1e-3, "polish": False, "rng": 0, "init": "sobol"}
_NAMES = ("damping", "friction with the table", "reach of the pusher", "friction with the pusher", "reach of the hand")


@dataclass(frozen=True)
class Fit:
    """The springs of an object."""

    span: float
    """Longest springs as a share of the object's length."""
    tension_only: bool
    """Whether they pull but never push."""
    numbers: np.ndarray
    """[6]: five as `sms.push_params` has them, and within how far (m) of its start a pick holds."""
    error: float
    """Mean particle error of the strokes (m)."""
    motion: float
    """Mean motion of the particles in them (m)."""
    ended: list[tuple[str, float]]
    """Where in its range the fit of each number ended, by name: 0 in the middle, 1 at a bound."""
    others: np.ndarray
    """[`OTHERS`, 8]: springs that the strokes leave possible: span, whether they only pull, and six numbers."""


class SMS(nn.Module):
    """What `sms-o` has learned: a `Fit`. Source: paper, IV-B, ablation SMS(O)."""

    others: Tensor

    def __init__(self, params: SMSParams):
        super().__init__()
        self.params = params
        self.register_buffer("span", torch.zeros(()))
        self.register_buffer("tension_only", torch.zeros((), dtype=torch.uint8))
        self.register_buffer("numbers", torch.zeros(6))
        self.register_buffer("others", torch.zeros(0, 8))

    def _load_from_state_dict(self, state_dict: dict, prefix: str, *rest: Any) -> None:
        kept = state_dict.setdefault(prefix + "others", self.others)  # earlier models have none
        self.others = torch.empty_like(kept)
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def fit(self, data: Sequences) -> Fit:
        """Take the numbers that fit the strokes of a recording best."""
        found = fitted(data)
        self.span, self.tension_only = torch.tensor(found.span), torch.tensor(found.tension_only, dtype=torch.uint8)
        self.numbers = torch.as_tensor(found.numbers, dtype=torch.float32)
        self.others = torch.as_tensor(found.others, dtype=torch.float32)
        return found

    def predict(self, rest: np.ndarray) -> Predict:
        """The predict function of an object at rest [N, 3] (m)."""
        return _predict(rest, torch.cat([torch.stack([self.span, self.tension_only.to(self.span)]), self.numbers]))

    def spread(self, rest: np.ndarray) -> Spread | None:
        """How far (m, mean over particles) from a prediction strokes end by other springs; None of earlier models."""
        others = [_predict(rest, other) for other in self.others]

        def spread(positions: Tensor, strokes: Strokes, after: Tensor) -> Tensor:
            apart = [(other(positions, strokes) - after).norm(dim=-1).mean(-1) for other in others]
            return torch.stack(apart).mean(0)

        return spread if others else None


def _predict(rest: np.ndarray, springs: Tensor) -> Predict:
    """The predict function of an object at rest [N, 3] (m) with springs [8] as `Fit.others` has them."""
    graph, numbers = springs_of(rest, float(springs[0])), springs[2:]
    params = push_params(graph, numbers[:5], bool(springs[1]))
    return lambda positions, strokes: moved(positions, strokes, graph, params, hold=numbers[5])


def springs_of(rest: np.ndarray, span: float) -> SpringGraph:
    """The springs of an object at rest [N, 3] (m) that reach over `span` of its length, and over several spacings."""
    apart = cdist(rest, rest)
    spacing = float(np.median(np.partition(apart, 1, axis=1)[:, 1]))
    return object_springs(rest, max(span * _length(rest), SPACINGS * spacing))


def _length(rest: np.ndarray) -> float:
    """How long an object [N, 3] (m) is: the longest way through the shortest springs that join it all."""
    from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

    ways = dijkstra(minimum_spanning_tree(cdist(rest, rest)), directed=False)
    return float(ways[np.isfinite(ways)].max())


class _Strokes:
    """The strokes that springs are fitted to, and the springs of their objects at every reach."""

    def __init__(self, data: Sequences):
        owners = np.unique(data.owner)
        few = max(1, MOST * len(owners) // len(data.strokes))
        self.owners = owners[np.unique(np.linspace(0, len(owners) - 1, few).astype(int))]
        self.owner = data.owner
        self.kinds = [
            (k, tension) for tension in ((False, True) if data.picks else (False,)) for k in range(len(SPANS))
        ]
        self.graphs = {(q, k): springs_of(data.rest[q], span) for q in self.owners for k, span in enumerate(SPANS)}
        self.strokes = data.whole().planar.to(torch.float32)
        self.before, self.after = (torch.as_tensor(data.positions[k], dtype=torch.float32) for k in data.strokes.T)
        seen = np.ones(self.before.shape[:2], bool) if data.seen is None else data.seen[data.strokes].all(1)
        self.weights = seen / seen.sum(1, keepdims=True).clip(1)

    def kind(self, x: np.ndarray) -> np.ndarray:
        """[K] which of the kinds of springs candidates [K, 6 or 7] have."""
        return np.minimum((x[:, 0] * len(self.kinds)).astype(int), len(self.kinds) - 1)

    def springs(self, x: np.ndarray) -> np.ndarray:
        """[K, 8] what candidates [K, 6 or 7] are, as `Fit.others` has them."""
        spans, tension = np.array(self.kinds)[self.kind(x)].T
        return np.column_stack([SPANS[spans], tension, numbers_of(x)])

    def errors(self, x: np.ndarray) -> np.ndarray:
        """[K, strokes] metres: how far off candidates [K, 6 or 7] leave the particles."""
        numbers, kinds, found = numbers_of(x), self.kind(x), []
        for q in self.owners:
            mine = np.flatnonzero(self.owner == q)
            error = np.empty((len(x), len(mine)))
            for kind in np.unique(kinds):
                sets, (span, tension) = np.flatnonzero(kinds == kind), self.kinds[kind]
                rows, every = torch.as_tensor(np.repeat(numbers[sets], len(mine), 0)), np.tile(mine, len(sets))
                graph, strokes = self.graphs[q, span], self.strokes[torch.as_tensor(every)]
                params = push_params(graph, rows[:, :5], tension)
                found_after = moved(self.before[every], strokes, graph, params, hold=rows[:, 5].float())
                apart = np.linalg.norm((found_after - self.after[every]).numpy(), axis=-1)
                error[sets] = (apart * self.weights[every]).sum(1).reshape(len(sets), -1)
            found.append(error)
        return np.concatenate(found, 1)


def fitted(data: Sequences) -> Fit:
    """Springs whose strokes end nearest to those of a recording; numbers that strokes do not tell stay near the middle."""
    strokes = _Strokes(data)

    tried: list[tuple[np.ndarray, np.ndarray]] = []

    def score(columns: np.ndarray) -> np.ndarray:
        error = strokes.errors(columns.T)
        found = error.shape[1] * np.log(error.mean(1) + 1e-3) + 0.5 * np.square(columns[2:]).sum(0)
        tried.append((columns.T.copy(), found))
        return found

    from scipy.optimize import differential_evolution  # planning does without

    bounds = [(0.0, 1.0), (0.0, 1.0), *[(-FAR, FAR)] * (5 if data.picks else 4)]
    best = differential_evolution(score, bounds, vectorized=True, updating="deferred", **_OPTIMISER).x[None]
    candidates, scores = (np.concatenate(part) for part in zip(*tried, strict=True))
    (span, tension, *numbers), *others = strokes.springs(np.concatenate([best, _possible(candidates, scores)]))
    motion = float(np.linalg.norm(strokes.after - strokes.before, axis=-1).mean())
    ended = list(zip(_NAMES, (np.abs(best[0, 2:]) / FAR).tolist(), strict=False))
    error = float(strokes.errors(best).mean())
    return Fit(float(span), bool(tension), np.array(numbers), error, motion, ended, np.array(others))


def _possible(x: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Of candidates [K, 6 or 7] that were tried, `OTHERS`, drawn by how well they fit."""
    weights = np.exp((scores.min() - scores) / ALIKE)
    return x[np.random.default_rng(0).choice(len(x), OTHERS, p=weights / weights.sum())]


def numbers_of(x: np.ndarray) -> np.ndarray:
    """Numbers [K, 6] of candidates: kind of springs and stiffness within their ranges, deviations of the others [K, 4 or 5]."""
    low, high = np.log(STIFFNESS)
    ranges = (FRICTION, REACH, GRIP, (HOLD, HOLDS))
    others = [m * np.exp(s * x[:, k]) for k, (m, s) in zip(range(3, x.shape[1]), ranges, strict=False)]
    hold = [np.full(len(x), HOLD)] if len(others) < len(ranges) else []
    return np.column_stack([np.exp(low + (high - low) * x[:, 1]), DAMPING[0] + DAMPING[1] * x[:, 2], *others, *hold])
