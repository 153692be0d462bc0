"""Printed boards whose place a camera can tell, ChArUco boards and grids of AprilTags, and their corners in images."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from piegraph_cli.errors import UsageError

BoardKind = Literal["charuco", "grid"]
WINDOWS = {1: 9.0, 2: 8.0}
"""How many times a tag is as wide as half the window in which its corners are refined, by the bits of its border."""


@dataclass(frozen=True)
class Board:
    """A printed board: squares (of a grid: tags) across and down, lengths [m], OpenCV's name of the dictionary."""

    columns: int = 7
    rows: int = 5
    square: float = 0.04
    """Edge of a square; of a grid from a tag's edge to the same edge of the next."""
    marker: float = 0.03
    """Edge of a marker, its black border included."""
    dictionary: str = "DICT_5X5_100"
    legacy: bool = False
    """The layout before OpenCV 4.6, another one where the rows are even: a marker in the first corner."""
    kind: BoardKind = "charuco"
    from_below: bool = False
    """Of a grid: tags are counted from the bottom row, as Kalibr prints them, not from the top."""
    turns: int = 0
    """Of a grid: by how many quarters its tags are turned against OpenCV's."""
    border: int = 1
    """Of a grid: how many bits wide a tag's black border is; Kalibr prints 2."""

    def make(self):
        """OpenCV's board. Raises `UsageError` for an unknown dictionary or impossible sizes."""
        import cv2

        fewest = 3 if self.kind == "charuco" else 1
        if not 0 < self.marker < self.square or min(self.columns, self.rows) < fewest:
            raise UsageError(
                "a board needs 3 x 3 squares or more, with markers smaller than squares"
                if self.kind == "charuco"
                else "a grid needs a tag or more, with --marker, its edge, smaller than --square, from tag to tag",
                hint="measure the print",
            )
        dictionary, size = self.codes(), (self.columns, self.rows)
        if self.markers > len(dictionary.bytesList):
            of = "squares" if self.kind == "charuco" else "tags"
            raise UsageError(
                f"{self.dictionary} has {len(dictionary.bytesList)} markers, a board of {self.columns} x {self.rows} "
                f"{of} needs {self.markers}",
                hint="check --columns, --rows and --dictionary",
            )
        if self.kind == "grid":
            return cv2.aruco.GridBoard(size, self.marker, self.square - self.marker, dictionary)
        board = cv2.aruco.CharucoBoard(size, self.square, self.marker, dictionary)
        board.setLegacyPattern(self.legacy)
        return board

    def codes(self):
        """OpenCV's dictionary. Raises `UsageError` for an unknown one."""
        import cv2

        if not self.dictionary.startswith("DICT_") or not hasattr(cv2.aruco, self.dictionary):
            hint = "as OpenCV names them: DICT_5X5_100, DICT_APRILTAG_36h11"
            raise UsageError(f"unknown marker dictionary {self.dictionary}", hint=hint)
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def markers(self) -> int:
        """How many it has, numbered from 0."""
        squares = self.columns * self.rows
        if self.kind == "grid":
            return squares
        # the old layout begins with a marker where rows are odd and even alike
        return squares // 2

    def corners(self) -> np.ndarray:
        """What is found of it [N, 3] (m): a ChArUco board's inner corners in OpenCV's order, a grid's tags with 4 corners.

        Origin in the board's middle, x right and y up on the print, z out of it.
        """
        if self.kind == "charuco":
            printed = np.asarray(self.make().getChessboardCorners(), np.float64)
            return (printed - [self.columns * self.square / 2, self.rows * self.square / 2, 0]) * [1, -1, -1]
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        row = self.rows - 1 - row if self.from_below else row
        tag = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[(np.arange(4) + self.turns) % 4] * self.marker
        printed = np.stack([column, row], -1)[:, None] * self.square + tag
        size = (np.array([self.columns, self.rows]) - 1) * self.square + self.marker
        return np.pad(((printed - size / 2) * [1, -1]).reshape(-1, 2), ((0, 0), (0, 1)))

    def layouts(self) -> list["Board"]:
        """This board, and the other ones that are printed under the same numbers."""
        if self.kind == "grid":
            kinds = product((1, 2), (False, True), range(4))
            return [replace(self, border=border, from_below=below, turns=turns) for border, below, turns in kinds]
        # the layouts of odd rows are the same
        return [self] if self.rows % 2 else [self, replace(self, legacy=True)]


def find_corners(images: Iterable[np.ndarray], board: Board) -> np.ndarray:
    """Pixels [image, corner, 2] of the board's corners in RGB images; NaN where one is not found."""
    import cv2

    count = len(board.corners())
    charuco = cv2.aruco.CharucoDetector(board.make()) if board.kind == "charuco" else None
    found = []
    for image in images:
        pixels = np.full((count, 2), np.nan)
        if charuco is None:
            for number, corners in find_markers(image, board).items():
                if number < board.markers:
                    pixels[4 * number : 4 * number + 4] = corners
        else:
            corners, ids, _, _ = charuco.detectBoard(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
            if ids is not None:
                pixels[np.ravel(ids)] = np.reshape(corners, (-1, 2))
        found.append(pixels)
    return np.array(found).reshape(-1, count, 2)


def find_markers(image: np.ndarray, board: Board) -> dict[int, np.ndarray]:
    """The four corners [4, 2] (px) of markers like the board's in an RGB image, by number; of none that is there twice."""
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = board.border
    detector = cv2.aruco.ArucoDetector(board.codes(), parameters)
    grey, found = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dict[int, np.ndarray]()
    # tags with black squares between them hang together at their corners: a light blur parts some of these
    for looked in (grey, cv2.GaussianBlur(grey, (0, 0), 1.0)):
        corners, ids, _ = detector.detectMarkers(looked)
        numbers: list[int] = [] if ids is None else np.ravel(ids).astype(int).tolist()
        found |= {n: c for n, c in zip(numbers, corners, strict=True) if numbers.count(n) == 1 and n not in found}
    return {number: _refined(grey, np.reshape(c, (4, 2)), board.border) for number, c in found.items()}


def _refined(grey: np.ndarray, corners: np.ndarray, border: int) -> np.ndarray:
    """Corners [4, 2] (px) to parts of a pixel, looking no further than the tag's border is wide."""
    import cv2

    side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
    reach = int(np.clip(round(side / WINDOWS[border]), 2, 8))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 0.01)
    start = np.ascontiguousarray(corners.reshape(-1, 1, 2), np.float32)
    return cv2.cornerSubPix(grey, start, (reach, reach), (-1, -1), stop)[:, 0]
