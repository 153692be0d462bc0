"""RealSense cameras through pyrealsense2 (extra `realsense`): both sensors of a device, paired by time, depth aligned."""

import time
from collections import deque
from types import ModuleType
from typing import Any

import numpy as np

from piegraph_cli.capture.cameras import DepthCamera, Mode, Shot
from piegraph_cli.capture.clock import HostClock
from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.recording.camera import Camera

QUEUE = 4
"""Frames of a stream that wait to be read; older ones are dropped."""
FITTED = 0.5
"""Error (px) of the distortion from which a user is told."""


def library() -> ModuleType:
    """pyrealsense2. Raises `MissingError` where it, or what it needs, is missing."""
    try:
        import pyrealsense2
    except ImportError as error:
        if "libusb" in str(error):
            hint = "sudo apt-get install libusb-1.0-0"
            raise MissingError(f"pyrealsense2 lacks a system library: {error}", hint=hint) from None
        raise MissingError("pyrealsense2 is not installed", hint="pip install 'piegraph[realsense]'") from None
    return pyrealsense2


def connected() -> list[DepthCamera]:
    """The RealSense cameras that are plugged in."""
    return [RealSense(device) for device in library().context().query_devices()]


class RealSense(DepthCamera):
    """One RealSense device; the library's software device will do as well."""

    def __init__(self, device: Any):
        super().__init__()
        self.rs, self.device = library(), device
        self.serial = self._info("serial_number") or "unknown"
        self.usb = self._info("usb_type_descriptor")
        self._open: list[Any] = []
        self._depths: deque[Any] = deque(maxlen=2)

    def _info(self, name: str) -> str:
        field = getattr(self.rs.camera_info, name)
        return self.device.get_info(field) if self.device.supports(field) else ""

    def start(self, mode: Mode) -> Camera:
        """As in `DepthCamera`. Depth of the same rate and, where there is one, of colour's size is taken."""
        rs = self.rs
        color, depth = (
            self._profile(rs.stream.color, rs.format.rgb8, mode),
            self._profile(rs.stream.depth, rs.format.z16, mode),
        )
        if self.usb.startswith("2"):
            self.notes.append(
                f"camera {self.serial} is on USB {self.usb}: rates and sizes are limited, use a USB 3 port"
            )
        self._queues = {stream: rs.frame_queue(QUEUE, True) for stream in (rs.stream.color, rs.stream.depth)}
        self._align, self._composer = rs.align(rs.stream.color), _Composer(rs)
        self._clock, self._depths = HostClock(), deque(maxlen=2)
        self._half_period = 0.5 / mode.fps
        try:
            self._begin(color, depth)
        except RuntimeError as error:
            self.stop()
            raise self._refused(error) from None
        return self._camera(color[1].as_video_stream_profile().get_intrinsics(), depth[0])

    def _profile(self, stream: Any, form: Any, mode: Mode) -> tuple[Any, Any]:
        """The sensor and the profile of a stream that fit best. Raises `UsageError` where none has the rate."""
        offered = [
            (sensor, profile.as_video_stream_profile())
            for sensor in self.device.query_sensors()
            for profile in sensor.get_stream_profiles()
            if profile.stream_type() == stream and profile.format() == form
        ]
        fits = [
            (sensor, p)
            for sensor, p in offered
            if p.fps() == mode.fps
            and (stream == self.rs.stream.depth or (p.width(), p.height()) == (mode.width, mode.height))
        ]
        if not fits:
            what = "colour" if stream == self.rs.stream.color else "depth"
            modes = [
                f"{w}x{h} at {fps}" for w, h, fps in sorted({(p.width(), p.height(), p.fps()) for _, p in offered})
            ]
            usb = f" on USB {self.usb}" if self.usb else ""
            raise UsageError(
                f"camera {self.serial}{usb} has no {what} of {mode.width} x {mode.height} at {mode.fps} frames a second",
                "--size, --fps",
                f"it has {', '.join(modes) or 'none'}",
            )
        area = mode.width * mode.height
        return min(fits, key=lambda pair: abs(pair[1].width() * pair[1].height() - area))

    def _begin(self, color: tuple[Any, Any], depth: tuple[Any, Any]) -> None:
        """Open each sensor once, with one stream or both; times of the computer's clock where it can give them."""
        rs = self.rs
        together = color[0].get_info(rs.camera_info.name) == depth[0].get_info(rs.camera_info.name)
        groups = [(color[0], [color[1], depth[1]])] if together else [(s, [p]) for s, p in (color, depth)]
        for sensor, profiles in groups:
            if sensor.supports(rs.option.global_time_enabled):
                sensor.set_option(rs.option.global_time_enabled, 1)
            sensor.open(profiles)
            self._open.append(sensor)
        for sensor, profiles in groups:
            sensor.start(self._sort if len(profiles) > 1 else self._queues[profiles[0].stream_type()])

    def _sort(self, frame: Any) -> None:
        """Put a frame of a sensor with two streams into the queue of its stream."""
        self._queues[frame.get_profile().stream_type()].enqueue(frame)

    def _camera(self, intrinsics: Any, depth_sensor: Any) -> Camera:
        K = np.array([[intrinsics.fx, 0, intrinsics.ppx], [0, intrinsics.fy, intrinsics.ppy], [0, 0, 1]])
        distortion = self._distortion(intrinsics, K)
        scale = float(depth_sensor.get_option(self.rs.option.depth_units))
        return Camera(self.serial, intrinsics.width, intrinsics.height, K, distortion, np.eye(4), scale)

    def _distortion(self, intrinsics: Any, K: np.ndarray) -> np.ndarray:
        """The five numbers of OpenCV's model that fit the device's model best."""
        rs, model = self.rs.distortion, intrinsics.model
        given = np.array(intrinsics.coeffs, float)
        if not given.any() or model in (rs.brown_conrady, rs.modified_brown_conrady):
            return given
        if model != rs.inverse_brown_conrady:
            self.notes.append(
                f"camera {self.serial} has a distortion of another kind ({model}): zeros are written for it"
            )
            return np.zeros(5)
        columns, rows = np.meshgrid(np.linspace(0, intrinsics.width - 1, 24), np.linspace(0, intrinsics.height - 1, 18))
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        rays = [self.rs.rs2_deproject_pixel_to_point(intrinsics, pixel.tolist(), 1.0) for pixel in pixels]
        fitted, error = fit_distortion(pixels, np.array(rays)[:, :2], K)
        if error > FITTED:
            self.notes.append(f"the distortion of camera {self.serial} fits OpenCV's model to {error:.1f} px only")
        return fitted

    def read(self, timeout: float) -> Shot:
        """As in `DepthCamera`: a colour frame, and the depth frame that is nearest to it in time."""
        rs = self.rs
        try:
            color = self._queues[rs.stream.color].wait_for_frame(int(timeout * 1000))
            arrival = time.time()
            depth = self._depth_at(color.get_timestamp(), int(timeout * 1000))
            aligned = self._align.process(self._composer.join(depth, color))
        except RuntimeError as error:
            raise DataError(
                f"camera {self.serial} has stopped delivering: {error}",
                hint="check cable and port; with several cameras use ports of several controllers, or a lower --fps",
            ) from None
        own = color.get_frame_timestamp_domain() == rs.timestamp_domain.hardware_clock
        seconds = self._clock.seconds(color.get_timestamp() / 1000, arrival, own)
        if own and self._clock.rough and not any("clock" in note for note in self.notes):
            self.notes.append(
                f"camera {self.serial} has a clock of its own, whose offset is measured to some 20 ms only"
            )
        images = (np.asanyarray(f.get_data()).copy() for f in (color, aligned.get_depth_frame()))
        return Shot(seconds, *images)

    def _depth_at(self, stamp: float, timeout: int) -> Any:
        """The depth frame nearest to a stamp (ms) of colour."""
        queue = self._queues[self.rs.stream.depth]
        while not self._depths or self._depths[-1].get_timestamp() < stamp - 1000 * self._half_period:
            self._depths.append(queue.wait_for_frame(timeout))
        return min(self._depths, key=lambda frame: abs(frame.get_timestamp() - stamp))

    def stop(self) -> None:
        """As in `DepthCamera`."""
        for sensor in self._open:
            for end in (sensor.stop, sensor.close):
                try:
                    end()
                except RuntimeError:  # was not started, or is unplugged
                    continue
        self._open = []

    def _refused(self, error: RuntimeError) -> DataError:
        text = str(error).strip().splitlines()[0]
        busy = any(word in text.lower() for word in ("busy", "errno=16", "power state", "in use"))
        if busy:
            message = f"camera {self.serial} is used by another program: {text}"
            return DataError(message, hint="close realsense-viewer and other programs, or plug the camera in anew")
        return DataError(f"camera {self.serial} cannot be started: {text}", hint="plug it in anew, into a USB 3 port")


