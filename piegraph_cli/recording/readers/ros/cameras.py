"""The camera of a pair of topics: intrinsics by camera_info, place by tf or by the cameras.json beside the bag."""

from dataclasses import replace
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, DepthView, check_lens
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.readers.ros.pictures import depth_scale
from piegraph_cli.recording.readers.ros.survey import Survey, Topic
from piegraph_cli.recording.readers.ros.topics import Pair, info_topic, stream_prefix
from piegraph_cli.recording.readers.ros.transforms import Transforms

WORLDS = ("world", "map", "base_link", "base")
"""Frames of tf that are taken for the world where the setting names none, the first that there is."""
AT_REST, TURNED = 0.01, 1.0
"""Metres and degrees that a camera may move in a sequence."""
LOOKS = 20
"""Times at which it is seen whether it moves."""
PINHOLE = ("plumb_bob", "rational_polynomial", "brown_conrady", "modified_brown_conrady", "none", "")
COEFFICIENTS = (4, 5, 8, 12, 14)


def world_of(transforms: Transforms, params: ReadParams) -> str | None:
    """The frame of tf that is the world: the one that the setting names, or the first of `WORLDS` that there is."""
    if params.tf_world is None:
        return next((name for name in WORLDS if name in transforms.frames), None)
    name = params.tf_world.lstrip("/")
    if name not in transforms.frames:
        found = f"frames of tf: {', '.join(transforms.frames) or 'none'}"
        raise DataError(f"no frame {name}; {found}", transforms.where, "correct ingest.tf_world")
    return name


def camera_of(
    pair: Pair, survey: Survey, transforms: Transforms, given: Camera | None, params: ReadParams, posed: bool
) -> Camera:
    """The camera of two topics, as `given` where cameras.json has it, else by the bag. Raises `DataError` for what lacks."""
    scale = survey.units.get(stream_prefix(pair.depth.name).rpartition("/")[0], depth_scale(pair.depth.encoding))
    if given is not None and (given.depth_view or pair.registered):
        return replace(given, depth_scale=_scale(pair, scale, given))
    width, height, K, distortion = (
        intrinsics(pair.color, survey) if given is None else (given.width, given.height, given.K, given.distortion)
    )
    pose = given.T_world_camera if given is not None else _pose(pair, transforms, params, posed)
    view = None if pair.registered else _depth_view(pair, survey, transforms)
    return Camera(pair.name, width, height, K, distortion, pose, _scale(pair, scale, given), view)


def _scale(pair: Pair, by_bag: float, given: Camera | None) -> float:
    """Metres per unit of depth: what the bag says, or cameras.json of whole numbers whose unit a bag does not tell."""
    told = pair.depth.encoding.startswith("32FC1") or pair.depth.name.endswith("/image/data")
    return by_bag if told or given is None else given.depth_scale


def intrinsics(topic: Topic, survey: Survey) -> tuple[int, int, np.ndarray, np.ndarray]:
    """Width, height, K [3, 3] and distortion of the camera of a topic. Raises `DataError` where the bag lacks them."""
    name = info_topic(topic.name)
    where = f"{survey.bag}, topic {name}"
    info = survey.infos.get(name)
    if info is None:
        message = f"no intrinsics: topic {name} is not in the bag"
        raise DataError(message, f"{survey.bag}, topic {topic.name}", "record it, or give the camera in cameras.json")
    K = np.array(_of(info, "k"), float).reshape(3, 3)
    distortion, model = np.array(_of(info, "d"), float), info.distortion_model.lower().replace(" ", "_")
    if "rect" in topic.name.replace("rectilinear", ""):
        K, distortion = np.array(_of(info, "p"), float).reshape(3, 4)[:, :3], np.zeros(5)
    if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0 or not np.isfinite(distortion).all():
        raise DataError("the intrinsics are not set", where, "calibrate the camera, or give it in cameras.json")
    if not distortion.any():
        distortion = np.zeros(5)
    elif model == "inverse_brown_conrady":
        distortion = _inverted(distortion[:5], K, (info.width, info.height))
    elif model not in PINHOLE or len(distortion) not in COEFFICIENTS:
        message = f"distortion {model!r} of {len(distortion)} numbers is not known here"
        raise DataError(message, where, "give the camera in cameras.json with a model of OpenCV")
    distortion, size = np.pad(distortion, (0, max(0, 5 - len(distortion)))), (int(info.width), int(info.height))
    check_lens(K, distortion, size, "the distortion", where)
    return *size, K, distortion


