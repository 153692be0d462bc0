"""Small objects for the physics tests: a T-block as particles and as noisy clouds of its surface, and a rope."""

import numpy as np

HEIGHT = 0.035
BARS = np.array([[-0.1, 0.1, 0.025, 0.075], [-0.025, 0.025, -0.125, 0.025]])
"""The two bars of the T: x from, x to, y from, y to, metres."""
OUTLINE = np.array([-100, 75, 100, 75, 100, 25, 25, 25, 25, -125, -25, -125, -25, 25, -100, 25]).reshape(8, 2) / 1000


def turned(points: np.ndarray, pose: tuple[float, float, float]) -> np.ndarray:
    """Points [..., 3] moved by x, y (m) and yaw (rad)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [pose[0], pose[1], 0]


def surface(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points [count, 3] on the top and the sides of the T, evenly by area."""
    flat = rng.uniform([-0.1, -0.125], [0.1, 0.075], (4 * count, 2))
    inside = ((flat[:, None] >= BARS[:, ::2]) & (flat[:, None] <= BARS[:, 1::2])).all(2).any(1)
    top = np.c_[flat[inside], np.full(inside.sum(), HEIGHT)]
    edges = np.roll(OUTLINE, -1, axis=0) - OUTLINE
    length = np.linalg.norm(edges, axis=1)
    edge = rng.choice(len(edges), 2 * count, p=length / length.sum())
    along = rng.random((2 * count, 1))
    side = np.c_[OUTLINE[edge] + along * edges[edge], rng.uniform(0, HEIGHT, 2 * count)]
    sides = round(count * 0.6)  # 0.8 m of outline by 3.5 cm against 175 cm² of top
    return np.concatenate([top[: count - sides], side[:sides]])


def particles(count: int = 50, seed: int = 0) -> np.ndarray:
    """Particles [count, 3] spread over the T."""
    from piegraph_cli.physics.springs import farthest_point_sample

    points = surface(2000, np.random.default_rng(seed))
    return points[farthest_point_sample(points, count)]


def block_recording(frames: int = 14, seed: int = 0) -> tuple[list[np.ndarray], list[tuple[float, float, float]]]:
    """Clouds of the T on its way (1.3 cm and 7° a frame), 2 mm of noise; a hand hides 6 cm of every third."""
    rng = np.random.default_rng(seed)
    poses = [(0.012 * k - 0.05, 0.005 * k, 0.12 * k) for k in range(frames)]
    clouds = []
    for frame, pose in enumerate(poses):
        points = surface(2500, rng)
        if frame % 3 == 2:
            points = points[np.linalg.norm(points[:, :2] - [0.08, 0.05], axis=1) > 0.03]
        clouds.append(turned(points, pose) + rng.normal(0, 0.002, points.shape))
    return clouds, poses


def rope(bend: float) -> np.ndarray:
    """The upper half of a rope, 30 cm long, 8 mm in radius, bent to an arc of `bend` rad; same points for any bend."""
    rng = np.random.default_rng(1)
    along, around = rng.uniform(-0.15, 0.15, 1500), rng.uniform(0, np.pi, 1500)
    across, up = 0.008 * np.cos(around), 0.008 * (1 + np.sin(around))
    angle = bend * along / 0.3
    radius = 0.3 / bend
    return np.c_[(radius + across) * np.sin(angle), (radius + across) * np.cos(angle) - radius, up]
