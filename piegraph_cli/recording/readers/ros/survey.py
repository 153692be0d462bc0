"""What a bag holds, found by reading through it once: images by topic with their times, intrinsics, transforms."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.readers.ros.bag import messages
from piegraph_cli.recording.readers.ros.transforms import Transforms, pose_of

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, EXTRINSICS = "sensor_msgs/msg/CameraInfo", "realsense2_camera_msgs/msg/Extrinsics"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
SDK_UNITS, SDK_POSE = re.compile(r"/sensor_\d+/option/Depth[_ ]Units/value$"), re.compile(r"/tf/\d+$")
"""Topics of the RealSense SDK's own recordings: metres a unit of depth, and a stream's place."""
LATEST = 1e11
"""Seconds that no clock shows."""


@dataclass
class Topic:
    """The images of one topic."""

    bag: Path
    name: str
    frame: str
    """Of the camera that took them."""
    encoding: str
    """Of the first of them, or its format where it is compressed."""
    compressed: bool
    stamps: list[float] = field(default_factory=list)
    """When each was taken, by its header, s."""
    received: list[float] = field(default_factory=list)
    """When each was recorded, s."""

    @property
    def times(self) -> np.ndarray:
        """Seconds by the headers; where these have none, those of recording."""
        return np.array(self.stamps if any(self.stamps) else self.received)


@dataclass
class Survey:
    """What a bag holds."""

    bag: Path
    transforms: Transforms
    images: dict[str, Topic] = field(default_factory=dict)
    infos: dict[str, Any] = field(default_factory=dict)
    """The first CameraInfo of each topic."""
    units: dict[str, float] = field(default_factory=dict)
    """Metres per unit of depth by the sensor's prefix, in recordings of the RealSense SDK."""
    places: dict[str, np.ndarray] = field(default_factory=dict)
    """[4, 4] of points of the device's reference to points of a stream, by the stream's prefix; there too."""
    aside: dict[str, np.ndarray] = field(default_factory=dict)
    """[4, 4] of points of depth to points of colour, by topic, from RealSense nodes."""


def survey(bag: Path) -> Survey:
    """What a bag holds; one that has not changed since is not read again in this process."""
    parts = sorted(bag.iterdir()) if bag.is_dir() else [bag]
    return _survey(bag, tuple((part.stat().st_size, part.stat().st_mtime_ns) for part in parts))


@lru_cache(maxsize=8)
def _survey(bag: Path, stamps: tuple[tuple[int, int], ...]) -> Survey:
    found = Survey(bag, Transforms(str(bag)))
    for topic, kind, received, message in messages(bag, _wanted):
        take = TAKERS.get(kind)
        if take:
            take(found, topic, received, message)
    return found


def _wanted(topic: str, kind: str) -> bool:
    if kind == "std_msgs/msg/Float32":
        return bool(SDK_UNITS.search(topic))
    if kind == "geometry_msgs/msg/Transform":
        return bool(SDK_POSE.search(topic))
    return kind in TAKERS


def _seconds(stamp: Any) -> float:
    return stamp.sec + stamp.nanosec * 1e-9


def _take_image(found: Survey, topic: str, received: float, message: Any) -> None:
    compressed = hasattr(message, "format")
    if topic not in found.images:
        encoding = message.format if compressed else message.encoding
        found.images[topic] = Topic(found.bag, topic, message.header.frame_id.lstrip("/"), encoding, compressed)
    images = found.images[topic]
    images.stamps.append(_seconds(message.header.stamp))
    images.received.append(received)
    if not 0 <= images.stamps[-1] < LATEST:
        where = f"{found.bag}, topic {topic}, message {len(images.stamps) - 1}"
        raise DataError(f"its header says {images.stamps[-1]:.6g} s", where, "record with a clock that is set")


def _take_info(found: Survey, topic: str, received: float, message: Any) -> None:
    found.infos.setdefault(topic, message)


def _take_transforms(found: Survey, topic: str, received: float, message: Any) -> None:
    for one in message.transforms:
        where = f"{found.bag}, topic {topic}, frame {one.child_frame_id}"
        pose = pose_of(one.transform, where)
        found.transforms.add(one.header.frame_id, one.child_frame_id, _seconds(one.header.stamp), pose)


def _take_units(found: Survey, topic: str, received: float, message: Any) -> None:
    found.units[topic.partition("/option/")[0]] = float(message.data)


def _take_place(found: Survey, topic: str, received: float, message: Any) -> None:
    found.places[topic.partition("/tf/")[0]] = pose_of(message, f"{found.bag}, topic {topic}")


def _take_aside(found: Survey, topic: str, received: float, message: Any) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(message.rotation, (3, 3)).T  # columns first
    matrix[:3, 3] = message.translation
    found.aside[topic] = matrix


TAKERS: dict[str, Callable[[Survey, str, float, Any], None]] = {
    IMAGE: _take_image,
    COMPRESSED: _take_image,
    INFO: _take_info,
    **dict.fromkeys(TRANSFORMS, _take_transforms),
    "std_msgs/msg/Float32": _take_units,
    "geometry_msgs/msg/Transform": _take_place,
    EXTRINSICS: _take_aside,
}
"""What is done with a message, by its type."""
