"""Bags of ROS 1 (`.bag`) and ROS 2 (`.db3`, `.mcap`), those of the RealSense SDK among them, read image by image.

A bag is a sequence, or a folder of bags with one camera each. Images are paired by the times in their headers.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.end_effector import EndEffectorPath, checked
from piegraph_cli.recording.film import Film
from piegraph_cli.recording.layout import cameras_file, read_cameras
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.readers.ros.bag import Stream, bags_of
from piegraph_cli.recording.readers.ros.cameras import camera_of, world_of
from piegraph_cli.recording.readers.ros.pictures import depth_units, encoded_color
from piegraph_cli.recording.readers.ros.survey import Survey, Topic, survey
from piegraph_cli.recording.readers.ros.topics import Pair, pairs_of
from piegraph_cli.recording.timing import check_times, matched

SKEW = 0.02
"""Seconds that colour and depth of a frame may be apart."""
FEW = 0.02
"""Share of a topic's images that may be late, or twice there: they are left out."""


@dataclass(frozen=True)
class BagImages:
    """The images of one camera in a bag."""

    camera: Camera
    color_stream: Stream
    depth_stream: Stream
    messages: np.ndarray
    """[image, 2] the messages of colour and depth."""

    def color(self, k: int) -> bytes:
        """A colour image as it is in the bag if it is compressed there, else as JPEG."""
        number, stream = int(self.messages[k, 0]), self.color_stream
        data, size = encoded_color(stream[number], stream.where(number))
        self._check_size(size, (self.camera.width, self.camera.height), stream.where(number))
        return data

    def depth(self, k: int) -> tuple[np.ndarray, bytes | None]:
        """A depth image uint16 [H, W] in the camera's units."""
        number, stream = int(self.messages[k, 1]), self.depth_stream
        image = depth_units(stream[number], stream.where(number))
        view = self.camera.depth_view or self.camera
        self._check_size(image.shape[1::-1], (view.width, view.height), stream.where(number))
        return image, None

    def mask(self, k: int) -> np.ndarray | None:
        """None."""
        return None

    def _check_size(self, got: tuple[int, ...], expected: tuple[int, int], where: str) -> None:
        if tuple(got) != expected:
            message = f"image is {got[0]} x {got[1]}, camera {self.camera.name} {expected[0]} x {expected[1]}"
            hint = "correct camera_info or cameras.json; depth of another size is not registered to colour"
            raise DataError(message, where, hint)


def read(folder: Path, params: ReadParams, posed: bool = True) -> tuple[list[Film], list[str]]:
    """The films of a sequence, one a camera, and warnings. Without `posed` a pose that nothing tells is NaN."""
    surveys = [survey(bag) for bag in bags_of(folder)]
    if not surveys:
        raise DataError("no bag in this folder", str(folder), "put .bag, .db3 or .mcap files there")
    transforms = surveys[0].transforms.merged(s.transforms for s in surveys[1:])
    given = _given(folder)
    films, notes = [], []
    for found in surveys:
        pairs, alone = pairs_of(found.images.values(), str(found.bag))
        notes += alone
        for pair in _named(pairs, found, surveys):
            if given is None or pair.name in given:
                camera = camera_of(pair, found, transforms, given[pair.name] if given else None, params, posed)
                film, told = _film(camera, pair)
                films.append(film)
                notes += told
            else:
                notes.append(f"camera {pair.name} left out: cameras.json does not name it")
    missing = sorted(set(given or {}) - {film.camera.name for film in films})
    if missing or not films:
        known = ", ".join(
            sorted({p.name for s in surveys for p in _named(pairs_of(s.images.values(), "")[0], s, surveys)})
        )
        hint = f"cameras of the bag are {known}: call them so in cameras.json, or take those out that it lacks"
        raise DataError(f"no camera {', '.join(missing)} in the bag", str(cameras_file(folder)), hint)
    return sorted((_same_lens(film, films) for film in films), key=lambda film: film.camera.name), notes


