"""Finding and following the object without weights, on ray-cast scenes whose masks are known."""

import cv2
import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.perception import segmentation
from piegraph_cli.perception.hand_region import hand_region
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.seeds import find_object
from piegraph_cli.perception.segmentation import ON_HAND, RIM, learn_object, object_score, segment_sequence
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.colour import lab_bins
from tests.perception.scene import WORKSPACE, pushing_sequence, render, ring_camera

CAMERAS = [ring_camera(azimuth, f"c{n}") for n, azimuth in enumerate((0.4, 2.5))]
PARAMS = SegmentParams()
FRAMES = 5


class Recording:
    """A pushing sequence as the segmentation takes it: lists by camera, then frame."""

    def __init__(self, height: float):
        views, hands = pushing_sequence(FRAMES, CAMERAS, height)
        self.hand_px = np.array([[camera.project(hand)[0] for camera in CAMERAS] for hand in hands])
        self.images = [[row[c].image for row in views] for c in range(len(CAMERAS))]
        self.depths = [[row[c].depth for row in views] for c in range(len(CAMERAS))]
        self.object = np.array([[row[c].object for row in views] for c in range(len(CAMERAS))])
        self.hand = np.array([[row[c].hand for row in views] for c in range(len(CAMERAS))])

    def seed(self):
        return find_object(self.images, self.depths, CAMERAS, self.hand_px, WORKSPACE, PARAMS)

    def segment(self, c: int, frame: int = 0, seed=None, **changed):
        arguments = {"images": self.images[c], "depths": self.depths[c], "hand_px": self.hand_px[:, c]} | changed
        seed = self.seed().masks[c] if seed is None else seed
        return segment_sequence(
            camera=CAMERAS[c], workspace=WORKSPACE, seed_frame=frame, seed_mask=seed, params=PARAMS, **arguments
        )


@pytest.fixture(scope="module", params=[0.03, 0.003], ids=["block", "cloth"])
def recording(request):
    return Recording(request.param)


@pytest.fixture(scope="module")
def block():
    return Recording(0.03)


def iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a & b).sum(axis=(1, 2)) / (a | b).sum(axis=(1, 2))


def test_the_seed_is_the_object_before_the_hand_comes_near(recording):
    seed = recording.seed()
    assert seed.frame == 0
    assert (iou(np.array(seed.masks), recording.object[:, 0]) > 0.7).all()
    assert not (np.array(seed.masks) & recording.hand[:, 0]).any()


@pytest.mark.parametrize("c", range(len(CAMERAS)))
def test_masks_follow_the_object_and_leave_the_hand_out(recording, c):
    masks = recording.segment(c)
    assert (iou(masks, recording.object[c]) > 0.95).all()
    assert (masks & recording.hand[c]).sum() < 0.01 * masks.sum()


def test_masks_are_found_backwards_from_a_later_seed(block):
    masks = block.segment(0, frame=FRAMES - 1, seed=block.object[0, -1])
    assert (iou(masks, block.object[0]) > 0.95).all()


@pytest.mark.parametrize("c", range(len(CAMERAS)))
def test_a_window_gives_the_masks_of_the_whole_image(block, c, monkeypatch):
    seed = block.object[c, 0]
    found = block.segment(c, seed=seed)
    near = segmentation.window_around
    monkeypatch.setattr(
        segmentation,
        "window_around",
        lambda mask, margin: tuple(slice(0, n) for n in mask.shape) if margin > RIM else near(mask, margin),
    )
    np.testing.assert_array_equal(block.segment(c, seed=seed), found)


@pytest.mark.parametrize(
    ("box", "window", "within"),
    [
        ((8, 8, 44, 24), (slice(20, 60), slice(30, 90)), True),
        ((7, 8, 10, 10), (slice(20, 60), slice(30, 90)), False),
        ((8, 7, 10, 10), (slice(20, 60), slice(30, 90)), False),
        ((8, 8, 45, 24), (slice(20, 60), slice(30, 90)), False),
        ((8, 8, 44, 25), (slice(20, 60), slice(30, 90)), False),
        ((0, 0, 100, 80), (slice(0, 80), slice(0, 100)), True),
        ((0, 0, 0, 0), (slice(20, 60), slice(30, 90)), True),
    ],
)
def test_a_window_grows_unless_parts_end_clear_of_its_rim(box, window, within):
    boxes = np.array([(0, 0, 0, 0, 0), (*box, box[2] * box[3])])
    assert segmentation._lie_within(boxes, window, (80, 100)) is within


def test_the_same_input_gives_the_same_masks(block):
    np.testing.assert_array_equal(block.segment(0), block.segment(0))


def test_a_hand_without_landmarks_is_kept_out_by_colour_and_height(block):
    masks = block.segment(0, hand_px=np.full((FRAMES, 21, 2), np.nan))
    assert (masks & block.hand[0]).sum() < 0.05 * masks.sum()


def test_frames_without_depth_rely_on_colour(block):
    depths = [np.zeros_like(d) if f == 3 else d for f, d in enumerate(block.depths[0])]
    assert iou(block.segment(0, depths=depths), block.object[0])[3] > 0.9


def test_a_block_of_the_tables_colour_is_found_and_followed_by_its_height(block):
    images = [[np.full_like(image, [150, 110, 75]) for image in row] for row in block.images]
    seed = find_object(images, block.depths, CAMERAS, block.hand_px, WORKSPACE, PARAMS)
    masks = block.segment(0, images=images[0], seed=seed.masks[0])
    assert (iou(masks, block.object[0]) > 0.6).all()


