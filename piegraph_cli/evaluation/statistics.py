"""Means with intervals."""

import numpy as np


def bootstrap_mean(values: np.ndarray, repeats: int = 2000, seed: int = 0) -> tuple[float, float, float]:
    """Mean of values [n] with its 95 % bootstrap interval (mean, low, high); NaN for none."""
    values = np.asarray(values, float)
    if len(values) == 0:
        return (float("nan"),) * 3
    draws = np.random.default_rng(seed).integers(0, len(values), (repeats, len(values)))
    low, high = np.quantile(values[draws].mean(1), [0.025, 0.975])
    return float(values.mean()), float(low), float(high)
