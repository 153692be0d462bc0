"""What a stereo depth camera and a small colour sensor do to perfect images; modelled on an Intel RealSense D455."""

import numpy as np

BASELINE = 0.095
"""Distance of the D455's two infrared imagers, metres; the occluded band beside an object follows from it."""
NOISE = 0.003
"""Standard deviation of depth per squared metre: 1.9 mm at 0.8 m (the data sheet's bound of 2 % at 4 m is 0.005)."""
RANGE = (0.35, 1.6)
"""Readings outside are dropped, as recording tools clip them."""
_CORRELATION = 2.0
_EDGE = 0.02
_GRAZING = 0.2


def sensed_depth(
    depth: np.ndarray,
    slope: np.ndarray,
    focal: float,
    scale: float,
    rng: np.random.Generator,
    noise: float = 1.0,
) -> np.ndarray:
    """The depth image a D455-like camera returns for true depth [H, W] (m; inf or 0 where nothing is).

    `slope` [H, W] is the cosine between the viewing ray and the surface normal, `focal` in pixels, `scale` metres per
    unit, `noise` how many times as strong as a D455's. Returns uint16 [H, W], 0 where there is no reading. Noise grows
    with range squared and is correlated over a few pixels, as block matching makes it; edges get flying pixels, and the
    background left of an object loses a band.
    """
    true = np.where((depth > RANGE[0]) & (depth < RANGE[1]), depth, 0.0)
    jump = _edges(true)
    noisy = _fly(true, jump, rng)
    noisy = noisy + noise * NOISE * noisy**2 * _correlated(true.shape, rng)
    lost = occluded(true, focal) | (slope < _GRAZING * rng.uniform(0.5, 1.0, true.shape))
    lost |= jump & (_correlated(true.shape, rng) > 0.8)
    lost |= _correlated(true.shape, rng) > 3.6
    noisy[lost | (true == 0)] = 0
    return np.clip(np.rint(noisy / scale), 0, 65535).astype(np.uint16)


def occluded(depth: np.ndarray, focal: float) -> np.ndarray:
    """Pixels [H, W] that the right imager cannot see because something nearer, further right, covers them there."""
    position = np.arange(depth.shape[1]) - focal * BASELINE / np.where(depth > 0, depth, np.inf)
    nearest = np.minimum.accumulate(position[:, ::-1], axis=1)[:, ::-1]
    return position > nearest + 0.5


def sensed_color(color: np.ndarray, rng: np.random.Generator, noise: float = 1.0) -> np.ndarray:
    """Sensor noise on RGB in 0..1 [H, W, 3]: read noise plus shot noise, `noise` times. Returns uint8."""
    sigma = noise * (0.006 + 0.006 * np.sqrt(color.mean(-1, keepdims=True)))
    return np.clip(np.rint(255 * (color + sigma * rng.standard_normal(color.shape, np.float32))), 0, 255).astype(
        np.uint8
    )


def _edges(depth: np.ndarray) -> np.ndarray:
    """Pixels beside a step in depth. Inverse depth is affine over any plane, so a slanted table has no edges."""
    import cv2

    inverse = (1.0 / np.where(depth > 0, depth, RANGE[1])).astype(np.float32)
    bend = np.abs(cv2.Laplacian(inverse, cv2.CV_32F, ksize=1))
    return (bend > _EDGE) & (depth > 0)


def _fly(depth: np.ndarray, jump: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth with some edge pixels moved into the gap between the near and the far side."""
    import cv2

    kernel = np.ones((3, 3), np.uint8)
    near = cv2.erode(np.where(depth > 0, depth, RANGE[1]), kernel)
    far = cv2.dilate(depth, kernel)
    share = rng.random(depth.shape)
    flying = jump & (rng.random(depth.shape) < 0.5)
    return np.where(flying, near + share * (far - near), depth)


def _correlated(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Unit-variance noise [H, W], smooth over a few pixels."""
    import cv2

    white = rng.standard_normal(shape, np.float32)
    return cv2.GaussianBlur(white, (0, 0), _CORRELATION) * np.float32(2 * np.sqrt(np.pi) * _CORRELATION)
