"""Several things on the table: which is the object, what a prompt means, and nothing taken of what lies beside it."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.perception.hands import end_effector
from piegraph_cli.perception.others import without_others
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.places import inside
from piegraph_cli.perception.prompts import check_prompts, prompted_object
from piegraph_cli.perception.seeds import find_object
from piegraph_cli.perception.segmentation import segment_sequence
from tests.perception.scene import WORKSPACE, Box, pushing_sequence, ring_camera

CAMERAS = [ring_camera(azimuth, f"c{n}") for n, azimuth in enumerate((0.4, 2.5))]
FRAMES = 6
LARGE = Box((-0.18, -0.18), (0.2, 0.16, 0.04))
NEAR = Box((0.03, -0.16), (0.18, 0.08, 0.03))
"""Its edge is 3.5 cm from the T's foot."""
AHEAD = Box((-0.19, 0.06), (0.08, 0.2, 0.03))
"""The T is pushed towards it until 1 cm is left."""


class Scene:
    """A pushing sequence with things beside the T, as `find_object` takes it; `frames` picks some of it."""

    def __init__(self, beside, frames=range(FRAMES), hand=True):
        views, hands = pushing_sequence(FRAMES, CAMERAS, beside=beside if callable(beside) else lambda frame: beside)
        views = [views[f] for f in frames]
        pixels = np.array([[camera.project(hands[f])[0] for camera in CAMERAS] for f in frames])
        self.tips = end_effector(hands[list(frames)]) if hand else np.full((len(views), 3), np.nan)
        self.hand_px = pixels if hand else np.full_like(pixels, np.nan)
        self.images = [[row[c].image for row in views] for c in range(len(CAMERAS))]
        self.depths = [[row[c].depth for row in views] for c in range(len(CAMERAS))]
        self.object = np.array([[row[c].object for row in views] for c in range(len(CAMERAS))])
        self.beside = np.array([[row[c].beside for row in views] for c in range(len(CAMERAS))])

    def find(self, **settings):
        given = self.images, self.depths, CAMERAS, self.hand_px, WORKSPACE, SegmentParams(**settings), self.tips
        return prompted_object(*given) if settings else find_object(*given)

    def masks(self, seed):
        images, depths = without_others(self.images, self.depths, CAMERAS, seed)
        return np.array(
            [
                segment_sequence(
                    images[c],
                    depths[c],
                    CAMERAS[c],
                    self.hand_px[:, c],
                    WORKSPACE,
                    seed.frame,
                    seed.masks[c],
                    SegmentParams(),
                )
                for c in range(len(CAMERAS))
            ]
        )

    def box(self, c):
        rows, columns = np.nonzero(self.beside[c, 0])
        return (columns.min() - 3, rows.min() - 3, columns.max() + 3, rows.max() + 3)


def iou(a, b):
    return (a & b).sum(axis=(-2, -1)) / (a | b).sum(axis=(-2, -1))


@pytest.fixture(scope="module")
def large():
    return Scene([LARGE])


@pytest.mark.parametrize("colour", [(40, 90, 190), (200, 40, 40)], ids=["same colour", "another"])
@pytest.mark.parametrize("height", [0.01, 0.1])
def test_the_object_that_is_pushed_is_taken_before_a_larger_one(height, colour):
    scene = Scene([Box(LARGE.centre, (*LARGE.size[:2], height), colour)])
    seed = scene.find()
    assert (iou(seed.masks, scene.object[:, seed.frame]) > 0.7).all()
    assert seed.warnings == []
    assert (seed.others[0].masks & scene.beside[:, seed.frame]).sum() > 0.7 * scene.beside[:, seed.frame].sum()


def test_one_of_three(large):
    scene = Scene([LARGE, Box((0.2, 0.2), (0.1, 0.12, 0.06), (220, 220, 220))])
    seed = scene.find()
    assert (iou(seed.masks, scene.object[:, seed.frame]) > 0.7).all()
    assert seed.warnings == []


def test_without_a_hand_the_one_that_moves_is_taken():
    views = Scene([LARGE])
    views.hand_px[:], views.tips[:] = np.nan, np.nan
    seed = views.find()
    assert (iou(seed.masks, views.object[:, seed.frame]) > 0.6).all()


