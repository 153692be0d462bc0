"""The pinhole camera with Brown-Conrady distortion, placed in the world frame (right-handed, z up, table at z = 0)."""

from dataclasses import dataclass

import numpy as np

UNDISTORT_ITERATIONS = 20
"""Fixed-point steps that invert the distortion; enough for 1e-6 px with lenses of depth cameras."""


@dataclass(frozen=True)
class Camera:
    """One calibrated RGB-D camera; depth is registered to colour.

    The camera frame is OpenCV's: x right, y down, z forward. Depth is z in that frame.
    """

    name: str
    width: int
    height: int
    K: np.ndarray
    """[3, 3] intrinsics in pixels."""
    distortion: np.ndarray
    """[5] k1, k2, p1, p2, k3 (OpenCV order)."""
    T_world_camera: np.ndarray
    """[4, 4] rigid transform, camera points to world points, metres."""
    depth_scale: float = 0.001
    """Metres per unit of a depth image."""

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points [N, 3] (m) to pixels [N, 2] (column, row) and depth [N] (m, along the optical axis).

        Points at or behind the camera plane have meaningless pixels: check depth > 0.
        """
        import cv2

        in_camera = (points - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, :3]
        if len(in_camera) == 0:
            return np.zeros((0, 2)), np.zeros(0)
        pixels, _ = cv2.projectPoints(in_camera.astype(np.float64), np.zeros(3), np.zeros(3), self.K, self.distortion)
        return pixels.reshape(-1, 2), in_camera[:, 2]

    def unproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Lift pixels [N, 2] (column, row) at depth [N] (m) to world points [N, 3] (m)."""
        rays = self.rays(pixels)
        return (rays * depth[:, None]) @ self.T_world_camera[:3, :3].T + self.T_world_camera[:3, 3]

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Undistorted viewing rays [N, 3] of pixels [N, 2] in the camera frame, scaled to z = 1."""
        pixels = np.asarray(pixels, np.float64).reshape(-1, 2)
        focal, centre = self.K[[0, 1], [0, 1]], self.K[:2, 2]
        bent = (pixels - centre) / focal
        k1, k2, p1, p2, k3 = self.distortion
        straight = bent
        for _ in range(UNDISTORT_ITERATIONS):
            x, y = straight.T
            r2 = x**2 + y**2
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            shift = np.column_stack([2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y])
            straight = (bent - shift) / radial[:, None]
        return np.column_stack([straight, np.ones(len(straight))])
