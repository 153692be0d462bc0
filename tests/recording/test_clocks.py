"""Clocks of cameras, told by what moves in their images: made-up scenes in which a disc wanders over a speckled ground."""

import cv2
import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.clocks import changes, check_clocks, compare_clocks, moving
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.sequence import read_sequence
from tests.stages.make_recording import make_cameras

FRAMES, STEP = 36, 0.2
TIMES = np.arange(FRAMES) * STEP
VIEWS = [
    np.array([[52.0, 4, 30], [3, 30, 28]]),
    np.array([[-40.0, 20, 60], [12, 34, 20]]),
    np.array([[30.0, -35, 55], [24, 18, 18]]),
]


def path(times):
    """Where the disc is [T, 2], in 0..1: it comes, wanders, rests and goes."""
    knots = np.array([0, 1, 1.6, 2.3, 3.1, 3.8, 4.4, 5.2, 6, 7.2])
    x = [-1, -1, 0.1, 0.5, 0.9, 0.8, 0.4, 0.2, -1, -1]
    y = [0, 0, 0.2, 0.8, 0.6, 0.1, 0.3, 0.9, 0.5, 0]
    return np.stack([np.interp(times, knots, x), np.interp(times, knots, y)], 1)


def film(camera, late=0.0, moves=True):
    """Grey images of one camera, what it shows being so late (s)."""
    rng = np.random.default_rng(camera)
    ground = rng.integers(90, 150, (60, 80)).astype(np.uint8)
    images = []
    for place in path(TIMES - late):
        x, y = VIEWS[camera % 3] @ [*place, 1]
        image = ground.copy()
        if moves:
            cv2.circle(image, (round(x), round(y)), 9, 30, -1)
        images.append(np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8))
    return images


def told(late):
    seen = [changes(moving(film(k, one))) for k, one in enumerate(late)]
    return check_clocks([f"cam{k}" for k in range(len(late))], seen, [TIMES] * len(late))


@pytest.mark.parametrize("late", [0.4, -0.52, 0.9])
def test_a_late_camera_is_found_and_named(late):
    checks = told([0, late, 0])
    assert [c.verdict for c in checks] == ["good", "bad", "good"]
    assert checks[1].figure == pytest.approx(late, abs=0.13)
    assert f"the clock of cam1 is {abs(checks[1].figure):.2f} s {'late' if late > 0 else 'early'}" in checks[1].cause
    assert f"ingest.offsets = cam1={checks[1].figure:.2f}" in checks[1].remedy


def test_cameras_on_one_clock_are_good():
    assert {c.verdict for c in told([0, 0, 0])} == {"good"}
    assert {c.verdict for c in told([0, 0])} == {"good"}


def test_of_two_cameras_the_second_is_late():
    assert [c.verdict for c in told([0.4, 0])] == ["good", "bad"]
    assert told([0.4, 0])[1].figure == pytest.approx(-0.4, abs=0.05)


def test_where_nothing_or_too_little_moves_nothing_is_told():
    still = [changes(moving(film(k, moves=False))) for k in range(2)]
    assert compare_clocks(still, [TIMES, TIMES]) is None
    assert compare_clocks([changes(moving(film(0)))], [TIMES]) is None
    short = [changes(moving(film(k)[:8])) for k in range(2)]
    assert compare_clocks(short, [TIMES[:8]] * 2) is None


def test_cameras_that_see_different_things_are_not_blamed():
    rng = np.random.default_rng(0)
    seen = [changes(moving(film(0))), rng.random((FRAMES, 24)) * 30]
    assert {c.verdict for c in check_clocks(["a", "b"], seen, [TIMES, TIMES])} == {"good"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two cameras, the second of which is half a frame late."""
    folder = tmp_path_factory.mktemp("late")
    cameras = make_cameras(("cam0", "cam1"))
    write_cameras(folder, cameras)
    depth = np.full((48, 64), 800, np.uint16)
    for k, camera in enumerate(cameras):
        for number, image in enumerate(film(k)):
            color = np.repeat(cv2.resize(image, (64, 48))[..., None], 3, axis=2)
            write_frame(folder / "s", camera, number, color, depth, 90)
        write_times(folder / "s", camera, TIMES + 0.1 * k)
    return folder / "s"


def test_frames_without_partners_are_explained_by_the_clock(recording):
    with pytest.raises(DataError, match=r"100 ms apart .* the clock of cam1 is 0\.(0[6-9]|1[0-4]) s late") as caught:
        read_sequence(recording, ReadParams())
    assert "ingest.offsets = cam1=0." in caught.value.hint


def test_an_offset_is_taken_off(recording):
    arrays, _ = read_sequence(recording, ReadParams(offsets="cam1=0.1"))
    assert len(arrays["time"]) == FRAMES
    np.testing.assert_allclose(arrays["stamp"], np.repeat(TIMES[:, None], 2, axis=1), atol=1e-5)


def test_an_offset_of_no_camera_is_refused(recording):
    with pytest.raises(UsageError, match=r"ingest\.offsets: no camera cam7"):
        read_sequence(recording, ReadParams(offsets={"cam7": 1.0}))
