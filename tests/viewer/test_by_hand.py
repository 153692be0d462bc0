"""What the tools of the viewer do, without a browser: pixels under rays, goals, and prompts that are kept."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed: pip install 'piegraph[view]'")

from piegraph_cli.stages.images import color_of, depth_of
from piegraph_cli.viewer.desk import PLACE, Desk
from piegraph_cli.viewer.goal_shape import GoalShape
from piegraph_cli.viewer.lazy import Rows, lazily
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.slices import Slices


def desk(sizes) -> Desk:
    made = Desk(SimpleNamespace(server=SimpleNamespace(scene=None)))
    made._sizes = sizes
    return made


def test_a_ray_through_the_middle_of_an_image_meets_its_middle():
    images = desk([(424, 318), (640, 480), (640, 360)])
    for c, (x, z) in enumerate(images._middles()):
        eye = PLACE + np.array([0.3, -2.0, 0.4])
        camera, (column, row) = images.pixel(eye, PLACE + np.array([x, 0.0, z]) - eye)
        width, height = images._sizes[c]
        assert camera == c
        assert (column, row) == pytest.approx(((width - 1) / 2, (height - 1) / 2), abs=0.06)


def test_columns_go_right_and_rows_go_down():
    images = desk([(100, 50)])
    eye = PLACE - np.array([0.0, 2.0, 0.0])
    _, (column, row) = images.pixel(eye, [0.25, 2.0, 0.125])
    assert (column, row) == pytest.approx((74.5, 12.0), abs=0.06)


@pytest.mark.parametrize("along", [(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (3.0, 1.0, 0.0)])
def test_rays_beside_or_away_from_the_images_meet_nothing(along):
    assert desk([(100, 50)]).pixel(PLACE - np.array([0.0, 2.0, 0.0]), along) is None


LINE = np.column_stack([np.linspace(-0.2, 0.2, 40), np.zeros(40), np.full(40, 0.01)]).astype(np.float32)


def test_a_goal_that_is_turned_turns_about_its_middle():
    shape = GoalShape(LINE)
    shape.move(LINE, LINE[:, :2].mean(0), 0.1, 0.0, np.pi / 2)
    assert np.abs(shape.points[:, 0] - 0.1).max() < 1e-6
    assert shape.points[0, 1] == pytest.approx(-0.2, abs=1e-6)
    assert shape.bent() < 1e-6
    assert shape.doubt(LINE[None]) == ""


def test_what_is_dragged_first_leaves_the_farthest_end_where_it_is():
    shape = GoalShape(LINE)
    shape.drag(0, np.array([0.05, 0.15]))
    assert np.linalg.norm(shape.points[0, :2] - [0.05, 0.15]) < 0.005
    assert np.linalg.norm(shape.points[39, :2] - [0.2, 0.0]) < 0.005
    shape.drag(20, shape.points[20, :2] + 0.01)
    assert set(shape.held) == {0, 39, 20}


def test_a_goal_that_is_bent_as_the_object_never_was_is_doubted():
    shape = GoalShape(LINE)
    shape.drag(0, np.array([0.05, 0.15]))
    assert "never was by more than 0 mm" in shape.doubt(np.stack([LINE, LINE + 0.1]))
    assert shape.doubt(shape.points[None]) == ""


def test_points_to_hold_are_spread_from_an_end():
    numbers = GoalShape(LINE).controls(3)
    assert sorted(numbers.tolist()) == pytest.approx([0, 20, 39], abs=1)


def test_an_artifact_that_stays_on_the_disk_gives_the_same_images(sample_run):
    path = sample_run / "frames" / "sequence_0000.h5"
    whole, held = read_artifact(path, "frames"), Slices(path, "frames")
    lazy = lazily(held)
    assert isinstance(lazy["color"], Rows)
    assert lazy.params == whole.params
    assert lazy.texts("camera_name") == whole.texts("camera_name")
    for stack in (color_of, depth_of):
        kind = stack.__name__.partition("_")[0]
        a, b = (getattr(stack(of), kind)(17, 2) for of in (lazy, whole))
        assert (a == b).all()
    held.close()
