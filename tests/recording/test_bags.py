"""ROS bags: the same two seconds in every format are read as the same, and what is wrong with a bag is named."""

import struct
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from piegraph_cli.errors import DataError, MissingError
from piegraph_cli.recording.camera import DepthView, straight_rays
from piegraph_cli.recording.folders import layout_of, list_sequences
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.recording.layout import read_cameras, write_cameras
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.recording.readers import ros
from piegraph_cli.recording.readers.ros.cameras import _inverted
from piegraph_cli.recording.readers.ros.topics import camera_name, info_topic
from piegraph_cli.recording.sequence import read_sequence
from tests.cli import piegraph, piegraph_json
from tests.perception.scene import ring_camera
from tests.recording.make_bag import ROS1, ROS2, START, Types, camera_messages, write_bag

FRAMES = 8
ONE, TWO = Types(ROS1), Types(ROS2)
LEFT, RIGHT = ring_camera(0.4, "left", 64, 48), ring_camera(2.5, "right", 64, 48)
PARAMS = IngestParams()


def pictures(seed=0, frames=FRAMES):
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.integers(0, 255, (frames * 48, 64, 3), np.uint8), (0, 0), 3).reshape(
        frames, 48, 64, 3
    )
    return [(f / 5, smooth[f], rng.integers(500, 900, (48, 64)).astype(np.uint16)) for f in range(frames)]


def left(types=ONE, **more):
    return camera_messages(types, LEFT, pictures(), "/left", **more)


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
def test_every_format_is_read_as_the_same(tmp_path, suffix, compress):
    types = ONE if suffix == ".bag" else TWO
    right = camera_messages(types, RIGHT, pictures(1), "/right")
    bag = write_bag(tmp_path / f"take 1{suffix}", left(types) + right, compress)
    assert list_sequences(tmp_path) == [bag]
    assert layout_of(bag) == "ros"
    arrays, warnings = read_sequence(bag, PARAMS)
    assert not warnings
    assert [name.item() for name in arrays["camera_name"]] == ["left", "right"]
    np.testing.assert_allclose(arrays["time"], np.arange(FRAMES) / 5, atol=1e-6)
    assert arrays["source_frame"].tolist() == [[f, f] for f in range(FRAMES)]
    for c, camera in enumerate((LEFT, RIGHT)):
        np.testing.assert_allclose(arrays["T_world_camera"][c], camera.T_world_camera, atol=1e-4)
        np.testing.assert_allclose(arrays["K"][c], camera.K)
        np.testing.assert_allclose(arrays["distortion"][c], camera.distortion)
        assert arrays["depth_scale"][c] == 0.001
    depth, color = (ImageStack(arrays[k], arrays[f"{k}_offsets"], 2, k) for k in ("depth", "color"))
    for f, (_, image, units) in enumerate(pictures(1)):
        np.testing.assert_array_equal(depth.depth(f, 1), units)
        np.testing.assert_allclose(color.color(f, 1).astype(int), image, atol=12)


def test_a_recording_is_a_folder_of_bags_or_of_folders_with_a_bag_per_camera(tmp_path):
    (tmp_path / "many").mkdir()
    bags = [write_bag(tmp_path / "many" / f"{name}.bag", left()) for name in ("a", "b")]
    assert list_sequences(tmp_path / "many") == bags
    (tmp_path / "apart" / "take").mkdir(parents=True)
    take = tmp_path / "apart" / "take"
    write_bag(take / "front.bag", left())
    write_bag(take / "back.mcap", camera_messages(TWO, RIGHT, pictures(1), "/camera"))
    assert list_sequences(take.parent) == [take]
    films, _ = ros.read(take, PARAMS)
    assert [film.camera.name for film in films] == ["back", "front"]
    np.testing.assert_array_equal(films[0].images.depth(2)[0], pictures(1)[2][2])
    with pytest.raises(DataError, match="one sequence, not a recording"):
        list_sequences(take / "back")


def test_images_are_read_in_any_order(tmp_path):
    images = ros.read(write_bag(tmp_path / "t.bag", left()), PARAMS)[0][0].images
    for k in (5, 2, 2, 7, 0):
        np.testing.assert_array_equal(images.depth(k)[0], pictures()[k][2])


def swapped(messages, topic, change):
    """The messages with those of a topic as `change(message)` makes them; none where it gives none."""
    found = [(t, k, s, change(m)) if t == topic else (t, k, s, m) for t, k, s, m in messages]
    return [(t, type(m).__msgtype__, s, m) for t, _, s, m in found if m is not None]


