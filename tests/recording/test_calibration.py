"""Calibration: a board drawn where a known camera would see it gives that camera back."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.boards import Board, find_corners
from piegraph_cli.recording.calibration import Sightings, Solution, solve
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.layout import read_cameras, write_cameras, write_frame
from piegraph_cli.recording.locate import calibrate
from tests.cli import piegraph_json

BOARD = Board(square=0.06, marker=0.045)
EVEN = Board(8, 6, 0.04, 0.03, "DICT_4X4_50")
RIG = camera_rig(848, 636)


def picture(camera: Camera, board: Board, shift=(0.0, 0.0), scale: int = 2000) -> np.ndarray:
    """The board's print on the table, moved by `shift` (m), as the camera sees it, RGB."""
    size = (round(board.columns * board.square * scale), round(board.rows * board.square * scale))
    printed = board.make().generateImage(size)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns.ravel(), rows.ravel()], 1)) @ camera.T_world_camera[:3, :3].T
    origin = camera.T_world_camera[:3, 3]
    hit = origin + rays * (-origin[2] / rays[:, 2])[:, None]
    half = np.array([board.columns, board.rows]) * board.square / 2
    place = (((hit[:, :2] - shift) * [1, -1] + half) * scale - 0.5).astype(np.float32)
    place = place.reshape(camera.height, camera.width, 2)
    image = cv2.remap(printed, place[..., 0], place[..., 1], cv2.INTER_AREA, borderValue=128)
    return cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0.6), cv2.COLOR_GRAY2RGB)


def table_depth(camera: Camera, factor: float = 1.0) -> np.ndarray:
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns.ravel(), rows.ravel()], 1)) @ camera.T_world_camera[:3, :3].T
    z = -camera.T_world_camera[2, 3] / rays[:, 2]
    return (z * 1000 * factor).round().astype(np.uint16).reshape(rows.shape)


def apart(T: np.ndarray, camera: Camera) -> tuple[float, float]:
    """Metres and degrees between a pose and the camera's."""
    turn = T[:3, :3].T @ camera.T_world_camera[:3, :3]
    shift = np.linalg.norm(T[:3, 3] - camera.T_world_camera[:3, 3])
    return float(shift), float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def located(found: np.ndarray, camera: Camera, board: Board = BOARD) -> Solution:
    """One camera by its corners [image, corner, 2]."""
    lens = camera.K[None], camera.distortion[None]
    return solve(Sightings([camera.name], found[None], np.zeros(len(found), int), *lens), board)


def recording(folder, board=BOARD, shifts=((0.0, 0.0),), depth=1.0, cameras=(0, 2)):
    """A recording of which one sequence shows the board, once for each of `shifts`; its cameras are not located."""
    rig = [RIG[k] for k in cameras]
    for camera in rig:
        for f, shift in enumerate(shifts):
            image = picture(camera, board, shift)
            write_frame(folder / "board", camera, f, image, table_depth(camera, depth), 95)
    write_cameras(folder, [replace(camera, T_world_camera=np.eye(4)) for camera in rig])
    return folder


@pytest.mark.parametrize("index", [0, 2])
def test_the_camera_that_saw_the_board_is_found(index):
    camera = RIG[index]
    pose = located(find_corners([picture(camera, BOARD)], BOARD), camera)
    assert pose.error(0) < 0.5
    metres, degrees = apart(pose.T_world_camera[0], camera)
    assert metres < 0.006
    assert degrees < 0.4


def test_no_board_and_a_wrong_board_are_refused():
    camera = camera_rig()[0]
    blank = np.full((camera.height, camera.width, 3), 128, np.uint8)
    with pytest.raises(DataError, match=f"camera {camera.name} sees 0 corners"):
        located(find_corners([blank], Board()), camera, Board())
    for wrong, message in (
        ({"dictionary": "DICT_WRONG"}, "DICT_WRONG"),
        ({"dictionary": "ArucoDetector"}, "unknown marker dictionary"),
        ({"marker": 0.05}, "markers smaller"),
        ({"columns": 20, "rows": 20}, "has 100 markers, a board of 20 x 20 squares needs 200"),
        ({"columns": 20, "rows": 20, "kind": "grid"}, "has 100 markers, a board of 20 x 20 tags needs 400"),
        ({"marker": 0.05, "kind": "grid"}, "its edge, smaller than --square, from tag to tag"),
    ):
        with pytest.raises(UsageError, match=message):
            Board(**wrong).make()


def projected(camera: Camera, images: int, noise: float, seed: int = 0) -> np.ndarray:
    pixels = camera.project(BOARD.corners())[0]
    return pixels + np.random.default_rng(seed).normal(0, noise, (images, *pixels.shape))


