"""Recordings that are wrong on purpose: that what was asked for is in the pictures, in cameras.json and in the truth."""

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from piegraph_cli import environments
from piegraph_cli.environments.params import RecordingParams, SimulateParams, TroubleParams
from piegraph_cli.environments.recording import plan_moments, record
from piegraph_cli.environments.render import OTHER
from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.environments.scene import Scene, moment_at
from piegraph_cli.environments.trouble import GAP, hidden_frames, lost_frames, told_cameras, trouble_arrays
from piegraph_cli.errors import UsageError
from piegraph_cli.params import validated

SMALL = camera_rig(80, 60)[:2]


@pytest.fixture(scope="module")
def block():
    return environments.make("tblock")


def frames_of(block, hand, count=9, **trouble):
    stream = record(block, 6, 1, SMALL, hand, trouble=TroubleParams(**trouble))
    return [next(stream) for _ in range(count)]


def scene_of(block, hand, **trouble):
    return Scene(block, plan_moments(block, 6, 2, hand), SMALL, hand, TroubleParams(**trouble))


def test_more_cameras_begin_with_the_four_of_every_recording():
    eight = camera_rig(count=8)
    assert [c.name for c in eight] == [f"cam{k}" for k in range(8)]
    for one, other in zip(eight, camera_rig(), strict=False):
        assert np.array_equal(one.T_world_camera, other.T_world_camera)
        assert np.array_equal(one.K, other.K)
    places = np.array([c.T_world_camera[:3, 3] for c in eight])
    apart = np.linalg.norm(places[:, None] - places, axis=2) + np.eye(8)
    assert apart.min() > 0.3


def test_told_cameras_are_moved_and_turned_and_the_others_stay():
    told = told_cameras(SMALL, TroubleParams(of=(1,), moved=(0.01, 0, 0), turned=(0, 0, 3)))
    assert np.array_equal(told[0].T_world_camera, SMALL[0].T_world_camera)
    np.testing.assert_allclose(told[1].T_world_camera[:3, 3] - SMALL[1].T_world_camera[:3, 3], [0.01, 0, 0])
    turn = told[1].T_world_camera[:3, :3] @ SMALL[1].T_world_camera[:3, :3].T
    assert np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) == pytest.approx(3)


def test_a_late_camera_shows_what_was_before(block, hand):
    usual, late = frames_of(block, hand), frames_of(block, hand, of=(1,), late=0.4)
    for k in range(2, 9):
        assert np.array_equal(late[k].hand_mask[1], usual[k - 2].hand_mask[1])
        assert np.array_equal(late[k].hand_mask[0], usual[k].hand_mask[0])
        assert np.array_equal(late[k].stamps, usual[k].stamps)
    assert not np.array_equal(late[8].hand_mask[1], usual[8].hand_mask[1])


def test_between_moments_all_moves_in_the_straight_line(block, hand):
    moments = plan_moments(block, 6, 1, hand)
    between = moment_at(moments, 5.25 / 5)
    np.testing.assert_allclose(between.tip, 0.75 * moments[5].tip + 0.25 * moments[6].tip)
    assert moment_at(moments, -1.0).tip is None
    assert moment_at(moments, 99.0).tip is None


def test_depth_seen_from_beside_is_shifted_against_colour(block, hand):
    usual, aside = frames_of(block, hand, 1), frames_of(block, hand, 1, of=(1,), aside=0.05, noise=0.0)
    assert np.array_equal(aside[0].object_mask, usual[0].object_mask)

    def agree(frame, camera):
        off = np.abs(frame.depth[camera].astype(float) - usual[0].depth[camera])
        return np.mean(off[usual[0].object_mask[camera]] < 12)

    assert agree(aside[0], 0) > 0.9 > 0.6 > agree(aside[0], 1)


def test_half_of_the_object_is_hidden_while_it_is_said(block, hand):
    trouble = TroubleParams(hidden=3, hidden_from=2)
    usual, hidden = frames_of(block, hand, 6), frames_of(block, hand, 6, hidden=3, hidden_from=2)
    for k in range(6):
        share = hidden[k].object_mask.sum((1, 2)) / usual[k].object_mask.sum((1, 2))
        assert ((share > 0.1) & (share < 0.85)).all() if k in hidden_frames(trouble, 6) else (share == 1).all()
    assert list(hidden_frames(TroubleParams(hidden=3), 20)) == [8, 9, 10]