@pytest.mark.parametrize("frames", [[0, 0, 0], [0]])
def test_where_nothing_moves_the_largest_is_taken_and_the_choice_is_told(frames):
    seed = Scene([LARGE], frames=frames).find()
    assert len(seed.warnings) == 1
    assert "2 things on the table are neither touched nor moved" in seed.warnings[0]
    assert "x, y = (-0.18, -0.1" in seed.warnings[0]
    assert "segment.prompts, as c" in seed.warnings[0]


@pytest.mark.parametrize("beside", [LARGE, NEAR, AHEAD], ids=["far", "3.5 cm apart", "ahead"])
def test_nothing_is_taken_of_what_lies_still_beside_the_object(beside):
    scene = Scene([beside])
    masks = scene.masks(scene.find())
    assert (masks & scene.beside).sum() == 0
    assert (iou(masks, scene.object) > 0.93).all()


def test_without_wiping_the_neighbour_would_be_taken():
    """The test above notices: followed in the images as they are, the mask takes in the neighbour."""
    scene = Scene([AHEAD])
    seed = scene.find()
    seed.others.clear()
    assert (scene.masks(seed) & scene.beside).sum() > 1000


def test_a_thing_that_is_moved_beside_the_object_is_told():
    scene = Scene(lambda frame: [Box((LARGE.centre[0], LARGE.centre[1] + 0.2 * (frame > 3)), LARGE.size)])
    seed = scene.find()
    assert (iou(seed.masks, scene.object[:, seed.frame]) > 0.7).all()
    assert any("is moved from frame 4 on" in warning for warning in seed.warnings)


@pytest.mark.parametrize("c", range(2))
def test_a_box_in_one_camera_holds_in_the_other_too(large, c):
    seed = large.find(prompts={CAMERAS[c].name: large.box(c)})
    assert seed.frame == 0
    assert (iou(seed.masks, large.beside[:, 0]) > 0.7).all()


@pytest.mark.parametrize("c", range(2))
def test_a_point_in_one_camera_holds_in_the_other_too(large, c):
    left, top, right, bottom = large.box(c)
    seed = large.find(points={CAMERAS[c].name: ((left + right) / 2, (top + bottom) / 2)})
    assert (iou(seed.masks, large.beside[:, 0]) > 0.7).all()


def test_a_box_may_cut_a_part_of_something_larger(large):
    left, top, right, bottom = large.box(0)
    masks = np.array(large.find(prompts={"c0": (left, top, (2 * left + right) / 3, bottom)}).masks)
    assert masks.any(axis=(1, 2)).all()
    assert not (masks & large.object[:, 0]).any()
    assert masks.sum() < 0.7 * large.beside[:, 0].sum()


@pytest.mark.parametrize("prompt", [{"prompts": {"c0": (1, 150, 9, 157)}}, {"points": {"c0": (3, 155)}}])
def test_a_prompt_that_meets_nothing_is_an_error_with_what_there_is(large, prompt):
    with pytest.raises(DataError, match=r"(?s)segment\.(prompts|points)\.c0 meets nothing.*c\d = \["):
        large.find(**prompt)


@pytest.mark.parametrize(
    ("prompt", "message"),
    [
        ({"prompts": {"nobody": (1, 2, 3, 4)}}, "names no camera"),
        ({"points": {"nobody": (1, 2)}}, "names no camera"),
        ({"prompts": {"c0": (30, 20, 10, 40)}}, "not inside the image"),
        ({"points": {"c0": (900, 20)}}, "not inside the image"),
    ],
)
def test_prompts_that_cannot_be_are_refused(prompt, message):
    with pytest.raises(UsageError, match=message):
        check_prompts(SegmentParams(**prompt), CAMERAS)


def test_both_ends_of_the_workspace_count():
    box = np.array([[-1, 1], [-1, 1], [-0.02, 0.2]])
    heights = np.array([-0.03, -0.01, 0.0, 0.19, 0.21, np.nan])
    points = np.column_stack([np.zeros((6, 2)), heights])
    assert inside(points, box).tolist() == [False, True, True, True, False, False]
