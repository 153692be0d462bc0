"""Where the cameras are: pose from a ChArUco board that lies on the table, its middle being the world's origin."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.errors import DataError, UsageError

FEWEST_CORNERS = 8
MOVED = 2.0
"""Pixels that an image's corners are off all images' before it is left out: board or camera moved, or it is blurred."""
NEAREST, FARTHEST = 0.1, 5.0
"""Metres between which a camera can be from its board."""
WRONG_SIZE, DOUBTFUL_SIZE = 0.10, 0.04
"""Share by which depth may differ from the board's distance before the size of its squares is refused, and doubted."""


@dataclass(frozen=True)
class Board:
    """A printed ChArUco board: squares across and down, edges of squares and markers [m], OpenCV dictionary name."""

    columns: int = 7
    rows: int = 5
    square: float = 0.04
    marker: float = 0.03
    dictionary: str = "DICT_5X5_100"
    legacy: bool = False
    """The layout before OpenCV 4.6, another one where the rows are even: a marker in the first corner."""

    def make(self):
        """OpenCV's board. Raises `UsageError` for an unknown dictionary or impossible sizes."""
        import cv2

        if not self.dictionary.startswith("DICT_") or not hasattr(cv2.aruco, self.dictionary):
            raise UsageError(f"unknown marker dictionary {self.dictionary}", hint="as OpenCV names them: DICT_5X5_100")
        if not 0 < self.marker < self.square or min(self.columns, self.rows) < 3:
            raise UsageError(
                "a board needs 3 x 3 squares or more, with markers smaller than squares", hint="measure the print"
            )
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        if self.columns * self.rows // 2 > len(dictionary.bytesList):
            raise UsageError(
                f"{self.dictionary} has {len(dictionary.bytesList)} markers, a board of {self.columns} x {self.rows} "
                f"squares needs {self.columns * self.rows // 2}",
                hint="check --columns, --rows and --dictionary",
            )
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)
        board.setLegacyPattern(self.legacy)
        return board

    def corners(self) -> np.ndarray:
        """The inner corners [N, 3] (m) in the world, in OpenCV's order: origin in the board's middle, z up."""
        printed = np.asarray(self.make().getChessboardCorners(), np.float64)
        return (printed - [self.columns * self.square / 2, self.rows * self.square / 2, 0]) * [1, -1, -1]


@dataclass(frozen=True)
class Pose:
    """One camera by its board."""

    T_world_camera: np.ndarray
    """[4, 4]."""
    errors: np.ndarray
    """[image] mean px between corners found and projected; NaN where none is found."""
    used: np.ndarray
    """[image] bool: what the pose is from."""

    @property
    def error(self) -> float:
        """Mean reprojection error (px) of the images that were used."""
        return float(self.errors[self.used].mean())


