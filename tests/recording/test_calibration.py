"""Calibration: a board drawn where a known camera would see it gives that camera back."""

import numpy as np
import pytest

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.calibration import Board, locate_camera
from piegraph_cli.recording.camera import Camera


def picture(camera: Camera, board: Board, scale: int = 2000) -> np.ndarray:
    """The board's print on the table as the camera sees it, RGB."""
    import cv2

    size = (round(board.columns * board.square * scale), round(board.rows * board.square * scale))
    printed = board.make().generateImage(size)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns.ravel(), rows.ravel()], 1)) @ camera.T_world_camera[:3, :3].T
    origin = camera.T_world_camera[:3, 3]
    hit = origin + rays * (-origin[2] / rays[:, 2])[:, None]
    half = np.array([board.columns, board.rows]) * board.square / 2
    place = ((hit[:, :2] * [1, -1] + half) * scale - 0.5).astype(np.float32).reshape(camera.height, camera.width, 2)
    image = cv2.remap(printed, place[..., 0], place[..., 1], cv2.INTER_AREA, borderValue=128)
    return cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0.6), cv2.COLOR_GRAY2RGB)


@pytest.mark.parametrize("index", [0, 2])
def test_the_camera_that_saw_the_board_is_found(index):
    camera = camera_rig(848, 636)[index]
    board = Board(square=0.06, marker=0.045)
    T, error = locate_camera([picture(camera, board)], camera.K, camera.distortion, board, camera.name)
    assert error < 0.5
    np.testing.assert_allclose(T[:3, 3], camera.T_world_camera[:3, 3], atol=0.004)
    assert np.degrees(np.arccos((np.trace(T[:3, :3].T @ camera.T_world_camera[:3, :3]) - 1) / 2)) < 0.4


def test_no_board_and_a_wrong_board_are_refused():
    camera = camera_rig()[0]
    blank = np.full((camera.height, camera.width, 3), 128, np.uint8)
    with pytest.raises(DataError, match=f"camera {camera.name} sees 0 corners"):
        locate_camera([blank], camera.K, camera.distortion, Board(), camera.name)
    with pytest.raises(UsageError, match="DICT_WRONG"):
        Board(dictionary="DICT_WRONG").make()
    with pytest.raises(UsageError, match="markers smaller"):
        Board(marker=0.05).make()
