"""Pictures of printed boards, held anywhere, as cameras with known poses see them; and recordings of such pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.recording.boards import Board
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.layout import write_cameras, write_frame

RIG = camera_rig(640, 480)
BOARD = Board(7, 5, 0.06, 0.045)
TAGS = Board(5, 4, 0.078, 0.06, "DICT_APRILTAG_36h11", kind="grid")
SCALE = 2000
"""Pixels of a print per metre."""


def pose(vector, shift) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), shift
    return T


HELD = [
    np.eye(4),
    *(pose(v, s) for v, s in (((0.3, 0.1, 0.4), (0.05, 0, 0.08)), ((-0.2, 0.3, -0.7), (-0.06, 0.04, 0.12)))),
]
"""Where a board may be: on the table first."""


def printed(board: Board) -> np.ndarray:
    """What is on the paper, grey, `SCALE` pixels a metre, the board in the middle."""
    if board.kind == "charuco":
        return board.make().generateImage(
            (round(board.columns * board.square * SCALE), round(board.rows * board.square * SCALE))
        )
    tag, pitch = round(board.marker * SCALE), round(board.square * SCALE)
    gap = pitch - tag
    paper = np.full((board.rows * pitch + gap, board.columns * pitch + gap), 255, np.uint8)
    for row in range(board.rows):
        for column in range(board.columns):
            number = (board.rows - 1 - row if board.from_below else row) * board.columns + column
            drawn = np.rot90(board.codes().generateImageMarker(number, tag, borderBits=board.border), -board.turns)
            y, x = gap + row * pitch, gap + column * pitch
            paper[y : y + tag, x : x + tag] = drawn
    if board.from_below:  # as Kalibr prints them
        for row in range(board.rows + 1):
            for column in range(board.columns + 1):
                paper[row * pitch : row * pitch + gap, column * pitch : column * pitch + gap] = 0
    return paper


def picture(camera: Camera, board: Board, T_world_board: np.ndarray) -> np.ndarray:
    """The print as the camera sees it, RGB."""
    paper, T = printed(board), np.linalg.inv(T_world_board) @ camera.T_world_camera
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns.ravel(), rows.ravel()], 1)) @ T[:3, :3].T
    hit = T[:3, 3] + rays * (-T[2, 3] / rays[:, 2])[:, None]
    place = (hit[:, :2] * [1, -1] * SCALE + np.array(paper.shape[::-1]) / 2 - 0.5).astype(np.float32)
    place = place.reshape(camera.height, camera.width, 2)
    image = cv2.remap(paper, place[..., 0], place[..., 1], cv2.INTER_AREA, borderValue=128)
    return cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0.6), cv2.COLOR_GRAY2RGB)


BLANK = np.full((480, 640, 3), 128, np.uint8)


def record(
    folder: Path,
    images: Sequence[Sequence[np.ndarray]],
    cameras: Sequence[int],
    sequence: str = "board",
    posed: bool = False,
) -> Path:
    """A recording with images [camera][frame] and flat depth of no meaning; cameras have no pose unless `posed`."""
    rig = [RIG[k] for k in cameras]
    for camera, of in zip(rig, images, strict=True):
        for frame, image in enumerate(of):
            write_frame(folder / sequence, camera, frame, image, np.zeros((480, 640), np.uint16), 95)
    if not (folder / "cameras.json").exists():
        write_cameras(folder, [c if posed else replace(c, T_world_camera=np.eye(4)) for c in rig])
    return folder


def apart(T: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees between two poses."""
    turn = Rotation.from_matrix(T[:3, :3].T @ truth[:3, :3])
    return 1000 * float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(np.degrees(turn.magnitude()))
