"""Small bags, as robots and RealSense cameras write them, for the tests to read and to break."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from piegraph_cli.recording.camera import Camera

START = 1_700_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
for _store in (ROS1, ROS2):
    _definition = "std_msgs/Header header\nfloat64[9] rotation\nfloat64[3] translation"
    _store.register(get_types_from_msg(_definition, "realsense2_camera_msgs/msg/Extrinsics"))
Message = tuple[str, str, float, Any]
"""Topic, type, time after the start (s), content."""


class Types:
    """Messages of one of the two, by the short names of their types."""

    def __init__(self, store: Any):
        self.store = store

    def __getattr__(self, name: str) -> Any:
        return next(t for full, t in self.store.types.items() if full.endswith(f"/{name}"))

    def header(self, time: float, frame: str) -> Any:
        stamp = self.Time(int(START + time // 1), round(time % 1 * 1e9))
        return self.Header(0, stamp, frame) if self.store is ROS1 else self.Header(stamp, frame)

    def image(self, time: float, frame: str, pixels: np.ndarray, encoding: str) -> Any:
        height, width = pixels.shape[:2]
        data = np.frombuffer(pixels.tobytes(), np.uint8)
        return self.Image(self.header(time, frame), height, width, encoding, 0, len(data) // height, data)

    def compressed(self, time: float, frame: str, data: bytes, form: str) -> Any:
        return self.CompressedImage(self.header(time, frame), form, np.frombuffer(data, np.uint8))

    def info(self, frame: str, camera: Any, model: str = "plumb_bob", distortion: Sequence[float] | None = None) -> Any:
        d = np.array(camera.distortion if distortion is None else distortion, float)
        p = np.column_stack([camera.K, np.zeros(3)]).ravel()
        roi = self.RegionOfInterest(0, 0, 0, 0, False)
        header = self.header(0, frame)
        return self.CameraInfo(
            header, camera.height, camera.width, model, d, camera.K.ravel(), np.eye(3).ravel(), p, 0, 0, roi
        )

    def transform(self, pose: np.ndarray) -> Any:
        q = Rotation.from_matrix(pose[:3, :3]).as_quat()
        return self.Transform(self.Vector3(*pose[:3, 3].tolist()), self.Quaternion(*q.tolist()))

    def tf(self, *edges: tuple[str, str, float, np.ndarray]) -> Any:
        stamped = [self.TransformStamped(self.header(t, a), b, self.transform(pose)) for a, b, t, pose in edges]
        return self.TFMessage(stamped)


def write_bag(path: Path, messages: Sequence[Message], compress: bool = False) -> Path:
    """Write messages in the format that the path's suffix says; .db3 and .mcap are a folder with that file in it."""
    path.parent.mkdir(exist_ok=True)
    if path.suffix == ".bag":
        _write1(path, messages, compress)
        return path
    folder = path.with_suffix("")
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    writer = Writer2(folder, version=8, storage_plugin=plugin)
    if compress:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    _write(writer, messages, ROS2, ROS2.serialize_cdr)
    return folder


def _write1(path: Path, messages: Sequence[Message], compress: bool) -> None:
    writer = Writer1(path)
    if compress:
        writer.set_compression(Writer1.CompressionFormat.LZ4)
    _write(writer, messages, ROS1, ROS1.serialize_ros1)


def _write(writer: Any, messages: Sequence[Message], store: Any, serialize: Callable[..., Any]) -> None:
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, time, message in messages:
            full = type(message).__msgtype__
            assert full.endswith(kind)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, full, typestore=store)
            writer.write(connections[topic], int((START + time) * 1e9), serialize(message, full))


def camera_messages(
    types: Types,
    camera: Camera,
    frames: Sequence[tuple[float, np.ndarray, np.ndarray]],
    base: str = "/camera",
    aligned: bool = True,
) -> list[Message]:
    """What a RealSense node publishes of a camera: colour, depth (mm), intrinsics and its place in `world`."""
    frame = f"{base[1:]}_color_optical_frame"
    depth_frame = frame if aligned else f"{base[1:]}_depth_optical_frame"
    place = f"{base}/aligned_depth_to_color" if aligned else f"{base}/depth"
    view = camera if aligned or camera.depth_view is None else camera.depth_view
    found: list[Message] = [("/tf_static", "TFMessage", 0.0, types.tf(("world", frame, 0.0, camera.T_world_camera)))]
    if not aligned and camera.depth_view is not None:
        edge = (frame, depth_frame, 0.0, camera.depth_view.T_color_depth)
        found.append(("/tf_static", "TFMessage", 0.0, types.tf(edge)))
    found.append((f"{base}/color/camera_info", "CameraInfo", 0.0, types.info(frame, camera)))
    found.append((f"{place}/camera_info", "CameraInfo", 0.0, types.info(depth_frame, view)))
    for time, color, depth in frames:
        image = types.image(time, frame, color, "rgb8")
        found.append((f"{base}/color/image_raw", "Image", time + 0.03, image))
        found.append((f"{place}/image_raw", "Image", time + 0.05, types.image(time, depth_frame, depth, "16UC1")))
    return found
