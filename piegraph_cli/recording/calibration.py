"""Where the cameras are: pose from a ChArUco board that lies on the table, its middle being the world's origin."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from piegraph_cli.errors import DataError, UsageError

FEWEST_CORNERS = 8


@dataclass(frozen=True)
class Board:
    """A printed ChArUco board: squares across and down, edges of squares and markers [m], OpenCV dictionary name."""

    columns: int = 7
    rows: int = 5
    square: float = 0.04
    marker: float = 0.03
    dictionary: str = "DICT_5X5_100"

    def make(self):
        """OpenCV's board. Raises `UsageError` for an unknown dictionary or impossible sizes."""
        import cv2

        if not hasattr(cv2.aruco, self.dictionary):
            raise UsageError(f"unknown marker dictionary {self.dictionary}", hint="as OpenCV names them: DICT_5X5_100")
        if not 0 < self.marker < self.square or min(self.columns, self.rows) < 3:
            raise UsageError(
                "a board needs 3 x 3 squares or more, with markers smaller than squares", hint="measure the print"
            )
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Board points [N, 3] (m, origin in a corner, y down the print, z into the table) in the world: middle, z up."""
        return (points - [self.columns * self.square / 2, self.rows * self.square / 2, 0]) * [1, -1, -1]


def locate_camera(
    images: Iterable[np.ndarray], K: np.ndarray, distortion: np.ndarray, board: Board, name: str
) -> tuple[np.ndarray, float]:
    """`T_world_camera` [4, 4] and the reprojection error (px) of a camera that sees the board, still, in RGB images.

    Corners are averaged over the images. Raises `DataError` naming the camera when too few are found.
    """
    import cv2

    printed = board.make()
    detector = cv2.aruco.CharucoDetector(printed)
    seen: dict[int, list[np.ndarray]] = {}
    for image in images:
        corners, ids, _, _ = detector.detectBoard(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
        for corner, index in zip(corners if ids is not None else [], ids if ids is not None else [], strict=True):
            seen.setdefault(int(np.ravel(index)[0]), []).append(np.ravel(corner))
    if len(seen) < FEWEST_CORNERS:
        raise DataError(
            f"camera {name} sees {len(seen)} corners of the board, {FEWEST_CORNERS} are needed",
            hint="check --columns, --rows and --dictionary, move the board closer, light it evenly",
        )
    indices = sorted(seen)
    pixels = np.array([np.mean(seen[i], axis=0) for i in indices], np.float64)
    points = board.to_world(np.asarray(printed.getChessboardCorners(), np.float64)[indices])
    ok, rotation, translation = cv2.solvePnP(points, pixels, K, distortion, flags=cv2.SOLVEPNP_ITERATIVE)
    if not ok:
        raise DataError(
            f"camera {name}: no pose fits the board's corners", hint="check K and distortion in cameras.json"
        )
    projected, _ = cv2.projectPoints(points, rotation, translation, K, distortion)
    error = float(np.linalg.norm(projected[:, 0] - pixels, axis=-1).mean())
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3], T_camera_world[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    return np.linalg.inv(T_camera_world), error