DEPTH, COLOR = "/left/aligned_depth_to_color/image_raw", "/left/color/image_raw"


def time_of(message):
    return message.header.stamp.sec - START + message.header.stamp.nanosec / 1e9


def units_of(message):
    return np.frombuffer(message.data.tobytes(), np.uint16).reshape(48, 64)


def float_depth(m):
    metres = units_of(m).astype(np.float32) / 1000
    metres[0, 0], metres[0, 1] = np.nan, np.inf
    return ONE.image(time_of(m), "left_color_optical_frame", metres, "32FC1")


def big_endian(m):
    return replace(
        ONE.image(time_of(m), "left_color_optical_frame", units_of(m).astype(">u2"), "16UC1"), is_bigendian=1
    )


def padded_rows(m):
    wide = np.pad(units_of(m), ((0, 0), (0, 3)))
    return replace(ONE.image(time_of(m), "left_color_optical_frame", wide, "16UC1"), width=64)


def png_depth(m):
    png = cv2.imencode(".png", units_of(m))[1].tobytes()
    return ONE.compressed(time_of(m), "left_color_optical_frame", png, "16UC1; png compressed ")


def compressed_depth(m):
    png = struct.pack("<iff", 0, 0, 0) + cv2.imencode(".png", units_of(m))[1].tobytes()
    return ONE.compressed(time_of(m), "left_color_optical_frame", png, "16UC1; compressedDepth png")


def inverse_depth(m):
    a, b = 20000.0, -1000.0
    inverse = np.rint(a / (units_of(m) / 1000) + b).astype(np.uint16)
    png = struct.pack("<iff", 0, a, b) + cv2.imencode(".png", inverse)[1].tobytes()
    return ONE.compressed(time_of(m), "left_color_optical_frame", png, "32FC1; compressedDepth png")


@pytest.mark.parametrize(
    ("change", "scale"),
    [
        (float_depth, 0.00025),
        (big_endian, 0.001),
        (padded_rows, 0.001),
        (png_depth, 0.001),
        (compressed_depth, 0.001),
        (inverse_depth, 0.00025),
    ],
)
def test_depth_of_every_encoding(tmp_path, change, scale):
    film = ros.read(write_bag(tmp_path / "t.bag", swapped(left(), DEPTH, change)), PARAMS)[0][0]
    assert film.camera.depth_scale == scale
    units = film.images.depth(3)[0]
    assert units.dtype == np.uint16
    expected = pictures()[3][2].astype(float)
    if change is float_depth:
        expected[0, :2] = 0
    np.testing.assert_allclose(units * scale * 1000, expected, atol=0.1)


@pytest.mark.parametrize("encoding", ["bgr8", "rgba8", "mono8", "uyvy", "jpeg"])
def test_colour_of_every_encoding(tmp_path, encoding):
    def change(m):
        rgb = np.frombuffer(m.data.tobytes(), np.uint8).reshape(48, 64, 3)
        pixels = {
            "bgr8": rgb[:, :, ::-1],
            "rgba8": np.dstack([rgb, np.zeros((48, 64), np.uint8)]),
            "mono8": rgb[:, :, 0],
            "uyvy": np.dstack([np.full((48, 64), 128, np.uint8), rgb[:, :, 0]]),
        }
        if encoding == "jpeg":
            data = cv2.imencode(".jpg", rgb[:, :, ::-1])[1].tobytes()
            return ONE.compressed(time_of(m), "left_color_optical_frame", data, "rgb8; jpeg compressed bgr8")
        return ONE.image(time_of(m), "left_color_optical_frame", pixels[encoding], encoding)

    messages = swapped(left(), COLOR, change)
    film = ros.read(write_bag(tmp_path / "t.bag", messages), PARAMS)[0][0]
    data = film.images.color(3)
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)
    color = pictures()[3][1]
    np.testing.assert_allclose(found[:, :, 0], np.clip(color[:, :, 0], 16, 235), atol=30)
    if encoding in ("bgr8", "rgba8", "jpeg"):
        np.testing.assert_allclose(found, color, atol=30)
    if encoding == "jpeg":
        assert data == next(m for t, _, _, m in messages if t == COLOR and time_of(m) > 0.5).data.tobytes()


BESIDE = np.array([[1, 0, 0, 0.02], [0, 1, 0, 0.001], [0, 0, 1, 0.0], [0, 0, 0, 1.0]])
SMALL = np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]])
SENSOR = replace(LEFT, depth_view=DepthView(80, 60, SMALL, np.zeros(5), BESIDE))


