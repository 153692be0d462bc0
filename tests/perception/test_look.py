"""One look: what is seen of a scene with one image of each camera, and what makes its verdict bad."""

from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.perception.look import LookSettings, look
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.parts import View, parts_of
from piegraph_cli.physics.particles import Sizes, size_of
from piegraph_cli.recording.params import ReadParams
from tests.perception.scene import WORKSPACE, Box, hand_pose, render, ring_camera

CAMERAS = [ring_camera(angle, f"cam{n}") for n, angle in enumerate((0.3, 1.9, 3.4, 5.0))]
SETTINGS = LookSettings(ReadParams(workspace=tuple(WORKSPACE.ravel()), accept=("sharpness",)))
CENTRE, YAW = (0.02, 0.01), 0.4


def seen(cameras: int = 4, centre: tuple = CENTRE, settings: LookSettings = SETTINGS, change=None, **scene):
    """A look at a rendered T by so many cameras, and the views."""
    views = [
        render(k, centre, YAW, scene.get("hand"), seed=n, beside=scene.get("beside", ()))
        for n, k in enumerate(CAMERAS[:cameras])
    ]
    for view in views if change else ():
        change(view)
    found = look([v.image for v in views], [v.depth for v in views], CAMERAS[:cameras], settings)
    return found, views


def named(found) -> dict[str, str]:
    return {f.name: f.checks[0].verdict for f in found.findings if f.name != "sharpness"}


@pytest.mark.parametrize("cameras", [1, 4])
def test_what_is_seen_is_the_object(cameras):
    found, views = seen(cameras)
    assert named(found) == {}
    for mask, view in zip(found.masks, views, strict=True):
        assert (mask & view.object).sum() / (mask | view.object).sum() > 0.97
    assert found.particles.shape == (50, 3)
    # the T's middle, and what a camera sees of its 20 cm bar and 16 cm height
    size = size_of(found.particles)
    assert size.length == pytest.approx(0.2, abs=0.025)
    assert size.height == pytest.approx(0.03, abs=0.005)
    np.testing.assert_allclose(found.cloud[:, :2].mean(0), [0.02, 0.01], atol=0.03)
    assert set(found.seconds) == {"object", "masks", "cloud", "particles", "checks", "total"}


def view_of_strips(*strips: tuple[float, float, float, float]) -> View:
    """A view whose candidates lie on these parts of the table: x0, x1, y0, y1 (m)."""
    grids = [np.meshgrid(np.arange(x0, x1, 0.002), np.arange(y0, y1, 0.002)) for x0, x1, y0, y1 in strips]
    x, y = (np.concatenate([grid[axis].ravel() for grid in grids]) for axis in (0, 1))
    points = np.stack([x, y, np.full_like(x, 0.02)], 1)[None]
    everywhere = np.ones(points.shape[:2], bool)
    return View(everywhere, everywhere, ~everywhere, points)


def test_two_cameras_on_opposite_sides_see_one_thing():
    """Of a rope each sees its side, and both a little of its top; what one sees elsewhere may be a shadow."""
    one = view_of_strips((-0.1, 0.1, 0.0, 0.012), (-0.1, 0.1, -0.2, -0.15))
    other = view_of_strips((-0.1, 0.1, 0.016, 0.026), (0.0, 0.03, 0.0, 0.026))
    (part,) = parts_of([one, other], WORKSPACE, SegmentParams())
    assert part.area == pytest.approx(0.2 * 0.026, rel=0.3)
    assert part.masks[1].all()
    assert part.masks[0].sum() == 6 * 100


def half_hidden(view) -> None:
    column = int(np.nonzero(view.object)[1].mean())
    view.image[:, column:], view.depth[:, column:] = 120, 400


def without_depth(view) -> None:
    view.depth[view.object] = 0


