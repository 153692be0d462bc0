"""Which strokes to record next: those whose end a model knows least of, unlike those it has learned from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from piegraph_cli.dynamics.reliability import Calibration
from piegraph_cli.dynamics.sides import on_object
from piegraph_cli.dynamics.stroke import Foresee, Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.planning.proposals import StrokeSpace

CANDIDATES = 500
"""Strokes that are compared."""

ALIKE = 0.5
"""Strokes whose ends on the object are so far from each other, in sizes of the object, tell three fifths of one another."""


@dataclass(frozen=True)
class Suggestions:
    """Strokes to record, the most telling first."""

    strokes: Strokes
    """[n]."""
    unsure: np.ndarray
    """[n] metres: how far off their prediction is expected to be."""
    new: np.ndarray
    """[n] 0 to 1: how unlike they are to what was recorded, and to those before them."""
    reason: str
    """Where `unsure` is from: `spread`, `expected error` or `motion`."""


def suggest(
    models: Sequence[Foresee],
    calibration: Calibration | None,
    state: np.ndarray,
    pose: np.ndarray,
    size: float,
    space: StrokeSpace,
    known: np.ndarray,
    count: int,
    seed: int,
) -> Suggestions:
    """So many strokes on the particles `state` [N, 3] (m) of an object at `pose` [3] whose size (m) is a radius of gyration.

    `models`: one, or some of several seeds, whose spread then says how unsure they are; `known` [K, 5]: strokes it has
    learned from, see `on_object`. One after the other the stroke is taken of which most is unknown: how unsure the model is
    times how unlike it is to all known and taken before. Raises `DataError` where no stroke is feasible.
    """
    generator = torch.Generator().manual_seed(seed)
    now = torch.as_tensor(state, dtype=torch.float32).expand(CANDIDATES, -1, -1)
    strokes, feasible = space.strokes(now, space.sample((CANDIDATES,), generator))
    if not feasible.any():
        raise DataError(
            "no stroke is feasible on the object where it lies",
            hint="plan.workspace, plan.keep_out; or another --state",
        )
    strokes = strokes[feasible]
    unsure, reason = _unsure(models, calibration, now[: len(strokes)], strokes)
    seen = on_object(strokes, np.tile(pose, (len(strokes), 1)), size)
    new = 1 - _alike(seen, known).max(1, initial=0.0)
    chosen, novelty = [], []
    for _ in range(min(count, len(strokes))):
        best = int((unsure * new).argmax())
        chosen.append(best)
        novelty.append(new[best])
        new = np.minimum(new, 1 - _alike(seen, seen[best : best + 1])[:, 0])
    return Suggestions(strokes[torch.tensor(chosen)], unsure[chosen], np.array(novelty), reason)


def _unsure(
    models: Sequence[Foresee], calibration: Calibration | None, now: torch.Tensor, strokes: Strokes
) -> tuple[np.ndarray, str]:
    """Of each stroke [B], metres, and from what."""
    found = [foresee(now, strokes) for foresee in models]
    if len(found) > 1:
        ends = torch.stack([after for after, _ in found])
        off = (ends - ends.mean(0)).square().sum(-1).sum(0) / (len(found) - 1)
        return off.sqrt().mean(-1).double().numpy(), "spread"
    signs = found[0][1].double().numpy()
    if calibration is not None:
        return calibration.expected(signs), "expected error"
    return signs[:, 0], "motion"


def _alike(strokes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """How much strokes [A, 5] tell of others [B, 5], 0 to 1 [A, B]; those of other modes nothing."""
    apart = np.square(strokes[:, None, :4] - others[None, :, :4]).sum(-1)
    return np.exp(-0.5 * apart / ALIKE**2) * (strokes[:, None, 4] == others[None, :, 4])
