"""Calibrated cameras that run, for looks: what they see now, with their poses from a recording's cameras.json."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from piegraph_cli.capture.cameras import Mode, choose, connected
from piegraph_cli.capture.folder import names_of
from piegraph_cli.capture.station import Station
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.film import Scene
from piegraph_cli.recording.layout import read_cameras, read_cameras_file

SAME = 0.02
"""Share by which a device's focal lengths may differ from those of its calibration."""


class LiveCameras:
    """Cameras that deliver until the context ends."""

    def __init__(self, station: Station, cameras: list[Camera]):
        self.station, self.cameras = station, cameras

    def __enter__(self) -> "LiveCameras":
        self.station.__enter__()
        try:
            self.cameras = [self._as_started(camera) for camera in self.cameras]
        except BaseException:
            self.station.stop()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.station.stop()

    def _as_started(self, camera: Camera) -> Camera:
        """The calibrated camera, with the device's depth scale. Raises `DataError` where it is not as it was."""
        now = self.station.models[camera.name]
        if not np.allclose(now.K[[0, 1], [0, 1]], camera.K[[0, 1], [0, 1]], rtol=SAME):
            raise DataError(
                f"camera {camera.name} has focal length {now.K[0, 0]:.0f} px, cameras.json says {camera.K[0, 0]:.0f}",
                hint="is it the camera that was calibrated? else calibrate again",
            )
        return replace(camera, depth_scale=now.depth_scale)

    def scene(self) -> Scene:
        """What the cameras see now, from images taken after the call. Raises `DataError` where one has stopped."""
        shots = self.station.shots()
        return Scene([shot.color for shot in shots], [shot.depth for shot in shots], self.cameras)


def open_cameras(recording: Path | str, fps: int = 30) -> LiveCameras:
    """The cameras of a recording's cameras.json, known by their serial numbers, as a context: `with open_cameras(...) as c`.

    Raises `DataError` for cameras without pose or serial number, `MissingError` where one is not plugged in.
    """
    folder = Path(recording)
    path = folder / "cameras.json"
    if not path.is_file():
        raise DataError(
            "cameras.json is missing", str(folder), "give the recording that the cameras were calibrated with"
        )
    cameras, serials = (
        read_cameras(folder),
        {name: serial for serial, name in names_of(read_cameras_file(path)).items()},
    )
    unknown = [camera.name for camera in cameras if camera.name not in serials]
    if unknown:
        raise DataError(
            f"camera {unknown[0]} has no serial number", str(path), 'record with piegraph, or add "serial" to it'
        )
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(sizes) > 1:
        raise UsageError("cameras of several sizes cannot be opened together", str(path), "calibrate them at one size")
    mode = Mode(*next(iter(sizes)), fps)
    wanted = ",".join(f"{camera.name}={serials[camera.name]}" for camera in cameras)
    return LiveCameras(Station(choose(connected(), wanted, {}), mode), cameras)
