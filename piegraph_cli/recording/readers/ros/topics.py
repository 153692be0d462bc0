"""Which topics of a bag are one camera: its colour, its depth, and whether that is registered to colour."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from piegraph_cli.errors import DataError
from piegraph_cli.recording.readers.ros.pictures import is_depth
from piegraph_cli.recording.readers.ros.survey import Topic

TRANSPORTS = ("compressed", "compressedDepth")
WORDS = {
    "color",
    "colour",
    "rgb",
    "depth",
    "aligned",
    "to",
    "registered",
    "image",
    "raw",
    "rect",
    "rectified",
    "sw",
    "hw",
}
"""What names of image topics are made of, beside the camera's."""
LOOKS = ("color", "colour", "rgb", "depth", "image", "aligned", "registered")
IGNORED = re.compile(r"infra|(^|[/_])ir([/_]|$)|confidence|theora|ffmpeg|disparity|normals|heatmap|mask", re.IGNORECASE)
REGISTERED = re.compile(r"aligned|registered|depth_to_(color|rgb)")
SDK = re.compile(r"(/device_\d+)/sensor_\d+/(Color|Depth)_\d+/image/data")


@dataclass(frozen=True)
class Pair:
    """The topics of one camera."""

    name: str
    color: Topic
    depth: Topic
    registered: bool
    """Whether depth is, by its name or its frame, registered to colour."""


def pairs_of(images: Iterable[Topic], where: str) -> tuple[list[Pair], list[str]]:
    """The cameras among the topics of a bag, sorted by name, and notes of topics without a partner.

    Raises `DataError` where no camera has colour and depth.
    """
    groups: dict[str, list[Topic]] = {}
    for topic in images:
        if not IGNORED.search(topic.name) and topic.stamps:
            groups.setdefault(camera_name(topic.name), []).append(topic)
    pairs, alone = [], []
    for name, topics in sorted(groups.items()):
        depth = [topic for topic in topics if _shows_depth(topic)]
        color = [topic for topic in topics if not _shows_depth(topic)]
        if color and depth:
            pairs.append(_pair(name, min(color, key=_rank_color), depth))
        else:
            alone += [topic.name for topic in topics]
    if not pairs:
        found = f"image topics: {', '.join(sorted(alone)) or 'none'}"
        kind = "depth" if alone and not any(_shows_depth(t) for g in groups.values() for t in g) else "colour and depth"
        hint = "record the topics of colour and depth, and camera_info beside them (docs/formats.md)"
        raise DataError(f"no camera has {kind}; {found}", where, hint)
    return pairs, [f"{where}: topic {name} left out: no colour and depth there" for name in sorted(alone)]


def _pair(name: str, color: Topic, depth: list[Topic]) -> Pair:
    best = min(depth, key=lambda topic: (not _registered(topic, color), topic.compressed, len(topic.name), topic.name))
    return Pair(name, color, best, _registered(best, color))


def _registered(depth: Topic, color: Topic) -> bool:
    if SDK.fullmatch(depth.name):
        return False
    return bool(REGISTERED.search(depth.name)) or bool(depth.frame and depth.frame == color.frame)


def _rank_color(topic: Topic) -> tuple[bool, bool, int, str]:
    return topic.compressed, "raw" not in topic.name, len(topic.name), topic.name


def _shows_depth(topic: Topic) -> bool:
    sdk = SDK.fullmatch(topic.name)
    return sdk[2] == "Depth" if sdk else "depth" in topic.name.lower() or is_depth(topic.encoding)


def camera_name(topic: str) -> str:
    """What a camera is called, from the topic of its images: `/left/camera/color/image_raw` is of `left_camera`."""
    sdk = SDK.fullmatch(topic)
    if sdk:
        return sdk[1][1:]
    parts = [part for part in topic.split("/") if part and part not in TRANSPORTS]
    at = next((k for k, part in enumerate(parts) if any(look in part.lower() for look in LOOKS)), len(parts) - 1)
    rest = "_".join(word for word in parts[at].split("_") if word.lower() not in WORDS)
    names = [*parts[:at], *([rest] if rest else [])]
    return "_".join(name for k, name in enumerate(names) if k == 0 or name != names[k - 1]) or "camera"


def info_topic(topic: str) -> str:
    """Where the intrinsics of an image topic are published."""
    if SDK.fullmatch(topic):
        return topic.removesuffix("/image/data") + "/info/camera_info"
    parts = topic.split("/")
    return "/".join([*(parts[:-2] if parts[-1] in TRANSPORTS else parts[:-1]), "camera_info"])


def stream_prefix(topic: str) -> str:
    """The prefix of a stream of the RealSense SDK: what is before `/image/data`."""
    return topic.removesuffix("/image/data")