def end_effector(folder: Path, params: ReadParams) -> EndEffectorPath | None:
    """The path of the frame of tf that the setting names, in the world; None where it names none."""
    if params.tf_end_effector is None:
        return None
    surveys = [survey(bag) for bag in bags_of(folder)]
    transforms = surveys[0].transforms.merged(s.transforms for s in surveys[1:])
    world, where = world_of(transforms, params), f"{folder}, frame {params.tf_end_effector} of tf"
    frames = ", ".join(transforms.frames) or "none"
    times = transforms.times(world, params.tf_end_effector) if world else np.zeros(0)
    poses = transforms.poses(world, params.tf_end_effector, times) if world else None
    if poses is None or len(times) < 2:
        message = f"does not move, or nothing joins it to {world or 'a world'}; frames: {frames}"
        raise DataError(message, where, "correct ingest.tf_end_effector and ingest.tf_world")
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return checked(EndEffectorPath(times, poses[:, :3, 3], turns, where=where, item="transform"))


def _given(folder: Path) -> dict[str, Camera] | None:
    """The cameras of a cameras.json beside the bag by name; None where there is none."""
    beside = (folder / "cameras.json", folder.parent / "cameras.json")
    return {c.name: c for c in read_cameras(folder)} if any(path.is_file() for path in beside) else None


def _named(pairs: list[Pair], found: Survey, surveys: list[Survey]) -> list[Pair]:
    """Pairs with names that are theirs alone: of several bags each is called after its bag."""
    if len(surveys) == 1:
        return pairs
    name = found.bag.stem if found.bag.is_file() else found.bag.name
    return [replace(pair, name=name if len(pairs) == 1 else f"{name}_{pair.name}") for pair in pairs]


def _film(camera: Camera, pair: Pair) -> tuple[Film, list[str]]:
    """One camera's film: colour and depth that were taken at the same time, and what was left out."""
    (color, late), (depth, later) = _rising(pair.color), _rising(pair.depth)
    notes = late + later
    times, others = pair.color.times[color], pair.depth.times[depth]
    for topic, stamps in ((pair.color, times), (pair.depth, others)):
        notes += check_times(stamps, f"{topic.bag}, topic {topic.name}", "message", 0)
    kept, partner = matched(times, others, SKEW)
    if len(kept) < min(len(times), len(others)) / 2:
        message = (
            f"{len(kept)} of {len(times)} colour images ({pair.color.name}, {times[0]:.3f} to {times[-1]:.3f} s) have depth "
            f"within {SKEW:g} s; {len(others)} depth images ({pair.depth.name}, {others[0]:.3f} to {others[-1]:.3f} s)"
        )
        raise DataError(message, f"{pair.color.bag}, camera {camera.name}", "record both with one clock, at one rate")
    if len(kept) < (1 - FEW) * min(len(times), len(others)):
        count = min(len(times), len(others)) - len(kept)
        notes.append(
            f"camera {camera.name}: {count} images of colour or depth without a partner within {SKEW:g} s left out"
        )
    numbers = np.column_stack([color[kept], depth[partner]])
    images = BagImages(
        camera, Stream(pair.color.bag, pair.color.name), Stream(pair.depth.bag, pair.depth.name), numbers
    )
    return Film(camera, times[kept], images, color[kept].astype(np.int64)), notes


def _rising(topic: Topic) -> tuple[np.ndarray, list[str]]:
    """The images of a topic that are later than all before them; all, to be refused, where that leaves many out."""
    times = topic.times
    before = np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]])
    kept = np.flatnonzero(times > before)
    late = len(times) - len(kept)
    if not late:
        return kept, []
    if late > max(1, FEW * len(times)):
        return np.arange(len(times)), []
    return kept, [f"{topic.bag}, topic {topic.name}: {late} of {len(times)} images late or twice there, left out"]


def _same_lens(film: Film, films: list[Film]) -> Film:
    """The film with as many coefficients of distortion as the camera that has most."""
    longest = max(len(other.camera.distortion) for other in films)
    padded = np.pad(film.camera.distortion, (0, longest - len(film.camera.distortion)))
    return replace(film, camera=replace(film.camera, distortion=padded))