def unaligned(types=ONE, **more):
    small = [(t, c, np.full((60, 80), 700, np.uint16)) for t, c, _ in pictures()]
    return camera_messages(types, SENSOR, small, "/left", aligned=False, **more)


def extrinsics_message():
    apart = ONE.Extrinsics(ONE.header(0, ""), BESIDE[:3, :3].T.ravel(), BESIDE[:3, 3].copy())
    return ("/left/extrinsics/depth_to_color", "Extrinsics", 0.0, apart)


def no_depth_frame(messages):
    return [m for m in messages if m[1] != "TFMessage" or m[3].transforms[0].header.frame_id == "world"]


def test_depth_of_another_camera_is_registered_where_its_place_is_known(tmp_path):
    by_tf = ros.read(write_bag(tmp_path / "a.bag", unaligned()), PARAMS)[0][0].camera
    by_topic = [*no_depth_frame(unaligned()), extrinsics_message()]
    by_extrinsics = ros.read(write_bag(tmp_path / "b.bag", by_topic), PARAMS)[0][0].camera
    for camera in (by_tf, by_extrinsics):
        assert (camera.width, camera.depth_view.width) == (64, 80)
        np.testing.assert_allclose(camera.depth_view.T_color_depth, BESIDE, atol=1e-12)
        np.testing.assert_allclose(camera.depth_view.K, SENSOR.depth_view.K)
    arrays, _ = read_sequence(tmp_path / "a.bag", PARAMS)
    image = ImageStack(arrays["depth"], arrays["depth_offsets"], 1, "depth").depth(0, 0)
    assert image.shape == (48, 64)
    assert np.median(image) == 700
    with pytest.raises(DataError, match="not registered to colour, and tf does not join"):
        ros.read(write_bag(tmp_path / "c.bag", no_depth_frame(unaligned())), PARAMS)


def sdk_messages(scale=0.00025):
    """As the RealSense SDK records: its own topics, whole units of depth, no tf, frame 0 everywhere."""
    color, depth = "/device_0/sensor_1/Color_0", "/device_0/sensor_0/Depth_0"
    to_color = np.linalg.inv(BESIDE)  # the colour stream is the reference of these
    found = [
        (f"{color}/info/camera_info", "CameraInfo", 0.0, ONE.info("0", LEFT, "Inverse Brown Conrady", np.zeros(5))),
        (f"{depth}/info/camera_info", "CameraInfo", 0.0, ONE.info("0", SENSOR.depth_view, "Brown Conrady")),
        (f"{color}/tf/0", "Transform", 0.0, ONE.transform(np.eye(4))),
        (f"{depth}/tf/0", "Transform", 0.0, ONE.transform(to_color)),
        ("/device_0/sensor_0/option/Depth_Units/value", "Float32", 0.0, ONE.Float32(scale)),
    ]
    for time, image, _ in pictures():
        found.append((f"{color}/image/data", "Image", time, ONE.image(time, "0", image, "rgb8")))
        units = np.full((60, 80), 2800, np.uint16)
        found.append((f"{depth}/image/data", "Image", time + 0.005, ONE.image(time + 0.005, "0", units, "mono16")))
        infrared = np.zeros((60, 80), np.uint8)
        found.append(
            ("/device_0/sensor_0/Infrared_1/image/data", "Image", time, ONE.image(time, "0", infrared, "mono8"))
        )
    return found


def test_a_recording_of_the_realsense_sdk(tmp_path):
    bag = write_bag(tmp_path / "take.bag", sdk_messages())
    with pytest.raises(DataError, match="no pose: tf does not join its frame 0") as refused:
        ros.read(bag, PARAMS)
    assert "a camera device_0" in refused.value.hint
    write_cameras(tmp_path, [replace(LEFT, name="device_0", depth_view=None)])
    camera = ros.read(bag, PARAMS)[0][0].camera
    assert camera.depth_scale == pytest.approx(0.00025)
    np.testing.assert_allclose(camera.T_world_camera, LEFT.T_world_camera)
    np.testing.assert_allclose(camera.depth_view.T_color_depth, BESIDE, atol=1e-7)
    arrays, warnings = read_sequence(bag, PARAMS)
    assert not warnings
    assert np.median(ImageStack(arrays["depth"], arrays["depth_offsets"], 1, "depth").depth(0, 0)) == 2800


