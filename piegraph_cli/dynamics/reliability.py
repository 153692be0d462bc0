"""How far off a prediction is expected to be, told by two signs that it carries itself: how far the particles move, and how
far the springs had to correct the network, or how far apart a rigid body ends by numbers that other draws of its strokes give.
Strokes that the model did not learn from say what the signs mean."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

ENOUGH = 12
"""Strokes from which all numbers of a calibration are fitted; of fewer the error is a share of the motion."""
GROWTH = 0.75
"""Errors of alike strokes in a row grow with this power of their number: they neither add up nor cancel as chance would."""
BOUND = 0.9
"""Share of the errors that lie below a calibration's bound."""


def signs_of(before: torch.Tensor, setpoint: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """Signs [B, 2] (m) of predictions from `before` that are `setpoint` before any correction and `after` it [B, N, 3] (m).

    Mean distances over the particles: how far they move, and how far they are corrected.
    """
    return torch.stack([(after - other).norm(dim=-1).mean(-1) for other in (before, setpoint)], -1)


@dataclass(frozen=True)
class Calibration:
    """What error (m) to expect of a prediction with these signs."""

    constant: float
    """Metres a stroke."""
    of_motion: float
    of_correction: float
    """Metres per metre."""
    bound: float
    """Expected errors times this are above nine in ten real ones."""

    @classmethod
    def fit(cls, signs: np.ndarray, errors: np.ndarray) -> "Calibration":
        """From signs [n, 2] and errors [n] (m) of strokes that were not learned from: non-negative least squares.

        Which is least squares with some of the three parts, and a plan for a robot has no time to import SciPy for it.
        """
        parts, errors = np.column_stack([np.ones(len(signs)), signs]).astype(float), np.asarray(errors, float)
        some = [(0, 1, 2), (0, 1), (0, 2), (1, 2), (0,), (1,), (2,)] if len(signs) >= ENOUGH else [(1,)]
        fits = [np.zeros(3)]
        for chosen in map(list, some):
            numbers = np.zeros(3)
            numbers[chosen] = np.linalg.lstsq(parts[:, chosen], errors, rcond=None)[0]
            fits.append(numbers)
        numbers = min((n for n in fits if (n >= 0).all()), key=lambda n: float(np.square(parts @ n - errors).sum()))
        expected = parts @ numbers
        known = expected > 0
        bound = float(np.quantile(errors[known] / expected[known], BOUND)) if known.any() else 1.0
        return cls(float(numbers[0]), float(numbers[1]), float(numbers[2]), bound)

    def expected(self, signs: Any, strokes: Any = 1) -> Any:
        """Errors [...] (m) to expect after so many strokes with these signs [..., 2] (m) in all, see `GROWTH`."""
        total = self.constant * strokes + self.of_motion * signs[..., 0] + self.of_correction * signs[..., 1]
        return total * strokes ** (GROWTH - 1)


def calibrated_apart(signs: np.ndarray, errors: np.ndarray, groups: np.ndarray) -> dict[Any, Calibration]:
    """By group, the calibration on signs [n, 2] and errors [n] (m) of all other groups [n]; none where there is one group."""
    names = np.unique(groups)
    return {one: Calibration.fit(signs[groups != one], errors[groups != one]) for one in names if len(names) > 1}
