"""Bundle adjustment: poses of cameras and of a board in its places, and lenses, by least squares on reprojection."""

from dataclasses import dataclass, replace

import numpy as np

LENS = 8
"""Of a camera's lens are fitted: two focal lengths, the principal point, k1, k2, p1, p2; what is beyond stays as it is."""


@dataclass(frozen=True)
class Bundle:
    """What is fitted."""

    T_world_camera: np.ndarray
    """[camera, 4, 4]."""
    T_world_board: np.ndarray
    """[place, 4, 4]; the first one is held."""
    place: np.ndarray
    """[instant] place of the board, -1 where it is not known."""
    K: np.ndarray
    """[camera, 3, 3]."""
    distortion: np.ndarray
    """[camera, coefficient]."""

    def deviation(self, pixels: np.ndarray, points: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Standard deviation of focal length and principal point [camera], the larger, as a share of the focal length."""
        problem = _Problem(self, pixels, points, used, lenses=True)
        x = np.zeros(problem.size)
        residuals, J = problem.residuals(x), problem.jacobian(x)
        noise = float(residuals @ residuals) / max(1, len(residuals) - problem.size)
        try:
            covariance = np.linalg.inv(J.T @ J) * noise
        except np.linalg.LinAlgError:
            return np.full(len(self.K), np.inf)
        variance = np.diag(covariance)[problem.poses :].reshape(-1, LENS)[:, :4]
        return np.sqrt(variance.max(1)) if (variance > 0).all() else np.full(len(self.K), np.inf)


def project(fit: Bundle, points: np.ndarray, camera: int, place: int) -> np.ndarray:
    """Where a camera sees points [N, 3] (m) of the board in one of its places: pixels [N, 2]."""
    import cv2

    T = np.linalg.inv(fit.T_world_camera[camera]) @ fit.T_world_board[place]
    inside = points @ T[:3, :3].T + T[:3, 3]
    return cv2.projectPoints(inside, np.zeros(3), np.zeros(3), fit.K[camera], fit.distortion[camera])[0][:, 0]


def refine(
    start: Bundle, pixels: np.ndarray, points: np.ndarray, used: np.ndarray, lenses: bool, robust: bool = False
) -> Bundle:
    """The bundle that fits pixels [camera, instant, corner, 2] of the board's points [corner, 3] (m) best.

    Of images that are `used` [camera, instant]; `robust` weighs down corners that are more than a pixel off.
    """
    from scipy.optimize import least_squares

    problem = _Problem(start, pixels, points, used, lenses)
    loss = "soft_l1" if robust else "linear"
    found = least_squares(
        problem.residuals, np.zeros(problem.size), problem.jacobian, x_scale="jac", loss=loss, f_scale=1.0, max_nfev=60
    )
    return problem.bundle(found.x)


class _Problem:
    """Residuals (px) and their derivatives by small changes of the poses, and of the lenses where these are fitted."""

    def __init__(self, start: Bundle, pixels: np.ndarray, points: np.ndarray, used: np.ndarray, lenses: bool):
        self.start, self.lenses = start, lenses
        self.cameras, self.places = len(start.T_world_camera), len(start.T_world_board)
        self.poses = 6 * (self.cameras + self.places - 1)
        self.size = self.poses + (LENS * self.cameras if lenses else 0)
        self.rows = []
        for c, i in np.argwhere(used):
            known = np.isfinite(pixels[c, i]).all(-1)
            self.rows.append((int(c), int(start.place[i]), points[known], pixels[c, i][known]))
        self.T_camera_world = np.linalg.inv(start.T_world_camera)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([self._row(x, *row)[0].ravel() for row in self.rows])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([self._derivatives(x, *row) for row in self.rows])

    def bundle(self, x: np.ndarray) -> Bundle:
        lenses = [self._lens(x, c) for c in range(self.cameras)]
        return replace(
            self.start,
            T_world_camera=np.linalg.inv([self._camera(x, c) for c in range(self.cameras)]),
            T_world_board=np.array([self._board(x, p) for p in range(self.places)]),
            K=np.array([K for K, _ in lenses]),
            distortion=np.array([d for _, d in lenses]),
        )

    def _camera(self, x: np.ndarray, c: int) -> np.ndarray:
        return _moved(self.T_camera_world[c], x[6 * c : 6 * c + 6])

    def _board(self, x: np.ndarray, p: int) -> np.ndarray:
        first = 6 * (self.cameras + p - 1)
        return _moved(self.start.T_world_board[p], x[first : first + 6]) if p else self.start.T_world_board[p]

    def _lens(self, x: np.ndarray, c: int) -> tuple[np.ndarray, np.ndarray]:
        K, distortion = self.start.K[c].copy(), self.start.distortion[c].copy()
        if self.lenses:
            change = x[self.poses + LENS * c :][:LENS]
            # as shares of the focal length, so that all unknowns are of like size
            focal = self.start.K[c][0, 0]
            K[0, 0], K[1, 1] = K[0, 0] + focal * change[0], K[1, 1] + focal * change[1]
            K[0, 2], K[1, 2] = K[0, 2] + focal * change[2], K[1, 2] + focal * change[3]
            distortion[:4] += change[4:]
        return K, distortion

    def _row(self, x: np.ndarray, c: int, p: int, points: np.ndarray, pixels: np.ndarray):
        """Residuals [N, 2] of one image, OpenCV's derivatives, and the points in the world and in the camera."""
        import cv2

        board, camera = self._board(x, p), self._camera(x, c)
        world = points @ board[:3, :3].T + board[:3, 3]
        inside = world @ camera[:3, :3].T + camera[:3, 3]
        K, distortion = self._lens(x, c)
        projected, J = cv2.projectPoints(inside, np.zeros(3), np.zeros(3), K, distortion)
        return projected[:, 0] - pixels, J, world, inside

    def _derivatives(self, x: np.ndarray, c: int, p: int, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        _, J, world, inside = self._row(x, c, p, points, pixels)
        by_point = J[:, 3:6].reshape(-1, 2, 3)
        made = np.zeros((2 * len(points), self.size))
        camera = self._camera(x, c)
        turned = inside - camera[:3, 3]
        made[:, 6 * c : 6 * c + 3] = _by_turn(by_point, turned, x[6 * c : 6 * c + 3])
        made[:, 6 * c + 3 : 6 * c + 6] = by_point.reshape(-1, 3)
        if p:
            first = 6 * (self.cameras + p - 1)
            by_world = by_point @ camera[:3, :3]
            turned = world - self._board(x, p)[:3, 3]
            made[:, first : first + 3] = _by_turn(by_world, turned, x[first : first + 3])
            made[:, first + 3 : first + 6] = by_world.reshape(-1, 3)
        if self.lenses:
            first = self.poses + LENS * c
            made[:, first : first + 4] = J[:, 6:10] * self.start.K[c][0, 0]
            made[:, first + 4 : first + LENS] = J[:, 10:14]
        return made


def _moved(T: np.ndarray, change: np.ndarray) -> np.ndarray:
    """A pose turned by a rotation vector and shifted, both [3]."""
    from scipy.spatial.transform import Rotation

    moved = T.copy()
    moved[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix() @ T[:3, :3]
    moved[:3, 3] += change[3:]
    return moved


def _by_turn(by_point: np.ndarray, turned: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Derivatives [2 N, 3] by a rotation vector [3] of what has derivatives [N, 2, 3] by the turned points [N, 3]."""
    angle = np.linalg.norm(vector)
    W = _cross(vector[None])[0]
    a, b = (0.5, 1 / 6) if angle < 1e-6 else ((1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3)
    left = np.eye(3) + a * W + b * W @ W
    return -(by_point @ _cross(turned) @ left).reshape(-1, 3)


def _cross(vectors: np.ndarray) -> np.ndarray:
    """Matrices [N, 3, 3] that take the cross product with vectors [N, 3]."""
    x, y, z = vectors.T
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(-1, 3, 3)