def test_cameras_json_beside_a_bag_says_which_cameras_and_where(tmp_path):
    bag = write_bag(tmp_path / "t.bag", [*left(), *camera_messages(ONE, RIGHT, pictures(1), "/right")])
    write_cameras(tmp_path, [replace(RIGHT, T_world_camera=LEFT.T_world_camera)])
    films, notes = ros.read(bag, PARAMS)
    assert [film.camera.name for film in films] == ["right"]
    np.testing.assert_allclose(films[0].camera.T_world_camera, LEFT.T_world_camera)
    assert notes == ["camera left left out: cameras.json does not name it"]
    write_cameras(tmp_path, [replace(RIGHT, name="front"), LEFT])
    with pytest.raises(DataError, match="no camera front in the bag") as refused:
        ros.read(bag, PARAMS)
    assert "cameras of the bag are left, right" in refused.value.hint


def test_the_end_effector_is_a_frame_of_tf(tmp_path):
    arm, turned = np.eye(4), np.array([[0, -1, 0, 0.3], [1, 0, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1.0]])
    messages = left()
    for k in range(40):
        arm[0, 3] = 0.01 * k
        messages.append(("/tf", "TFMessage", k / 20, ONE.tf(("base_link", "flange", k / 20, arm.copy()))))
    static = ONE.tf(("world", "base_link", 0.0, turned), ("flange", "tool", 0.0, np.eye(4)))
    messages.append(("/tf_static", "TFMessage", 0.0, static))
    bag = write_bag(tmp_path / "t.bag", messages)
    assert ros.end_effector(bag, PARAMS) is None
    arrays, warnings = read_sequence(bag, IngestParams(tf_end_effector="tool", tool_point=(0.0, 0.05, 0.0)))
    assert not warnings
    along = 0.2 * np.arange(FRAMES) / 5
    np.testing.assert_allclose(arrays["end_effector"][:, 1], along, atol=1e-6)
    np.testing.assert_allclose(arrays["end_effector"][:, [0, 2]], [[0.25, 0.1]] * FRAMES, atol=1e-6)
    by_base = read_sequence(bag, IngestParams(tf_end_effector="tool", tf_world="base_link"))[0]
    np.testing.assert_allclose(by_base["end_effector"][:, 0], along, atol=1e-6)
    for name in ("gripper", "base_link"):
        with pytest.raises(
            DataError, match=f"frame {name} of tf: does not move, or nothing joins it to world; frames: base"
        ):
            ros.end_effector(bag, IngestParams(tf_end_effector=name))
    with pytest.raises(DataError, match="no frame mars; frames of tf"):
        ros.end_effector(bag, IngestParams(tf_end_effector="tool", tf_world="mars"))


def test_names_of_cameras_and_of_their_intrinsics():
    names = {
        "/camera/color/image_raw": "camera",
        "/camera/camera/aligned_depth_to_color/image_raw/compressedDepth": "camera",
        "/left/camera/depth/image_rect_raw": "left_camera",
        "/rgb/image_raw": "camera",
        "/depth_to_rgb/image_raw": "camera",
        "/kinect2/hd/image_color_rect": "kinect2_hd",
        "/front_rgb/image": "front",
        "/zed/zed_node/depth/depth_registered": "zed_zed_node",
        "/device_1/sensor_0/Depth_0/image/data": "device_1",
    }
    assert {topic: camera_name(topic) for topic in names} == names
    assert info_topic("/a/color/image_raw/compressed") == "/a/color/camera_info"
    assert info_topic("/device_0/sensor_1/Color_0/image/data") == "/device_0/sensor_1/Color_0/info/camera_info"


def test_coefficients_that_straighten_become_those_that_bend():
    inverse, K = (
        np.array([-0.055, 0.065, -0.0006, 0.0007, -0.021]),
        np.array([[390, 0, 320], [0, 390, 240], [0, 0, 1.0]]),
    )
    pixels = np.array([[20.0, 30], [320, 240], [600, 400]])
    bent = (pixels - K[:2, 2]) / 390
    r2, (x, y) = (bent**2).sum(1), bent.T
    radial = 1 + inverse[0] * r2 + inverse[1] * r2**2 + inverse[4] * r2**3
    straight = bent * radial[:, None] + np.column_stack(
        [2 * inverse[2] * x * y + inverse[3] * (r2 + 2 * x**2), 2 * inverse[3] * x * y + inverse[2] * (r2 + 2 * y**2)]
    )
    rays = straight_rays(pixels, K, _inverted(inverse, K, (640, 480)))
    np.testing.assert_allclose(rays[:, :2] * 390, straight * 390, atol=0.1)


