"""The camera rig, ray casting, sensor noise, the hand and whole recordings, on small pictures."""

import json
import math
import struct
import warnings
from itertools import pairwise

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from block_distance import distance_to_surface

from piegraph_cli import environments
from piegraph_cli.environments import hand as hands
from piegraph_cli.environments import noise
from piegraph_cli.environments.hand_motion import Grip, arm_at, choose_grip, held
from piegraph_cli.environments.recording import plan_moments, record
from piegraph_cli.environments.render import HAND, OBJECT, TABLE, Part, Renderer, wood_texture
from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.environments.shapes import place
from piegraph_cli.errors import DataError, MissingError


@pytest.fixture(scope="module")
def glb(tmp_path_factory):
    """A hand with the real joint names whose mesh is a small triangle around every joint."""
    names = ["wrist", *(name for chain in hands.CHAINS.values() for name in chain)]
    joints = np.zeros((len(names), 3))
    for row, (finger, chain) in enumerate(hands.CHAINS.items()):
        for k, name in enumerate(chain):
            side = -0.02 * (2 - row)
            joints[names.index(name)] = (
                [0.0, -0.03 - 0.03 * k, side] if finger != "thumb" else [-0.01, -0.03 - 0.02 * k, -0.05]
            )
    offsets = np.array([[0.006, 0, 0], [-0.004, 0, 0.006], [-0.004, 0, -0.006]])
    points = (joints[:, None] + offsets).reshape(-1, 3).astype(np.float32)
    owners = np.zeros((len(points), 4), np.uint8)
    owners[:, 0] = np.repeat(np.arange(len(names)), 3)
    shares = np.tile(np.float32([1, 0, 0, 0]), (len(points), 1))
    triangles = np.arange(len(points), dtype=np.uint16)
    blobs = [(points, 5126, "VEC3"), (owners, 5121, "VEC4"), (shares, 5126, "VEC4"), (triangles, 5123, "SCALAR")]
    views, accessors, body = [], [], b""
    for blob, kind, shape in blobs:
        accessors.append({"bufferView": len(views), "componentType": kind, "count": len(blob), "type": shape})
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": blob.nbytes})
        body += blob.tobytes() + b"\0" * (-blob.nbytes % 4)
    gltf = {
        "nodes": [{"name": n, "translation": j.tolist()} for n, j in zip(names, joints, strict=True)],
        "skins": [{"joints": list(range(len(names)))}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3}]}],
        "accessors": accessors,
        "bufferViews": views,
    }
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body)) + struct.pack("<I4s", len(text), b"JSON")
    path = tmp_path_factory.mktemp("hand") / "right.glb"
    path.write_bytes(header + text + struct.pack("<I4s", len(body), b"BIN\0") + body)
    return path


@pytest.fixture(scope="module")
def hand(glb):
    return hands.load_hand(glb)


@pytest.fixture(scope="module")
def env():
    return environments.make("tblock")


def block_part(env, pose):
    vertices, triangles = env.block.mesh()
    return Part(place(vertices, np.array(pose)), triangles, OBJECT, np.array([[0.1, 0.1, 0.5]]))


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


def test_the_grip_avoids_the_object(hand):
    tips = np.tile([0.0, 0.0, 0.018], (4, 1))
    vertices, _ = held(hand, Grip(math.pi / 2, 0.0))
    low = vertices[:, 2].mean()
    free = choose_grip(hand, math.pi / 2, tips, lambda k, points: np.zeros(len(points), bool))
    avoiding = choose_grip(hand, math.pi / 2, tips, lambda k, points: points[:, 2] < low)
    assert free.steep == 0.0
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


def test_a_recording_begins_and_ends_without_the_hand(env, hand):
    moments = plan_moments(env, seed=5, strokes=2, hand=hand)
    out = [k for k, m in enumerate(moments) if m.tip is None]
    assert out == [0, 1, len(moments) - 2, len(moments) - 1]
    assert sorted({m.stroke for m in moments}) == [-1, 0, 1]
    tips = [m.tip for m in moments if m.tip is not None]
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.2
    between = [m for before, m in pairwise(moments) if m.stroke < 0 <= before.stroke]
    assert len(between) == 2
    poses = np.array([m.shape for m in moments])
    moving = np.linalg.norm(np.diff(poses, axis=0), axis=1) > 0
    assert all(moments[k].stroke >= 0 and moments[k + 1].stroke >= 0 for k in np.flatnonzero(moving))


def test_recording_is_bit_equal_and_true(env, hand):
    cameras = camera_rig(80, 60)[:2]
    runs = []
    for _ in range(2):
        stream = record(env, 6, 1, cameras, hand)
        runs.append([next(stream) for _ in range(6)])
    for first, second in zip(*runs, strict=True):
        assert all(
            np.array_equal(a, b) for a, b in zip(first.color + first.depth, second.color + second.depth, strict=True)
        )
        assert np.array_equal(first.stamps, second.stamps)
    frames = runs[0]
    assert frames[0].color[0].shape == (60, 80, 3)
    assert frames[0].depth[0].dtype == np.uint16
    assert not frames[0].hand_mask.any()
    assert np.isnan(frames[0].landmarks).all()
    assert frames[-1].hand_mask.any()
    assert np.isfinite(frames[-1].landmarks).all()
    assert not (frames[-1].hand_mask & frames[-1].object_mask).any()
    stamps = np.array([frame.stamps for frame in frames])
    assert np.abs(stamps - np.array([frame.moment.time for frame in frames])[:, None]).max() <= 0.005
    assert (np.diff(stamps, axis=0) > 0).all()


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
    vertices, triangles = arm.hand, real.triangles
    view = Renderer(camera_rig(160, 120))
    shown = view.render([Part(vertices, triangles, HAND, np.array([[0.6, 0.3, 0.2]]), smooth=True)])
    assert sum((v.label == HAND).any() for v in shown) == 4