def _of(info: Any, name: str) -> Any:
    """A field of CameraInfo: in capitals in ROS 1."""
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def _inverted(inverse: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Coefficients [5] that bend as those of a RealSense colour camera straighten, fitted over the image."""
    columns, rows = np.meshgrid(np.linspace(0, size[0], 25), np.linspace(0, size[1], 19))
    bent = np.column_stack([columns.ravel() - K[0, 2], rows.ravel() - K[1, 2]]) / K[[0, 1], [0, 1]]
    straight = bent + _terms(bent) @ inverse
    return np.linalg.lstsq(_terms(straight).reshape(-1, 5), (bent - straight).ravel(), rcond=None)[0]


def _terms(points: np.ndarray) -> np.ndarray:
    """What k1, k2, p1, p2, k3 are multiplied with to move points [N, 2]: [N, 2, 5]."""
    x, y = points.T
    r2 = x**2 + y**2
    columns = [
        points.T * r2,
        points.T * r2**2,
        (2 * x * y, r2 + 2 * y**2),
        (r2 + 2 * x**2, 2 * x * y),
        points.T * r2**3,
    ]
    return np.stack([np.array(column).T for column in columns], axis=-1)


def _pose(pair: Pair, transforms: Transforms, params: ReadParams, needed: bool) -> np.ndarray:
    """T_world_camera [4, 4] of a camera at rest, by tf; NaN where tf does not have it and it is not `needed`."""
    world, where = world_of(transforms, params), f"{pair.color.bag}, camera {pair.name}"
    times = np.linspace(pair.color.times.min(), pair.color.times.max(), LOOKS)
    poses = transforms.poses(world, pair.color.frame, times) if world else None
    if poses is None and not needed:
        return np.full((4, 4), np.nan)
    if poses is None:
        frames = ", ".join(transforms.frames) or "none"
        message = f"no pose: tf does not join its frame {pair.color.frame or '(none)'} to {world or 'a world'}"
        hint = f"name the world with ingest.tf_world, or put cameras.json beside the bag with a camera {pair.name}; "
        hint += "`piegraph unpack`, then `piegraph calibrate` finds poses by a board"
        raise DataError(f"{message}; frames: {frames}", where, hint)
    moved = np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1).max()
    turns = np.einsum("tij,ij->t", poses[:, :3, :3], poses[0, :3, :3])
    turned = np.degrees(np.arccos(((turns - 1) / 2).clip(-1, 1))).max()
    if moved > AT_REST or turned > TURNED:
        message = f"the camera moves by {moved * 1000:.0f} mm and {turned:.1f}° in {world}"
        hint = "cameras must be at rest: name those that are in cameras.json, others are left out"
        raise DataError(message, where, hint)
    return poses[0]


def _depth_view(pair: Pair, survey: Survey, transforms: Transforms) -> DepthView:
    """The camera that saw depth which is not registered to colour."""
    width, height, K, distortion = intrinsics(pair.depth, survey)
    color, depth = stream_prefix(pair.color.name), stream_prefix(pair.depth.name)
    apart: np.ndarray | None
    if color in survey.places and depth in survey.places:
        apart = survey.places[color] @ np.linalg.inv(survey.places[depth])
    else:
        joined = transforms.poses(pair.color.frame, pair.depth.frame, pair.color.times[:1])
        named = [m for name, m in survey.aside.items() if name.endswith("depth_to_color") and _owner(name, pair)]
        apart = joined[0] if joined is not None else named[0] if named else None
    if apart is None:
        message = f"depth ({pair.depth.name}) is not registered to colour, and tf does not join their frames"
        hint = "record aligned depth, tf_static, or give depth_K and T_color_depth in cameras.json"
        raise DataError(message, f"{survey.bag}, camera {pair.name}", hint)
    return DepthView(width, height, K, np.pad(distortion, (0, 14))[:14], apart)


def _owner(topic: str, pair: Pair) -> bool:
    """Whether a topic is below the same namespace as the camera's depth."""
    return pair.depth.name.startswith(topic.partition("/extrinsics/")[0] + "/")