def late(m):
    return replace(m, header=ONE.header(time_of(m) + 0.08, m.header.frame_id))


def half(m):
    return m if time_of(m) < 0.5 else None


def without(topic):
    return lambda: swapped(left(), topic, lambda m: None)


def changed(topic, change):
    return lambda: swapped(left(), topic, change)


def at_time(seconds, after):
    return lambda m: replace(m, header=replace(m.header, stamp=ONE.Time(seconds, 0))) if time_of(m) > after else m


def pixels(change, encoding="16UC1"):
    return changed(DEPTH, lambda m: ONE.image(time_of(m), m.header.frame_id, change(units_of(m)), encoding))


def data(topic, bytes_, form):
    return changed(topic, lambda m: ONE.compressed(time_of(m), m.header.frame_id, bytes_, form))


def info(**more):
    return changed("/left/color/camera_info", lambda m: replace(m, **more))


def moving():
    found = [m for m in left() if m[1] != "TFMessage"]
    for k in range(10):
        pose = LEFT.T_world_camera.copy()
        pose[0, 3] += 0.01 * k
        found.append(("/tf", "TFMessage", k / 5, ONE.tf(("world", "left_color_optical_frame", k / 5, pose))))
    return found


def tf_message(change):
    def messages():
        edge = ONE.tf(("world", "left_color_optical_frame", 0.0, LEFT.T_world_camera))
        change(edge.transforms[0].transform)
        return [*(m for m in left() if m[1] != "TFMessage"), ("/tf_static", "TFMessage", 0.0, edge)]

    return messages


def circle():
    edges = ONE.tf(("a", "world", 0.0, np.eye(4)), ("world", "a", 0.0, np.eye(4)))
    return [*left(), ("/tf", "TFMessage", 0.0, edges)]


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        (without(DEPTH), "no camera has depth; image topics: /left/color/image_raw"),
        (without(COLOR), "no camera has colour and depth; image topics: /left/aligned_depth"),
        (list, "no camera has colour and depth; image topics: none"),
        (without("/left/color/camera_info"), "no intrinsics: topic /left/color/camera_info is not in the bag"),
        (
            without("/tf_static"),
            "no pose: tf does not join its frame left_color_optical_frame to a world; frames: none",
        ),
        (changed(COLOR, lambda m: replace(m, encoding="bayer_rggb16")), "message 0: encoding 'bayer_rggb16'"),
        (changed(DEPTH, lambda m: replace(m, encoding="64FC1")), "message 0: encoding '64FC1' cannot be read"),
        (changed(DEPTH, lambda m: replace(m, height=9999)), "message 0: image of 64 x 9999 pixels"),
        (changed(DEPTH, lambda m: replace(m, width=0)), "message 0: image of 0 x 48 pixels"),
        (pixels(lambda units: units[:40]), "64 x 40, camera left 64 x 48"),
        (pixels(np.float32, "32FC1"), "are these millimetres"),
        (data(DEPTH, b"rvl" * 9, "16UC1; compressedDepth rvl"), "compressedDepth rvl"),
        (data(COLOR, b"junk", "jpeg"), "message 0: the image cannot be decoded"),
        (changed(DEPTH, late), "0 of 8 colour images (/left/color/image_raw, 1700000000.000"),
        (changed(DEPTH, at_time(2**31 - 1, 1.3)), "447483645.8 s ahead at message 7"),
        (changed(COLOR, at_time(5, 0.3)), "time stamps must increase: message 2 does not"),
        (info(K=np.zeros(9)), "the intrinsics are not set"),
        (info(distortion_model="equidistant"), "distortion 'equidistant' of 5"),
        (moving, "the camera moves by 7"),
        (tf_message(lambda t: setattr(t.rotation, "w", 3.0)), "not of length 1"),
        (tf_message(lambda t: setattr(t.translation, "x", np.nan)), "is not finite"),
        (circle, "tf goes in a circle"),
    ],
)
def test_what_is_wrong_with_a_bag_is_named(tmp_path, messages, message):
    bag = write_bag(tmp_path / "t.bag", messages())
    with pytest.raises(DataError) as refused:
        read_sequence(bag, PARAMS)
    assert message in str(refused.value)
    assert "t.bag" in str(refused.value)
    assert refused.value.hint