def test_the_object_is_gone_from_a_frame_on(block, hand):
    gone = frames_of(block, hand, 4, gone_from=2)
    assert [frame.object_mask.any() for frame in gone] == [True, True, False, False]


def test_what_is_beside_keeps_clear_of_all_that_moves_and_is_in_no_mask(block, hand):
    scene = scene_of(block, hand, beside="same", resting_hand=True)
    assert [part.label for part in scene.still] == [OTHER] * 3
    thing = scene.still[0].vertices
    for moment in scene.moments:
        particles = block.particles(moment.shape)
        low = thing[:, :2].min(0), thing[:, :2].max(0)
        outside = np.maximum(np.maximum(low[0] - particles[:, :2], particles[:, :2] - low[1]), 0)
        assert np.linalg.norm(outside, axis=1).min() > GAP / 3
    assert np.allclose(scene.still[0].colors, [block.color])
    assert not np.allclose(scene_of(block, hand, beside="other").still[0].colors, [block.color])
    assert (scene.views(0)[0][0].label == OTHER).any()


def test_no_room_for_a_thing_beside_is_said(block, hand, monkeypatch):
    monkeypatch.setattr("piegraph_cli.environments.trouble.GAP", 3.0)
    with pytest.raises(UsageError, match="no room on the table"):
        scene_of(block, hand, beside="same")


def test_pushes_bend_and_do_not_lift(block, hand):
    def strokes(bends):
        moments = plan_moments(block, 6, 3, hand, (), bends)
        return [np.array([m.tip for m in moments if m.stroke == k]) for k in range(3)]

    for straight, bent in zip(strokes(()), strokes((np.radians(45),) * 2), strict=True):
        assert sideways(straight) < 1e-9
        assert np.ptp(bent[:, 2]) < 1e-6
    assert max(sideways(bent) for bent in strokes((np.radians(45),) * 2)) > 0.01


def sideways(path):
    along = (path[-1] - path[0])[:2] / np.linalg.norm((path[-1] - path[0])[:2])
    return np.abs((path - path[0])[:, :2] @ [-along[1], along[0]]).max()


def test_lost_frames_follow_from_the_seed_and_spare_the_first_two():
    lost = lost_frames(TroubleParams(dropped=0.3), 5, 400, 4)
    assert np.array_equal(lost, lost_frames(TroubleParams(dropped=0.3), 5, 400, 4))
    assert not lost[:2].any()
    assert lost.mean() == pytest.approx(0.3, abs=0.05)
    assert not lost_frames(TroubleParams(), 5, 400, 4).any()


def test_the_truth_says_what_was_done():
    kept = np.ones((5, 2), bool)
    done = trouble_arrays(TroubleParams(of=(1,), aside=0.05, gone_from=3, hidden=2, hidden_from=1), SMALL, kept)
    assert np.linalg.norm(done["pose/depth"][1, :3, 3] - done["pose/color"][1, :3, 3]) == pytest.approx(0.05)
    assert np.array_equal(done["pose/depth"][0], done["pose/color"][0])
    assert done["done/gone"][:, 0].tolist() == [False, False, False, True, True]
    assert done["done/hidden"][:, 1].tolist() == [False, True, True, False, False]


def test_recordings_without_trouble_keep_their_keys():
    assert "trouble" not in RecordingParams().content()
    assert "cameras" not in RecordingParams().content()
    assert RecordingParams(trouble="late=0.4").content()["trouble"]["late"] == 0.4


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"trouble": "besides=same"}, "besides: unknown setting"),
        ({"trouble": "of=4,late=1"}, "there is no camera 4"),
        ({"cameras": 1, "trouble": "late=1"}, "there is no camera 1"),
        ({"trouble": "dropped=1"}, "less than 1"),
        ({"cameras": 9}, "less than or equal to 8"),
    ],
)
def test_settings_are_checked(values, said):
    with pytest.raises(UsageError, match=said):
        validated(SimulateParams, values, "simulate", "here", "")
