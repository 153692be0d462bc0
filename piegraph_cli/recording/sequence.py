"""One recorded sequence, checked, on one clock, as arrays."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.images import join_images
from piegraph_cli.recording.layout import frame_files, read_cameras, read_color, read_depth, read_times
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.recording.timing import align_frames


def read_sequence(
    folder: Path, params: IngestParams, progress: Callable[[Iterable[int]], Iterable[int]] = iter
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Cameras, times and encoded images of one sequence folder as the datasets of a frames artifact, and warnings.

    Raises `DataError` naming file, camera and frame.
    """
    cameras = read_cameras(folder)
    sizes = {f"{camera.name} {camera.width} x {camera.height}" for camera in cameras}
    if len({(camera.width, camera.height) for camera in cameras}) > 1:
        raise DataError(
            f"cameras differ in image size: {', '.join(sorted(sizes))}", str(folder), "record all at one size"
        )
    times = {camera.name: read_times(folder, camera) for camera in cameras}
    files = {camera.name: frame_files(folder, camera) for camera in cameras}
    _check_counts(folder, times, files)
    time, source = align_frames(times, params.fps, params.max_skew, str(folder))
    if len(time) < 2:
        raise DataError("one frame: nothing can be seen to move", str(folder), "record longer, or remove this sequence")
    images, blind = _read_images(cameras, files, source, progress)
    _check_depth(folder, cameras, blind)
    arrays = images | {
        "time": time,
        "source_frame": source,
        "camera_name": np.array([c.name for c in cameras]),
        "image_size": np.array([[c.width, c.height] for c in cameras]),
        "K": np.array([c.K for c in cameras]),
        "distortion": np.array([c.distortion for c in cameras]),
        "depth_scale": np.array([c.depth_scale for c in cameras]),
        "T_world_camera": np.array([c.T_world_camera for c in cameras]),
    }
    warnings = []
    if blind.any():
        frame, c = np.argwhere(blind)[0]
        warnings.append(f"{blind.sum()} depth images without a reading, first: camera {cameras[c].name}, frame {frame}")
    return arrays, warnings


def _read_images(
    cameras: list[Camera],
    files: dict[str, list[tuple[Path, Path]]],
    source: np.ndarray,
    progress: Callable[[Iterable[int]], Iterable[int]],
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Encoded images of the frames `source` [F, C], and which depth images [F, C] have no reading."""
    color, depth, blind = [], [], np.zeros(source.shape, bool)
    for frame in progress(range(len(source))):
        for c, camera in enumerate(cameras):
            color_file, depth_file = files[camera.name][source[frame, c]]
            color.append(read_color(color_file, camera))
            image = read_depth(depth_file, camera)
            blind[frame, c] = not image.any()
            depth.append(depth_file.read_bytes())
    data, offsets = join_images(color)
    depth_data, depth_offsets = join_images(depth)
    names = ("color", "color_offsets", "depth", "depth_offsets")
    return dict(zip(names, (data, offsets, depth_data, depth_offsets), strict=True)), blind


def _check_counts(folder: Path, times: dict[str, np.ndarray], files: dict[str, list]) -> None:
    for name, stamps in times.items():
        if len(stamps) != len(files[name]):
            raise DataError(
                f"camera {name} has {len(files[name])} frames and {len(stamps)} time stamps",
                str(folder / name),
                "each frame needs one line of timestamps.txt",
            )
    counts = {name: len(f) for name, f in files.items()}
    if len(set(counts.values())) > 1:
        raise DataError(
            "cameras differ in frames: " + ", ".join(f"{name} {count}" for name, count in counts.items()),
            str(folder),
            "remove the frames that the others lack, from images and timestamps.txt",
        )
    if not any(counts.values()):
        raise DataError("no frames", str(folder), "see docs/formats.md for the layout")


def _check_depth(folder: Path, cameras: list[Camera], blind: np.ndarray) -> None:
    for c in np.flatnonzero(blind.all(0)):
        raise DataError(
            f"every depth image of camera {cameras[c].name} is zero, from frame 0 on",
            str(folder / cameras[c].name / "depth"),
            "check that depth was recorded, or remove the camera from cameras.json",
        )