@pytest.mark.parametrize(
    ("cameras", "scene", "check"),
    [
        (4, {"hand": hand_pose(np.array([0.1, 0.02, 0.02]))}, "cut"),
        (4, {"centre": (0.25, 0.2)}, "cut"),
        (1, {"centre": (0.0, 0.22)}, "cut"),
        (1, {"change": half_hidden}, "hidden"),
        (1, {"hand": hand_pose(np.array([0.0, 0.0, 0.1]))}, "cut"),
        (4, {"beside": [Box((-0.2, -0.1), (0.08, 0.08, 0.04))]}, "candidates"),
        (4, {"centre": (2.0, 2.0)}, "object"),
        (4, {"change": without_depth}, "points"),
    ],
)
def test_a_bad_look_gives_no_particles(cameras, scene, check):
    found, _ = seen(cameras, **scene)
    assert named(found)[check] == "bad"
    assert found.verdict == "bad"
    with pytest.raises(DataError, match="the look is bad"):
        _ = found.particles


def test_what_is_accepted_is_used_knowingly():
    beside = [Box((-0.2, -0.1), (0.08, 0.08, 0.04))]
    found, _ = seen(beside=beside, settings=replace(SETTINGS, accept=("candidates",)))
    assert found.verdict == "doubtful"
    assert len(found.particles) == 50


def test_wrong_poses_are_a_bad_look():
    views = [render(k, CENTRE, YAW, None, seed=n) for n, k in enumerate(CAMERAS)]
    turned = [replace(k, T_world_camera=np.linalg.inv(k.T_world_camera)) for k in CAMERAS]
    found = look([v.image for v in views], [v.depth for v in views], turned, SETTINGS)
    with pytest.raises(DataError, match="inverting T_world_camera"):
        found.require()


def test_of_several_things_the_prompt_or_the_trained_size_tells():
    big = [Box((-0.1, -0.17), (0.27, 0.07, 0.04))]
    alone, _ = seen()
    larger, _ = seen(beside=big)
    assert "candidates" in named(larger)
    known = replace(SETTINGS, sizes=Sizes.of([alone.particles]))
    column, row = CAMERAS[0].project(np.array([[0.02, 0.01, 0.03]]))[0][0]
    pointed = replace(SETTINGS, segment=SegmentParams(points={"cam0": (column, row)}))
    for settings in (known, pointed):
        found, _ = seen(beside=big, settings=settings)
        assert named(found) == {}
        np.testing.assert_allclose(found.cloud[:, :2].mean(0), alone.cloud[:, :2].mean(0), atol=0.004)


def test_an_object_of_another_size_is_told():
    other = Sizes.of([seen()[0].particles * [1.6, 1.6, 1.0]])
    found, _ = seen(settings=replace(SETTINGS, sizes=other))
    assert named(found)["size"] == "bad"
    assert "the trained object 3" in next(f.text for f in found.findings if f.name == "size")


def test_a_camera_that_does_not_see_the_object_is_left_out():
    far = replace(ring_camera(0.3, "far", 320, 240), K=np.array([[900.0, 0, -400], [0, 900, -400], [0, 0, 1]]))
    views = [render(k, CENTRE, YAW, None, seed=n) for n, k in enumerate([*CAMERAS[:2], far])]
    found = look([v.image for v in views], [v.depth for v in views], [*CAMERAS[:2], far], SETTINGS)
    assert not found.masks[2].any()
    assert len(found.chosen) == 50


def test_images_that_do_not_fit_are_refused():
    view = render(CAMERAS[0], CENTRE, YAW, None)
    with pytest.raises(DataError, match="1 colour and 1 depth images for 2 cameras"):
        look([view.image], [view.depth], CAMERAS[:2])
    with pytest.raises(DataError, match="cam0: colour is uint8 \\[80, 212, 3\\]"):
        look([view.image[::2]], [view.depth], CAMERAS[:1])
    with pytest.raises(DataError, match="depth is float32"):
        look([view.image], [view.depth.astype(np.float32)], CAMERAS[:1])
    with pytest.raises(UsageError, match="names no camera"):
        look([view.image], [view.depth], CAMERAS[:1], LookSettings(segment=SegmentParams(points={"front": (1, 2)})))