def test_topics_of_different_lengths_are_paired_as_far_as_they_go(tmp_path):
    arrays, _ = read_sequence(write_bag(tmp_path / "t.bag", swapped(left(), DEPTH, half)), PARAMS)
    assert len(arrays["time"]) == 3
    twice = [m for m in left() for _ in range(2 if m[0] == COLOR and round(time_of(m[3]), 3) == 0.4 else 1)]
    films, notes = ros.read(write_bag(tmp_path / "u.bag", twice), PARAMS)
    assert len(films[0].times) == FRAMES
    assert notes == [f"{tmp_path}/u.bag, topic {COLOR}: 1 of 9 images late or twice there, left out"]


@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
@pytest.mark.parametrize("share", [0.0, 0.0001, 0.5, 0.95])
def test_a_bag_that_was_cut_short_is_refused(tmp_path, suffix, share):
    write_bag(tmp_path / f"t{suffix}", left(ONE if suffix == ".bag" else TWO))
    file = next(p for p in tmp_path.rglob(f"*{suffix}") if p.is_file())
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    sequence = list_sequences(tmp_path)[0]
    with pytest.raises(DataError) as refused:
        read_sequence(sequence, PARAMS)
    assert "the bag cannot be read" in str(refused.value)
    assert str(sequence) in str(refused.value)


def test_junk_in_a_bag_never_ends_in_a_traceback(tmp_path):
    rng = np.random.default_rng(0)
    bag = write_bag(tmp_path / "t.bag", left())
    data = bytearray(bag.read_bytes())
    for k in range(8):
        spoilt = bytearray(data)
        for place in rng.integers(0, len(data), 200):
            spoilt[place] = rng.integers(256)
        (tmp_path / f"{k}.bag").write_bytes(spoilt)
        try:
            read_sequence(tmp_path / f"{k}.bag", PARAMS)
        except DataError:
            continue


def test_the_program_ends_with_3_and_writes_nothing(tmp_path):
    bag = tmp_path / "rec" / "t.bag"
    bag.parent.mkdir()
    write_bag(bag, left())
    bag.write_bytes(bag.read_bytes()[:20000])
    done = piegraph("ingest", "--run", tmp_path / "run", "--recording", bag.parent, check=3)
    assert "t.bag: the bag cannot be read" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "run").rglob("*.h5"))


def test_without_the_package_it_is_named(tmp_path, monkeypatch):
    bag = write_bag(tmp_path / "t.bag", left())
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingError, match="needs the package rosbags"):
        ros.read(bag, PARAMS)


def test_a_bag_is_unpacked_into_our_layout(tmp_path):
    write_bag(tmp_path / "rec" / "take.bag", sdk_messages())
    told = piegraph_json("unpack", tmp_path / "rec", "--out", tmp_path / "out")
    assert told["sequences"] == [{"sequence": "take", "images": FRAMES, "warnings": []}]
    (camera,) = read_cameras(tmp_path / "out" / "take", posed=False)
    np.testing.assert_allclose(camera.depth_view.T_color_depth, BESIDE, atol=1e-7)
    with pytest.raises(DataError, match="T_world_camera is missing"):
        read_cameras(tmp_path / "out" / "take")
    write_cameras(tmp_path / "out", [replace(camera, T_world_camera=LEFT.T_world_camera)])
    write_cameras(tmp_path / "rec", [replace(camera, T_world_camera=LEFT.T_world_camera)])
    ours, theirs = (read_sequence(p, PARAMS)[0] for p in (tmp_path / "out" / "take", tmp_path / "rec" / "take.bag"))
    for name in ("color", "depth", "K", "T_world_camera", "depth_scale"):
        np.testing.assert_array_equal(ours[name], theirs[name])
    np.testing.assert_allclose(ours["time"], theirs["time"], atol=2e-6)
    again = piegraph("unpack", tmp_path / "rec", "--out", tmp_path / "out", check=3)
    assert "out/take: is there already" in again.stderr
    write_bag(tmp_path / "more" / "other.bag", left())
    assert "which has left" in piegraph("unpack", tmp_path / "more", "--out", tmp_path / "out", check=3).stderr
    broken = swapped(left(), DEPTH, lambda m: replace(m, encoding="64FC1") if time_of(m) > 1 else m)
    write_bag(tmp_path / "bad" / "bad.bag", broken)
    piegraph("unpack", tmp_path / "bad", "--out", tmp_path / "new", check=3)
    assert not list((tmp_path / "new").iterdir())
