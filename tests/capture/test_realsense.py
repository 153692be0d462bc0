"""RealSense through the library's software device: pairing, alignment, times, intrinsics, and what it refuses."""

import threading
import time

import numpy as np
import pytest

from piegraph_cli.capture import realsense
from piegraph_cli.capture.cameras import Mode, connected
from piegraph_cli.capture.clock import SETTLED, HostClock
from piegraph_cli.errors import DataError, MissingError, UsageError

try:
    import pyrealsense2 as rs
except ImportError as error:
    rs, missing = None, f"pyrealsense2 cannot be imported: {error}"
else:
    missing = ""
needs_library = pytest.mark.skipif(rs is None, reason=missing)
WIDTH, HEIGHT, FPS = 128, 96, 30
BASELINE = 0.05
INVERSE = [0.1, -0.05, 0.001, -0.002, 0.01]


class Device:
    """A software device with a depth and a colour sensor, which are `BASELINE` (m) apart, before a wall at 0.8 m."""

    def __init__(self, serial: str, own_clock: bool = False, coefficients: list[float] | None = None):
        self.handle = rs.software_device()
        self.domain = rs.timestamp_domain.hardware_clock if own_clock else rs.timestamp_domain.global_time
        self.behind = 1000.0 if own_clock else 0.0
        self.depth, self.depth_profile = self._sensor("Stereo Module", rs.stream.depth, rs.format.z16, 2, None)
        self.color, self.color_profile = self._sensor("RGB Camera", rs.stream.color, rs.format.rgb8, 3, coefficients)
        self.depth.add_read_only_option(rs.option.depth_units, 0.0005)
        between = rs.extrinsics()
        between.rotation, between.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [BASELINE, 0, 0]
        self.depth_profile.register_extrinsics_to(self.color_profile, between)
        self.handle.register_info(rs.camera_info.serial_number, serial)

    def _sensor(self, name, stream, form, size, coefficients):
        sensor, video, lens = self.handle.add_sensor(name), rs.video_stream(), rs.intrinsics()
        lens.width, lens.height, lens.ppx, lens.ppy, lens.fx, lens.fy = (
            WIDTH,
            HEIGHT,
            WIDTH / 2,
            HEIGHT / 2,
            120.0,
            120.0,
        )
        lens.model = rs.distortion.inverse_brown_conrady if coefficients else rs.distortion.brown_conrady
        lens.coeffs = coefficients or [0.0] * 5
        video.type, video.fmt, video.bpp, video.uid = stream, form, size, size
        video.width, video.height, video.fps, video.intrinsics = WIDTH, HEIGHT, FPS, lens
        return sensor, sensor.add_video_stream(video, True)

    def feed(self, frames: int) -> threading.Thread:
        """Deliver so many frames in a thread of its own; colour has the number in it, depth a step at the middle."""

        def send() -> None:
            wall = np.full((HEIGHT, WIDTH), 1600, np.uint16)
            wall[:, WIDTH // 2 :] = 1200
            for number in range(frames):
                stamp = 1000 * (time.time() - self.behind)
                picture = np.full((HEIGHT, WIDTH, 3), number, np.uint8)
                self._send(self.depth, self.depth_profile, wall, 2, number, stamp - 3)
                self._send(self.color, self.color_profile, picture, 3, number, stamp)
                time.sleep(1 / FPS)

        thread = threading.Thread(target=send)
        thread.start()
        return thread

    def _send(self, sensor, profile, pixels, size, number, stamp) -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp, frame.stride, frame.frame_number = pixels, size, WIDTH * size, number
        frame.timestamp, frame.domain, frame.profile = stamp, self.domain, profile.as_video_stream_profile()
        if size == 2:
            frame.depth_units = 0.0005
        sensor.on_video_frame(frame)


@needs_library
@pytest.mark.parametrize("own_clock", [False, True])
def test_shots_have_aligned_depth_and_times_of_this_computer(own_clock):
    device = Device("123", own_clock)
    camera = realsense.RealSense(device.handle)
    model = camera.start(Mode(WIDTH, HEIGHT, FPS))
    assert (model.name, model.width, model.height, model.depth_scale) == ("123", WIDTH, HEIGHT, pytest.approx(0.0005))
    begin, feeding = time.time(), device.feed(12)
    shots = [camera.read(2.0) for _ in range(10)]
    feeding.join()
    camera.stop()
    assert [int(shot.color[0, 0, 0]) for shot in shots] == list(range(10))
    stamps = np.array([shot.time for shot in shots])
    assert (np.diff(stamps) > 0).all()
    assert begin - 0.05 < stamps[0] < begin + 1.0
    # the step lies 120 * 0.05 / 0.6 = 10 px further right in colour than in depth
    row = shots[-1].depth[HEIGHT // 2]
    near = np.flatnonzero(row == 1200)
    assert near[0] == pytest.approx(WIDTH // 2 + 10, abs=1)
    assert row[WIDTH // 2 - 10] == 1600


@needs_library
def test_what_a_device_has_not_is_refused_with_what_it_has():
    camera = realsense.RealSense(Device("123").handle)
    with pytest.raises(UsageError, match="camera 123 has no colour of 640 x 480 at 90") as refused:
        camera.start(Mode(640, 480, 90))
    assert f"{WIDTH}x{HEIGHT} at {FPS}" in refused.value.hint
    camera.stop()
    camera.start(Mode(WIDTH, HEIGHT, FPS))
    with pytest.raises(DataError, match="camera 123 has stopped delivering"):
        camera.read(0.05)
    camera.stop()


@needs_library
def test_a_device_that_is_used_by_another_is_said(monkeypatch):
    camera = realsense.RealSense(Device("123").handle)

    def busy(*_):
        raise RuntimeError("xioctl(VIDIOC_S_FMT) failed, errno=16 Last Error: Device or resource busy")

    monkeypatch.setattr(camera, "_begin", busy)
    with pytest.raises(DataError, match="used by another program"):
        camera.start(Mode(WIDTH, HEIGHT, FPS))


@needs_library
def test_the_devices_distortion_becomes_opencvs():
    device = Device("123", coefficients=INVERSE)
    camera, lens = realsense.RealSense(device.handle), device.color_profile.as_video_stream_profile().get_intrinsics()
    model = camera.start(Mode(WIDTH, HEIGHT, FPS))
    camera.stop()
    pixels = np.array([[5.0, 8.0], [60.0, 90.0], [120.0, 3.0]])
    wanted = [rs.rs2_deproject_pixel_to_point(lens, pixel, 1.0) for pixel in pixels.tolist()]
    np.testing.assert_allclose(model.rays(pixels), wanted, atol=5e-4)
    assert np.abs(np.array(wanted)[:, :2] - (pixels - [WIDTH / 2, HEIGHT / 2]) / 120).max() > 0.01
    assert camera.notes == []


def test_no_camera_and_no_library_are_said(monkeypatch):
    monkeypatch.setattr(realsense, "connected", list)
    with pytest.raises(MissingError, match="no camera is plugged in"):
        connected()
    monkeypatch.setitem(__import__("sys").modules, "pyrealsense2", None)
    with pytest.raises(MissingError, match="pyrealsense2 is not installed"):
        realsense.library()


def test_the_offset_of_a_clock_is_the_least_delay_of_its_first_frames():
    clock, rng = HostClock(), np.random.default_rng(0)
    delays = 0.005 + rng.exponential(0.004, 100)
    found = [clock.seconds(k / 30, 1000 + k / 30 + delay, own=True) for k, delay in enumerate(delays)]
    assert clock.offset == pytest.approx(1000 + delays[:SETTLED].min())
    np.testing.assert_allclose(np.diff(found[SETTLED:]), 1 / 30, atol=1e-9)
    assert not clock.rough
    assert HostClock().seconds(5.0, 9.0, own=False) == 5.0