class _Composer:
    """Joins two frames to the frame set that the library aligns."""

    def __init__(self, rs: ModuleType):
        self._frames: list[Any] = []
        self._out = rs.frame_queue(1)
        self._block = rs.processing_block(self._join)
        self._block.start(self._out)

    def _join(self, frame: Any, source: Any) -> None:
        source.frame_ready(source.allocate_composite_frame(self._frames))

    def join(self, depth: Any, color: Any) -> Any:
        """The two frames as a set."""
        self._frames = [depth, color]
        self._block.invoke(depth)
        return self._out.wait_for_frame(1000).as_frameset()


def fit_distortion(pixels: np.ndarray, straight: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, float]:
    """Brown-Conrady numbers k1, k2, p1, p2, k3 from pixels [N, 2] and their straight rays [N, 2] (z = 1), and the error (px).

    The model is linear in its numbers, so this is least squares.
    """
    focal = K[[0, 1], [0, 1]]
    bent = (pixels - K[:2, 2]) / focal
    x, y = straight.T
    r2 = x**2 + y**2
    columns_x = np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3])
    columns_y = np.column_stack([y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3])
    system, wanted = np.concatenate([columns_x, columns_y]), np.concatenate([bent[:, 0] - x, bent[:, 1] - y])
    fitted = np.linalg.lstsq(system, wanted, rcond=None)[0]
    error = np.abs((system @ fitted - wanted).reshape(2, -1)) * focal[:, None]
    return fitted, float(error.max())
