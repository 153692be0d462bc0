"""Means and effect sizes with bootstrap intervals."""

import numpy as np

REPEATS = 2000


def bootstrap_mean(values: np.ndarray, repeats: int = REPEATS, seed: int = 0) -> tuple[float, float, float]:
    """Mean of values [n] with its 95 % bootstrap interval (mean, low, high); NaN for none."""
    values = np.asarray(values, float)
    if len(values) == 0:
        return (float("nan"),) * 3
    draws = np.random.default_rng(seed).integers(0, len(values), (repeats, len(values)))
    low, high = np.quantile(values[draws].mean(1), [0.025, 0.975])
    return float(values.mean()), float(low), float(high)


def bootstrap_grid(values: np.ndarray, repeats: int = REPEATS, seed: int = 0) -> tuple[float, float, float]:
    """Mean of values [seed, sequence] with its 95 % interval (mean, low, high) over both; NaN for none.

    One value alone has no interval: its ends are NaN.

    A resample draws seeds and sequences anew, so that the interval holds for other trainings and other test sequences.
    """
    values = np.asarray(values, float)
    if values.size <= 1:
        return (float(values.sum() if values.size else np.nan), float("nan"), float("nan"))
    rng = np.random.default_rng(seed)
    seeds, sequences = (rng.multinomial(n, np.full(n, 1 / n), repeats).astype(float) / n for n in values.shape)
    low, high = np.quantile(((seeds @ values) * sequences).sum(1), [0.025, 0.975])
    return float(values.mean()), float(low), float(high)


def cliffs_delta(first: np.ndarray, second: np.ndarray) -> float:
    """P(first < second) - P(first > second) of values [n], [m]: 1 where every first one is smaller, that is better.

    Infinite values (never solved) are ties among themselves. NaN for none. Source: paper, IV-A.
    """
    return float(_signs(first, second).mean()) if len(first) and len(second) else float("nan")


def cliffs_delta_paired(
    first: np.ndarray, second: np.ndarray, repeats: int = REPEATS, seed: int = 0
) -> tuple[float, float, float]:
    """Cliff's delta of values [n], [n] with its 95 % interval (delta, low, high), from a bootstrap over pairs.

    Value k of both comes from the same task. A hard task is hard for both, so the two samples are not independent, and
    a resample keeps or drops the two values of a task together.
    """
    n = len(first)
    if len(second) != n:
        raise ValueError(f"{n} and {len(second)} values are not pairs")
    if n == 0:
        return (float("nan"),) * 3
    counts = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), repeats).astype(float)
    signs = _signs(first, second)
    low, high = np.quantile(((counts @ signs) * counts).sum(1) / n**2, [0.025, 0.975])
    return float(signs.mean()), float(low), float(high)


def verdict(gain: tuple[float, float, float]) -> str:
    """`better`, `worse` or `level` of a gain (mean, low, high): whether its interval lies above zero, below, or around it.

    Empty where there is no interval.
    """
    _, low, high = gain
    if not (np.isfinite(low) and np.isfinite(high)):
        return ""
    return "better" if low > 0 else "worse" if high < 0 else "level"


def _signs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[n, m] 1 where the first value is smaller, -1 where it is larger, 0 for a tie."""
    a, b = np.asarray(first, float)[:, None], np.asarray(second, float)
    return (a < b) * 1.0 - (a > b) * 1.0
