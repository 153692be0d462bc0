"""Colour models: smoothed histograms in CIELAB, compared as log-likelihoods per pixel."""

import numpy as np

BINS = (16, 64, 64)
"""Bins of lightness, green-red and blue-yellow. Lightness is coarse: it changes with shading, the hue hardly does."""
SMOOTHING = (1.5, 1.0, 1.0)
FLOOR = 1e-3
"""Share of every model spread evenly over all colours: what is unlike anything learnt decides nothing."""


def lab_bins(image: np.ndarray) -> np.ndarray:
    """The histogram bin [H, W] int32 of every pixel of an RGB uint8 image [H, W, 3]."""
    return _bins(softened(image))


def softened(image: np.ndarray) -> np.ndarray:
    """An RGB image with less noise, as colours are compared."""
    import cv2

    return cv2.GaussianBlur(image, (3, 3), 0)


def pixel_bins(softened: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The bins [P] of some pixels of an image that is `softened`."""
    return _bins(softened[row, column][:, None])[:, 0]


def _bins(image: np.ndarray) -> np.ndarray:
    import cv2

    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.int32)
    return (lab[..., 0] >> 4) * (BINS[1] * BINS[2]) + (lab[..., 1] >> 2) * BINS[2] + (lab[..., 2] >> 2)


def colour_model(bins: np.ndarray) -> np.ndarray:
    """Log-likelihood [16·64·64] float32 of every colour bin, learnt from the bins [P] of sample pixels (P may be 0)."""
    from scipy.ndimage import gaussian_filter

    size = BINS[0] * BINS[1] * BINS[2]
    counts = np.bincount(bins.ravel(), minlength=size).reshape(BINS).astype(np.float32)
    counts = gaussian_filter(counts, SMOOTHING, mode="nearest")
    share = counts / max(float(counts.sum()), 1e-9)
    return np.log((1 - FLOOR) * share + FLOOR / size).ravel().astype(np.float32)
