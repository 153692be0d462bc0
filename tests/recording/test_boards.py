"""Boards in several places, grids of tags, lenses, and what is told of a board that is not found, on drawn images."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.board_trouble import why_not_found
from piegraph_cli.recording.boards import Board, find_corners
from piegraph_cli.recording.bundle import Bundle, _Problem
from piegraph_cli.recording.calibration import Sightings, places, solve
from piegraph_cli.recording.layout import read_cameras
from piegraph_cli.recording.locate import calibrate
from tests.commands.inside import piegraph, piegraph_json
from tests.recording.board_scene import BLANK, BOARD, HELD, RIG, TAGS, apart, picture, pose, record

POINTS = BOARD.corners()


def sightings(poses, noise=0.2, seen=None, images=2, seed=0) -> Sightings:
    """Corners that the rig sees of the board in some places; `seen` lists the cameras of each place."""
    rng = np.random.default_rng(seed)
    pixels = np.full((4, images * len(poses), len(POINTS), 2), np.nan)
    for c, camera in enumerate(RIG):
        for p, T in enumerate(poses):
            if seen is None or c in seen[p]:
                exact = camera.project(POINTS @ T[:3, :3].T + T[:3, 3])[0]
                for k in range(images):
                    pixels[c, images * p + k] = exact + rng.normal(0, noise, exact.shape)
    lens = np.array([c.K for c in RIG]), np.array([c.distortion for c in RIG])
    return Sightings([c.name for c in RIG], pixels, np.zeros(pixels.shape[1], int), *lens)


def held(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [np.eye(4)] + [
        pose(rng.normal(0, 0.3, 3), [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0, 0.15)]) for _ in range(count - 1)
    ]


def misses(found) -> np.ndarray:
    return np.array([apart(T, camera.T_world_camera) for T, camera in zip(found.T_world_camera, RIG, strict=True)])


def test_places_of_the_board_are_told_apart_and_make_poses_better():
    one, many = [], []
    for seed in range(3):
        where = held(6, seed)
        seen = sightings(where, seed=seed)
        found = solve(seen, BOARD)
        assert found.place.tolist() == np.repeat(np.arange(6), 2).tolist()
        for T, truth in zip(found.T_world_board, where, strict=True):
            assert apart(T, truth)[0] < 3
        many.append(misses(found).mean(0))
        one.append(misses(solve(replace(seen, pixels=seen.pixels[:, :2], sequence=seen.sequence[:2]), BOARD)).mean(0))
    assert (np.mean(many, 0) < 0.75 * np.mean(one, 0)).all()
    assert np.mean(many, 0)[0] < 1.2


def test_a_board_carried_from_camera_to_camera_joins_them():
    found = solve(sightings(held(5), seen=[(0,), (0, 1), (1, 2), (2, 3), (3,)]), BOARD)
    assert misses(found).max(0)[0] < 4
    with pytest.raises(DataError, match="cam2 and cam3 shared no place of the board with cam0 and cam1") as refused:
        solve(sightings(held(4), seen=[(0,), (0, 1), (2,), (2, 3)]), BOARD)
    assert "cam2" in refused.value.hint


def test_two_sequences_are_two_places_even_where_the_board_looks_still():
    seen = sightings(held(1), images=4)
    assert places(seen).tolist() == [0, 0, 0, 0]
    assert places(replace(seen, sequence=np.array([0, 0, 1, 1]))).tolist() == [0, 0, 1, 1]
    seen.pixels[:, 1] = np.nan
    assert places(seen).tolist() == [0, -1, 0, 0]


def test_cameras_that_are_not_of_one_time_are_refused():
    seen = sightings(held(4), images=1)
    shifted = seen.pixels.copy()
    shifted[3] = np.roll(shifted[3], 1, axis=0)
    with pytest.raises(DataError, match="camera cam3: its images fit no pose with those of the others"):
        solve(replace(seen, pixels=shifted), BOARD)


def test_derivatives_are_those_of_the_residuals():
    seen, rng = sightings(held(3), images=1), np.random.default_rng(0)
    start = Bundle(np.array([c.T_world_camera for c in RIG]), np.array(held(3)), np.arange(3), seen.K, seen.distortion)
    problem = _Problem(start, seen.pixels, POINTS, seen.seen.any(-1), lenses=True)
    x = rng.normal(0, 0.05, problem.size)
    steps = 1e-6 * np.eye(problem.size)
    measured = np.stack([(problem.residuals(x + e) - problem.residuals(x - e)) / 2e-6 for e in steps], 1)
    np.testing.assert_allclose(problem.jacobian(x), measured, atol=1e-5 * np.abs(measured).max())


def test_lenses_are_found_where_the_board_is_tilted_and_refused_where_it_is_not():
    seen = sightings(held(10), images=1)
    wrong = replace(seen, K=seen.K * [[1.06, 1, 1], [1, 1.06, 1], [1, 1, 1]], distortion=0 * seen.distortion)
    assert misses(solve(wrong, BOARD)).min(0)[0] > 20
    found = solve(wrong, BOARD, lenses=True)
    np.testing.assert_allclose(found.K[:, [0, 1], [0, 1]], seen.K[:, [0, 1], [0, 1]], rtol=0.005)
    assert max(found.error(c) for c in range(4)) < 0.3
    assert misses(found).max(0)[0] < 3
    flat = [pose([0, 0, a], [0.1 * a - 0.05, 0, 0]) for a in np.linspace(0, 1, 6)]
    with pytest.raises(DataError, match=r"camera cam0: these images leave its focal length open by \d"):
        solve(sightings(flat), BOARD, lenses=True)
    with pytest.raises(DataError, match="camera cam0 sees 2 places of the board, 3 are needed"):
        solve(sightings(held(2)), BOARD, lenses=True)


@pytest.mark.parametrize("board", [TAGS, replace(TAGS, from_below=True, turns=2, border=2)], ids=["opencv", "kalibr"])
def test_grids_of_tags_are_found_in_the_layout_they_are_printed_in(tmp_path, board):
    images = [[picture(RIG[c], board, T) for T in HELD[:2]] for c in (0, 2)]
    record(tmp_path, images, (0, 2))
    to = ("--board", "grid", "--columns", 5, "--rows", 4, "--square", 0.078, "--marker", 0.06)
    told = piegraph_json("calibrate", tmp_path, *to)
    assert told["places"] == 2
    for c, camera in zip((0, 2), read_cameras(tmp_path / "board"), strict=True):
        assert told["cameras"][camera.name]["error_px"] < 0.6
        millimetres, degrees = apart(camera.T_world_camera, RIG[c].T_world_camera)
        assert millimetres < 3
        assert degrees < 0.3
    assert calibrate(tmp_path, (), replace(board, from_below=False, turns=0, border=1)).board == board


@pytest.fixture(scope="module")
def flat():
    """What four cameras see of the board on the table."""
    return [picture(camera, BOARD, np.eye(4)) for camera in RIG]


def test_several_sequences_are_fitted_together_kept_out_of_runs_and_drawn(tmp_path, flat):
    up = [picture(RIG[c], BOARD, HELD[1]) for c in (0, 1)]
    record(tmp_path, [[flat[0]], [flat[1]]], (0, 1), "b1")
    record(tmp_path, [[up[0]], [up[1]]], (0, 1), "b2")
    (tmp_path / "cameras.json").write_text(
        (tmp_path / "cameras.json")
        .read_text()
        .replace('"version": 1,', '"version": 1, "T_world_robot": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]],')
    )
    done = piegraph("calibrate", tmp_path, "--sequence", "b1,b2", "--square", 0.06, "--marker", 0.045)
    assert "the board lay in 2 places, which were fitted together" in done.stdout
    assert "the middle of the board as it lies in image b1/000000 of cam0" in done.stdout
    assert "sequences b1, b2 show the board: runs leave them out" in done.stdout
    assert "T_world_robot is taken out of cameras.json" in done.stdout
    assert f"axes and corners: {tmp_path / 'calibration.png'}" in done.stdout
    file = json.loads((tmp_path / "cameras.json").read_text())
    assert file["calibration_sequence"] == ["b1", "b2"]
    assert "T_world_robot" not in file
    kept = json.loads((tmp_path / "calibration.json").read_text())
    assert kept["cameras"]["cam0"]["frames_px"].keys() == {"b1/000000", "b2/000000"}
    drawn = cv2.cvtColor(cv2.imread(str(tmp_path / "calibration.png")), cv2.COLOR_BGR2RGB)
    assert drawn.shape == (480, 1280, 3)
    x, y = np.rint(RIG[0].project(np.array([[0.0, 0, 0.05]]))[0][0]).astype(int)
    assert drawn[y, x, 2] > 200 > drawn[y, x, 0] + 50, "the z axis is blue"
    done = piegraph("ingest", "--recording", tmp_path, "--run", tmp_path / "run", check=3)
    assert "every sequence is left out" in done.stderr


@pytest.mark.parametrize(
    ("spoil", "options", "message"),
    [
        (lambda image: BLANK, {}, "no marker is seen: show the board to this camera"),
        (lambda image: image[:, ::-1], {}, "the images are mirrored"),
        (lambda image: cv2.GaussianBlur(image, (0, 0), 9.0), {}, "the images are blurred"),
        (
            lambda image: image,
            {"dictionary": "DICT_4X4_50"},
            "the markers are of DICT_5X5_50: --dictionary DICT_5X5_50",
        ),
        (lambda image: image, {"columns": 5, "rows": 7}, "a board of 7 columns: --columns 7 --rows 5"),
        (lambda image: image, {"columns": 9, "rows": 6}, "a board of 7 columns: --columns 7, and 5 rows or more"),
    ],
)
def test_a_board_that_is_not_found_is_told_with_camera_images_and_the_reason_that_was_tried(
    tmp_path, flat, spoil, options, message
):
    record(tmp_path, [[np.ascontiguousarray(spoil(flat[0]))] * 2], (0,))
    before = (tmp_path / "cameras.json").read_text()
    given = {"square": 0.06, "marker": 0.045} | options
    words = [word for name, value in given.items() for word in (f"--{name}", value)]
    done = piegraph("calibrate", tmp_path, *words, check=3)
    assert "camera cam0 sees " in done.stderr
    assert "in 2 images from 000000 on, 8 are needed" in done.stderr
    assert message in done.stderr
    assert (tmp_path / "cameras.json").read_text() == before
    assert not (tmp_path / "calibration.png").exists()


def test_a_board_seen_by_one_camera_alone_names_the_other(tmp_path, flat):
    record(tmp_path, [[flat[0]], [BLANK]], (0, 1))
    done = piegraph("calibrate", tmp_path, "--square", 0.06, "--marker", 0.045, check=3)
    assert "camera cam1 sees 0 corners" in done.stderr


def test_too_many_or_too_few_rows_are_said(tmp_path, flat):
    record(tmp_path, [[flat[0]]], (0,))
    more = piegraph_json("calibrate", tmp_path, "--rows", 7, "--square", 0.06, "--marker", 0.045)
    assert "2 rows of corners are seen by no camera" in more["notes"][0]
    fewer = piegraph_json("calibrate", tmp_path, "--rows", 3, "--square", 0.06, "--marker", 0.045)
    assert "marker 16 is seen, and 7 x 3 has 10" in fewer["cameras"]["cam0"]["warnings"][0]
    right = piegraph_json("calibrate", tmp_path, "--square", 0.06, "--marker", 0.045)
    assert right["notes"] == right["cameras"]["cam0"]["warnings"] == []


def test_a_wrong_lens_is_refused(tmp_path, flat):
    record(tmp_path, [[image] for image in flat[:2]], (0, 1))
    file = json.loads((tmp_path / "cameras.json").read_text())
    file["cameras"]["cam1"]["K"][0][0] *= 1.5
    (tmp_path / "cameras.json").write_text(json.dumps(file))
    done = piegraph("calibrate", tmp_path, "--square", 0.06, "--marker", 0.045, check=3)
    assert "camera cam1: " in done.stderr
    assert "check K and distortion in cameras.json" in done.stderr


def test_images_go_together_by_time_where_all_cameras_have_it(tmp_path, flat):
    up = [picture(RIG[c], BOARD, HELD[1]) for c in (0, 1)]
    record(tmp_path, [[flat[0], up[0]], [flat[1], flat[1], up[1]]], (0, 1))
    for name, times in (("cam0", (1.0, 2.0)), ("cam1", (0.5, 1.01, 2.02))):
        (tmp_path / "board" / name / "timestamps.txt").write_text("".join(f"{t}\n" for t in times))
    found = calibrate(tmp_path, (), BOARD)
    assert found.places == 2
    assert max(one.error for one in found.cameras) < 0.3
    assert list(found.cameras[1].frames) == ["000001", "000002"]


def test_corners_of_a_grid_are_those_of_its_tags():
    grid = Board(3, 2, 0.05, 0.04, "DICT_APRILTAG_36h11", kind="grid")
    corners = grid.corners()
    assert corners.shape == (24, 3)
    np.testing.assert_allclose(corners[:4, :2], [[-0.07, 0.045], [-0.03, 0.045], [-0.03, 0.005], [-0.07, 0.005]])
    below = replace(grid, from_below=True).corners()
    np.testing.assert_allclose(below[:12], corners[12:])
    np.testing.assert_allclose(replace(grid, turns=1).corners()[:4], corners[[1, 2, 3, 0]])
    assert np.isnan(find_corners([BLANK], grid)).all()


@pytest.mark.parametrize(
    "name", ["DICT_7X7_1000", "DICT_APRILTAG_36h10", "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12"]
)
def test_markers_of_every_dictionary_are_named(name):
    printed = replace(Board(), dictionary=name).make().generateImage((560, 400), marginSize=20)
    image = np.full((480, 640), 130, np.uint8)
    image[40:440, 40:600] = printed // 2 + 50
    noisy = image + np.random.default_rng(0).normal(0, 4, image.shape)
    picture = np.repeat(noisy.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)
    expected = name.replace("_1000", "_50")
    assert why_not_found([picture], Board()) == f"the markers are of {expected}: --dictionary {expected}"
    assert "no marker is seen" in why_not_found([np.full_like(picture, 90)], Board())