def test_more_images_make_the_pose_better_and_odd_ones_are_left_out():
    camera = RIG[0]
    off = []
    for seed in range(6):
        found = projected(camera, 10, 0.7, seed)
        poses = [located(f, camera) for f in (found[:1], found)]
        assert poses[1].used.all()
        off.append([apart(pose.T_world_camera[0], camera)[0] for pose in poses])
    one, ten = np.mean(off, axis=0)
    assert ten < 0.5 * one
    found[7:9] += np.random.default_rng(9).normal(0, 25, found[7:9].shape)
    found[3] = np.nan
    pose = located(found, camera)
    assert np.flatnonzero(~pose.used[0]).tolist() == [3, 7, 8]
    assert np.isnan(pose.errors[0, 3])
    assert pose.error(0) < 1.5
    assert apart(pose.T_world_camera[0], camera)[0] < 0.005


def test_corners_in_one_row_are_too_few():
    camera, board = RIG[0], Board(12, 5, 0.03, 0.02)
    found = camera.project(board.corners())[0][None]
    found[:, 11:] = np.nan
    with pytest.raises(DataError, match="no pose fits the 11 corners"):
        located(found, camera, board)


def test_calibrating_fills_in_the_poses_and_notes_the_sequence(tmp_path):
    folder = recording(tmp_path / "rec", shifts=[(0.0, 0.0)] * 3 + [(0.05, 0.02)])
    told = piegraph_json("calibrate", folder, "--square", "0.06", "--marker", "0.045")
    assert (told["sequence"], told["legacy_board"]) == ("board", False)
    for k, camera in zip((0, 2), read_cameras(folder / "board"), strict=True):
        metres, degrees = apart(camera.T_world_camera, RIG[k])
        assert metres < 0.006
        assert degrees < 0.4
        one = told["cameras"][camera.name]
        assert list(one["frames_px"]) == ["000000", "000001", "000002", "000003"]
        assert max(one["frames_px"].values()) < 0.5
        assert one["warnings"] == []
    assert told["places"] == 2
    assert told["origin"] == "000000 of cam0"
    assert json.loads((folder / "cameras.json").read_text())["calibration_sequence"] == "board"


@pytest.mark.parametrize("legacy", [False, True])
def test_both_layouts_of_a_board_with_even_rows_are_found(tmp_path, legacy):
    folder = recording(tmp_path / "rec", replace(EVEN, legacy=legacy))
    found = calibrate(folder, (), EVEN)
    assert found.board.legacy is legacy
    for k, camera in zip((0, 2), read_cameras(folder / "board"), strict=True):
        assert apart(camera.T_world_camera, RIG[k])[0] < 0.01


def test_squares_in_millimetres_are_refused_and_nothing_is_written(tmp_path):
    folder = recording(tmp_path / "rec", cameras=(0,))
    before = (folder / "cameras.json").read_text()
    with pytest.raises(DataError, match=r"would be \d+ m from a board .* 60 mm would put it 0.\d+ m away"):
        calibrate(folder, (), replace(BOARD, square=60, marker=45))
    with pytest.raises(DataError, match=r"would be 0.0\d+ m from a board"):
        calibrate(folder, (), replace(BOARD, square=0.006, marker=0.0045))
    assert (folder / "cameras.json").read_text() == before


def test_squares_that_depth_contradicts_are_refused_or_said(tmp_path):
    folder = recording(tmp_path / "rec", cameras=(0,), depth=1.2)
    with pytest.raises(DataError, match=r"1\.2\d* times as far .* are they 0.06 m") as refused:
        calibrate(folder, (), BOARD)
    assert "squares of 0.07" in refused.value.hint
    folder = recording(tmp_path / "rec2", cameras=(0,), depth=1.06)
    assert "1.06" in calibrate(folder, (), BOARD).cameras[0].warnings[0]
    folder = recording(tmp_path / "rec3", cameras=(0,), depth=1.02)
    assert not calibrate(folder, (), BOARD).cameras[0].warnings


@pytest.mark.parametrize("breaks", ["none", "zero", "not an image"])
def test_depth_is_not_needed(tmp_path, breaks):
    folder = recording(tmp_path / "rec", cameras=(0,))
    for path in (folder / "board").rglob("depth/*.png"):
        if breaks == "none":
            path.unlink()
            path.parent.rmdir()
        elif breaks == "zero":
            cv2.imwrite(str(path), np.zeros((636, 848), np.uint16))
        else:
            path.write_bytes(b"no")
    assert not calibrate(folder, (), BOARD).cameras[0].warnings


@pytest.mark.parametrize(("marker", "refused"), [(0.03, True), (0.056, True), (0.042, False), (0.048, False)])
def test_markers_of_another_size_than_was_said_are_refused(tmp_path, marker, refused):
    folder = recording(tmp_path / "rec", cameras=(0,))
    said = replace(BOARD, marker=marker)
    if not refused:
        calibrate(folder, (), said)
        return
    with pytest.raises(DataError, match=r"markers are 0\.04\d* m large beside squares of 0\.06 m"):
        calibrate(folder, (), said)