def test_the_hands_colour_is_learnt_as_what_is_not_the_object(block):
    model = learn_object(
        block.images[0], block.depths[0], CAMERAS[0], block.hand_px[:, 0], WORKSPACE, 0, block.object[0, 0]
    )
    skin = lab_bins(block.images[0][0])[block.hand[0, 0]]
    blue = lab_bins(block.images[0][0])[block.object[0, 0]]
    assert np.median(model.intruder[skin]) > np.median(model.object[skin]) + 5
    assert np.median(model.object[blue]) > np.median(model.intruder[blue]) + 5


def test_landmarks_speak_against_the_object(block):
    seed, hand_px = block.object[0, 0], block.hand_px[:, 0]
    model = learn_object(block.images[0], block.depths[0], CAMERAS[0], hand_px, WORKSPACE, 0, seed)
    blind = np.zeros_like(block.depths[0][0])
    grey = np.full_like(block.images[0][0], 128)
    wide = np.array([[-9.0, 9], [-9, 9], [-9, 9]])
    without, with_hand = (
        object_score(grey, blind, CAMERAS[0], pixels, wide, seed, model, PARAMS)[0]
        for pixels in (np.full((21, 2), np.nan), hand_px[0])
    )
    difference = without - with_hand
    region = hand_region(hand_px[0], blind, CAMERAS[0])
    np.testing.assert_allclose(difference[cv2.erode(region.astype(np.uint8), np.ones((5, 5))) > 0], ON_HAND, atol=1e-4)
    assert difference[cv2.dilate(region.astype(np.uint8), np.ones((5, 5))) == 0].max() == 0


def test_what_reaches_in_from_the_edge_is_not_the_object():
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
    camera = Camera("down", 200, 200, np.array([[300.0, 0, 99.5], [0, 300, 99.5], [0, 0, 1]]), np.zeros(5), down)
    depth = np.full((200, 200), 1000, np.uint16)
    depth[60:85, 60:85] = 970
    depth[110:150, 60:] = 970
    images, nobody = [[np.full((200, 200, 3), 128, np.uint8)]], np.full((1, 1, 21, 2), np.nan)
    seed = find_object(images, [[depth]], [camera], nobody, WORKSPACE, PARAMS)
    assert seed.masks[0][62:83, 62:83].all()
    assert not seed.masks[0][110:].any()


def test_a_hidden_object_leaves_an_empty_mask_and_is_found_again(block):
    images = [np.full_like(image, [150, 110, 75]) if f == 2 else image for f, image in enumerate(block.images[0])]
    depths = [np.zeros_like(depth) if f == 2 else depth for f, depth in enumerate(block.depths[0])]
    masks = block.segment(0, images=images, depths=depths)
    assert not masks[2].any()
    assert iou(masks, block.object[0])[3] > 0.9


def test_one_frame_and_one_camera(block):
    hand_px = np.full((1, 1, 21, 2), np.nan)
    images, depths = block.images[0][:1], block.depths[0][:1]
    seed = find_object([images], [depths], CAMERAS[:1], hand_px, WORKSPACE, PARAMS)
    masks = block.segment(0, seed=seed.masks[0], images=images, depths=depths, hand_px=hand_px[:, 0])
    assert masks.shape == (1, 159, 212)
    assert iou(masks, block.object[0, :1])[0] > 0.9


def test_an_empty_table_is_an_error_that_names_the_cameras():
    view = render(CAMERAS[0], (5, 5), 0, None)
    hand_px = np.full((1, 1, 21, 2), np.nan)
    with pytest.raises(DataError, match=r"(?s)c0.*no object found.*ingest.workspace"):
        find_object([[view.image]], [[view.depth]], CAMERAS[:1], hand_px, WORKSPACE, PARAMS)


def test_a_hand_alone_is_no_object():
    hand = pushing_sequence(1, CAMERAS)[1][0]
    views = [render(camera, (5, 5), 0, hand) for camera in CAMERAS]
    hand_px = np.array([[camera.project(hand)[0] for camera in CAMERAS]])
    with pytest.raises(DataError, match="no object found"):
        find_object([[v.image] for v in views], [[v.depth] for v in views], CAMERAS, hand_px, WORKSPACE, PARAMS)


def test_an_object_outside_the_workspace_is_not_taken(block):
    far = WORKSPACE + np.array([[1.0], [0.0], [0.0]])
    with pytest.raises(DataError, match="no object found"):
        find_object(block.images, block.depths, CAMERAS, block.hand_px, far, PARAMS)


def test_an_object_that_fills_the_view():
    camera, image, depth = (
        CAMERAS[0],
        np.full((159, 212, 3), [40, 90, 190], np.uint8),
        np.full((159, 212), 740, np.uint16),
    )
    wide, seed = np.array([[-9.0, 9], [-9, 9], [-9, 9]]), np.ones((159, 212), bool)
    masks = segment_sequence([image], [depth], camera, np.full((1, 21, 2), np.nan), wide, 0, seed, PARAMS)
    assert masks.all()


def test_a_camera_without_seed_is_named(block):
    with pytest.raises(DataError, match="camera c1, frame 0"):
        block.segment(1, seed=np.zeros((159, 212), bool))


def test_the_hand_region_covers_the_hand(block):
    for f in range(FRAMES):
        region = hand_region(block.hand_px[f, 0], block.depths[0][f], CAMERAS[0])
        hand = block.hand[0, f]
        assert (region & hand).sum() > 0.85 * hand.sum()
    assert not hand_region(np.full((21, 2), np.nan), block.depths[0][0], CAMERAS[0]).any()
