"""The large planes that one depth camera sees, in its own frame: found without its pose, so that the pose can be judged."""

from dataclasses import dataclass

import numpy as np

from piegraph_cli.recording.camera import Camera

TOLERANCE = 0.01
"""A point within this share of its depth belongs to a plane while planes are searched."""
TRIALS = 160
MOST_PLANES = 3
LEAST_SHARE = 0.12
"""Planes with a smaller share of the readings are not told from chance."""
GRID = 80
"""Rays across the image: enough for a tenth of a millimetre, and quick."""
FIT_STEPS = 6


@dataclass(frozen=True)
class Plane:
    """A plane `normal . p = distance` in the camera's frame (OpenCV axes), seen from its front."""

    normal: np.ndarray
    """[3], unit length, pointing away from the camera."""
    distance: float
    """From the camera, along the normal, metres."""
    centre: np.ndarray
    """[3] middle of its points, metres."""
    share: float
    """Of the readings that lie on it."""


@dataclass(frozen=True)
class Rays:
    """A grid of pixels over one camera's image, with their undistorted viewing rays."""

    columns: np.ndarray
    rows: np.ndarray
    rays: np.ndarray
    """[N, 3] in the camera's frame, z = 1; rows first, as `columns` and `rows` [N]."""
    shape: tuple[int, int]
    """Rows and columns of the grid."""

    @classmethod
    def over(cls, camera: Camera, count: int = GRID) -> "Rays":
        """About `count` rays across, evenly over the whole image, its border included."""
        down = max(2, min(camera.height, round(count * camera.height / camera.width)))
        across = np.rint(np.linspace(0, camera.width - 1, max(2, min(count, camera.width)))).astype(int)
        rows, columns = np.meshgrid(np.rint(np.linspace(0, camera.height - 1, down)).astype(int), across, indexing="ij")
        rays = camera.rays(np.column_stack([columns.ravel(), rows.ravel()]))
        return cls(columns.ravel(), rows.ravel(), rays, rows.shape)

    def points(self, depth: np.ndarray) -> np.ndarray:
        """Points [M, 3] of the rays that have a reading in a depth image [H, W]; in its units."""
        z = depth[self.rows, self.columns].astype(float)
        seen = (z > 0) & np.isfinite(self.rays).all(1)  # the corners of a wide lens may have no ray
        return self.rays[seen] * z[seen, None]


def find_planes(points: np.ndarray) -> list[Plane]:
    """The largest planes, the largest first, among points [N, 3] in the camera's frame; in any unit of length."""
    rng = np.random.default_rng(0)
    left, planes = points, list[Plane]()
    while len(planes) < MOST_PLANES and len(left) >= max(30, LEAST_SHARE * len(points)):
        plane = _largest(left, rng)
        if plane is None:
            break
        normal, distance = _refined(left, *plane)
        on = np.abs(left @ normal - distance) < TOLERANCE * left[:, 2]
        if on.sum() < LEAST_SHARE * len(points):
            break
        planes.append(Plane(normal, distance, left[on].mean(0), float(on.mean() * len(left) / len(points))))
        left = left[np.abs(left @ normal - distance) > 2 * TOLERANCE * left[:, 2]]
    return planes


def _largest(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, float] | None:
    """RANSAC: the plane through three points that holds most others."""
    picked = points[rng.integers(len(points), size=(TRIALS, 3))]
    normals = np.cross(picked[:, 1] - picked[:, 0], picked[:, 2] - picked[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    size = np.median(points[:, 2])
    wide = lengths > (0.03 * size) ** 2
    if not wide.any():
        return None
    normals = normals[wide] / lengths[wide, None]
    distances = (normals * picked[wide, 0]).sum(1)
    tested = points[rng.permutation(len(points))[:1200]]
    near = np.abs(tested @ normals.T - distances) < TOLERANCE * tested[:, 2:]
    best = int(near.sum(0).argmax())
    return normals[best], float(distances[best])


def _refined(points: np.ndarray, normal: np.ndarray, distance: float) -> tuple[np.ndarray, float]:
    """Least squares with Tukey's weights, whose width follows the scatter of the points that are near."""
    reach = 1.5 * TOLERANCE
    for _ in range(FIT_STEPS):
        # noise of depth grows with depth: residuals are taken as shares of it
        off = (points @ normal - distance) / points[:, 2]
        near = np.abs(off) < reach
        if near.sum() < 3:
            break
        reach = min(reach, max(4 * 1.48 * float(np.median(np.abs(off[near]))), 1e-4))
        weight = np.clip(1 - (off / reach) ** 2, 0, None) ** 2 / points[:, 2] ** 2
        middle = weight @ points / weight.sum()
        spread = (points - middle) * np.sqrt(weight)[:, None]
        normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        normal = normal * np.sign(normal @ middle)
        distance = float(normal @ middle)
    return normal, distance
