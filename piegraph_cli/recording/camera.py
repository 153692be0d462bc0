"""The pinhole camera with Brown-Conrady distortion, placed in the world frame (right-handed, z up, table at z = 0)."""

from dataclasses import dataclass

import numpy as np

from piegraph_cli.errors import DataError

UNDISTORT_ITERATIONS = 20
"""Fixed-point steps that invert the distortion, at most; enough for 1e-6 px with lenses of depth cameras."""

SKEW = 0.01
"""What the second number of intrinsics may be, as a share of the focal length; it is not used."""

FAR_MIDDLE = 0.2
"""Share of an image's size by which the middle of its lens lies beside its own only where K is that of other images."""
BENT_BACK = 1.0
"""Pixels within which a lens that is undone and applied again has to come back."""


def check_intrinsics(K: np.ndarray, name: str, where: str) -> np.ndarray:
    """A finite matrix [3, 3], if it is one of intrinsics: fx 0 cx, 0 fy cy, 0 0 1. Raises `DataError` where it is not."""
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise DataError(f"{name} must have positive focal lengths", where, "its rows are fx 0 cx, 0 fy cy, 0 0 1")
    if abs(K[0, 1]) > SKEW * K[0, 0] or not np.allclose([K[1, 0], *K[2]], [0, 0, 0, 1], atol=1e-6):
        why = ": it is transposed" if np.allclose(K[:2, 2], 0) and K[2, :2].any() else ""
        raise DataError(f"{name} is no matrix of intrinsics{why}", where, "its rows are fx 0 cx, 0 fy cy, 0 0 1")
    return K


def check_transform(T: np.ndarray, name: str, where: str, hint: str) -> np.ndarray:
    """A matrix [4, 4], if it is a rigid transform. Raises `DataError` where it is not."""
    if np.allclose(T[:, 3], [0, 0, 0, 1]) and T[3, :3].any():
        raise DataError(f"{name} is transposed: it has the translation in its last row", where, "write its transpose")
    if not np.allclose(T[3], [0, 0, 0, 1]):
        raise DataError(f"{name} must be a finite 4 x 4 rigid transform", where, hint)
    if not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3) or np.linalg.det(T[:3, :3]) < 0:
        if np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3):
            raise DataError(
                f"the rotation in {name} is mirrored: its axes are left-handed", where, "negate one of them"
            )
        raise DataError(f"the rotation in {name} is singular or not a rotation", where, hint)
    return T


def check_lens(K: np.ndarray, distortion: np.ndarray, size: tuple[int, int], name: str, where: str) -> None:
    """Raise `DataError` where a distortion cannot be undone in the middle of an image of a size (width, height) in pixels.

    Coefficients in another order, or those of another lens model, fold the image; what is seen there has no ray. Corners
    of wide lenses fold in good calibrations too.
    """
    import cv2

    across, down = (np.linspace(0.25 * length, 0.75 * length, 9) for length in size)
    pixels = np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)
    with np.errstate(all="ignore"):
        rays = straight_rays(pixels, K, distortion)
        back = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, distortion)[0].reshape(-1, 2)
        right = np.abs(back - pixels).max(1) <= BENT_BACK
    if not right.all():
        x, y = pixels[np.flatnonzero(~right)[0]]
        text = f"{name} cannot be undone: around pixel {x:.0f}, {y:.0f} it folds the image"
        hint = "the order is k1 k2 p1 p2 k3 k4 k5 k6; for a fisheye model undistort the images and give zeros"
        if np.abs(K[:2, 2] / size - 0.5).max() > FAR_MIDDLE:
            text += f"; K has its middle at {K[0, 2]:.0f}, {K[1, 2]:.0f} px, far from that of {size[0]} x {size[1]}"
            hint = "give K of images of this size: its first two rows, times what the images were resized by"
        raise DataError(text, where, hint)


@dataclass(frozen=True)
class Camera:
    """One calibrated RGB-D camera; its depth is registered to colour, or `depth_view` says where it was seen from.

    The camera frame is OpenCV's: x right, y down, z forward. Depth is z in that frame.
    """

    name: str
    width: int
    height: int
    K: np.ndarray
    """[3, 3] intrinsics in pixels."""
    distortion: np.ndarray
    """[5, 8, 12 or 14] k1, k2, p1, p2, k3, then k4, k5, k6, then s1, s2, s3, s4, then the tilt x, y (OpenCV order)."""
    T_world_camera: np.ndarray
    """[4, 4] rigid transform, camera points to world points, metres."""
    depth_scale: float = 0.001
    """Metres per unit of a depth image."""
    depth_view: "DepthView | None" = None
    """The camera that saw the depth, where it is not registered to colour."""

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
        return straight_rays(pixels, self.K, self.distortion)


@dataclass(frozen=True)
class DepthView:
    """The camera that saw depth images which are not registered to colour."""

    width: int
    height: int
    K: np.ndarray
    """[3, 3] intrinsics in pixels."""
    distortion: np.ndarray
    """As that of `Camera`."""
    T_color_depth: np.ndarray
    """[4, 4] rigid transform, points of the depth camera to points of the colour camera, metres."""


def straight_rays(pixels: np.ndarray, K: np.ndarray, distortion: np.ndarray, enough: float = 0.0) -> np.ndarray:
    """Undistorted viewing rays [N, 3], scaled to z = 1, of pixels [N, 2] of a camera with K [3, 3] and `distortion`.

    They are improved until none moves by more than `enough`.
    """
    focal, centre = K[[0, 1], [0, 1]], K[:2, 2]
    bent = (pixels - centre) / focal
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tilt_x, tilt_y = np.pad(distortion, (0, 14 - len(distortion)))
    if tilt_x or tilt_y:
        bent = _untilted(bent, tilt_x, tilt_y)
    straight = bent
    with np.errstate(all="ignore"):  # where a lens folds its corners there is no ray
        for _ in range(UNDISTORT_ITERATIONS):
            x, y = straight.T
            r2 = x**2 + y**2
            radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
            shift = np.column_stack(
                [
                    2 * p1 * x * y + p2 * (r2 + 2 * x**2) + r2 * (s1 + r2 * s2),
                    p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + r2 * (s3 + r2 * s4),
                ]
            )
            before, straight = straight, (bent - shift) / radial[:, None]
            if len(straight) and np.abs(straight - before).max() <= enough:
                break
    return np.column_stack([straight, np.ones(len(straight))])


def _untilted(bent: np.ndarray, tilt_x: float, tilt_y: float) -> np.ndarray:
    """Normalised image points [N, 2] as they would be on a sensor that is not tilted (rad) against the lens."""
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt_x), np.sin(tilt_x)], [0, -np.sin(tilt_x), np.cos(tilt_x)]])
    about_y = np.array([[np.cos(tilt_y), 0, -np.sin(tilt_y)], [0, 1, 0], [np.sin(tilt_y), 0, np.cos(tilt_y)]])
    turn = about_y @ about_x
    tilt = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]) @ turn
    points = np.column_stack([bent, np.ones(len(bent))]) @ np.linalg.inv(tilt).T
    return points[:, :2] / points[:, 2:]