def find_corners(images: Iterable[np.ndarray], board: Board) -> np.ndarray:
    """Pixels [image, corner, 2] of the board's inner corners in RGB images; NaN where one is not found."""
    import cv2

    printed = board.make()
    detector = cv2.aruco.CharucoDetector(printed)
    count = len(printed.getChessboardCorners())
    found = []
    for image in images:
        corners, ids, _, _ = detector.detectBoard(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
        pixels = np.full((count, 2), np.nan)
        if ids is not None:
            pixels[np.ravel(ids)] = np.reshape(corners, (-1, 2))
        found.append(pixels)
    return np.array(found).reshape(-1, count, 2)


def locate_camera(found: np.ndarray, K: np.ndarray, distortion: np.ndarray, board: Board, name: str) -> Pose:
    """The pose of a camera from corners [image, corner, 2] (px, NaN where not found) of a board that lies still.

    One pose is fitted to the corners of all images, but for images that disagree with most. Raises `DataError` naming
    the camera when too few corners are found or no pose fits, and when the board would be too near or too far.
    """
    seen = np.isfinite(found).all(-1)
    if seen.any(0).sum() < FEWEST_CORNERS:
        raise DataError(
            f"camera {name} sees {seen.any(0).sum()} corners of the board, {FEWEST_CORNERS} are needed",
            hint="check --columns, --rows and --dictionary, move the board closer, light it evenly",
        )
    rough = _fit(found, np.nanmedian, K, distortion, board, name)
    errors = _errors(found, rough, K, distortion, board)
    used = errors <= max(MOVED, 2 * np.nanmedian(errors))
    T = _fit(found[used], np.nanmean, K, distortion, board, name)
    distance = float(np.linalg.norm(T[:3, 3]))
    if not NEAREST <= distance <= FARTHEST:
        in_mm = f"; {board.square:g} mm would put it {distance / 1000:.2f} m away" if distance > FARTHEST else ""
        raise DataError(
            f"camera {name} would be {distance:.3g} m from a board with squares of {board.square:g} m{in_mm}",
            hint="give --square and --marker in metres, as 0.04 and 0.03",
        )
    return Pose(T, _errors(found, T, K, distortion, board), used)


def _fit(
    found: np.ndarray,
    average: Callable[..., np.ndarray],
    K: np.ndarray,
    distortion: np.ndarray,
    board: Board,
    name: str,
) -> np.ndarray:
    """`T_world_camera` [4, 4] that fits the average of each corner over images best."""
    import cv2

    known = np.isfinite(found).all(-1).any(0)
    pixels, points = average(found[:, known], axis=0), board.corners()[known]
    across = np.ptp((points - points.mean(0)) @ np.linalg.svd(points - points.mean(0))[2][1])
    ok = len(points) >= FEWEST_CORNERS and across > board.square / 2
    if ok:
        ok, rotation, translation = cv2.solvePnP(points, pixels, K, distortion, flags=cv2.SOLVEPNP_ITERATIVE)
    if not ok:
        raise DataError(
            f"camera {name}: no pose fits the {len(points)} corners seen of the board",
            hint="show more of the board, and hold it still; check K and distortion in cameras.json",
        )
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3], T_camera_world[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    return np.linalg.inv(T_camera_world)


def _errors(found: np.ndarray, T: np.ndarray, K: np.ndarray, distortion: np.ndarray, board: Board) -> np.ndarray:
    """Mean distance [image] (px) of corners found from where a camera at T sees them; NaN where none is found."""
    import cv2

    T_camera_world = np.linalg.inv(T)
    rotation = cv2.Rodrigues(T_camera_world[:3, :3])[0]
    projected, _ = cv2.projectPoints(board.corners(), rotation, T_camera_world[:3, 3], K, distortion)
    off = np.linalg.norm(found - projected[:, 0], axis=-1)
    seen = np.isfinite(off)
    return np.where(seen.any(1), np.where(seen, off, 0).sum(1) / np.maximum(seen.sum(1), 1), np.nan)


def depth_factor(found: np.ndarray, depths: Sequence[np.ndarray], scale: float, pose: Pose, board: Board) -> float:
    """How many times as far as its squares say the board is by depth images [H, W] in units of `scale` (m).

    Where corners [image, corner, 2] (px) were found, as `locate_camera` takes them; NaN where too few have depth.
    """
    T_camera_world = np.linalg.inv(pose.T_world_camera)
    expected = board.corners() @ T_camera_world[2, :3] + T_camera_world[2, 3]
    factors = []
    for pixels, depth in zip(found[pose.used], depths, strict=True):
        known = np.flatnonzero(np.isfinite(pixels).all(-1))
        columns, rows = np.rint(pixels[known]).astype(int).T
        inside = (columns >= 0) & (columns < depth.shape[1]) & (rows >= 0) & (rows < depth.shape[0])
        readings = depth[rows[inside], columns[inside]]
        factors.append((readings * scale / expected[known[inside]])[readings > 0])
    values = np.concatenate([np.zeros(0), *factors])
    return float(np.median(values)) if len(values) >= FEWEST_CORNERS else float("nan")


def check_size(factor: float, board: Board, name: str) -> str:
    """A warning, or none, by `depth_factor`. Raises `DataError` where squares or depth have another size than said."""
    off = abs(factor - 1)
    if not off > DOUBTFUL_SIZE:
        return ""
    message = f"camera {name}: by its depth images the board is {factor:.4g} times as far as its squares say"
    if off > WRONG_SIZE:
        raise DataError(
            f"{message}: are they {board.square:g} m?",
            hint=f"squares of {board.square * factor:.4g} m would fit; otherwise correct depth_scale in cameras.json",
        )
    return message
