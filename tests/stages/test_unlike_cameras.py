"""Cameras that differ in size, lens and depth sensor: from a recording to masks, cloud and pictures."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from piegraph_cli.evaluation.overlays import tile
from piegraph_cli.perception.params import FuseParams, SegmentParams
from piegraph_cli.recording.camera import DepthView
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.recording.sequence import read_sequence
from piegraph_cli.report.pictures import SEQUENCE
from piegraph_cli.report.sequence import Seen, draw_sequence
from piegraph_cli.stages import fuse, segment
from tests.perception.scene import pushing_sequence, render, ring_camera
from tests.stages.chain import artifact, context

FRAMES = 4
BOX = (-0.3, 0.3, -0.3, 0.3, -0.02, 0.2)
LENS = np.array([0.05, -0.03, 0.001, -0.001, 0.01, 0.02, -0.01, 0.005])


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Frames, hands, masks and clouds of a push seen by three cameras, no two alike; the second's depth is its own."""
    folder = tmp_path_factory.mktemp("unlike")
    cameras = [ring_camera(0.4, "a"), ring_camera(2.5, "b", 160, 120), ring_camera(4.4, "c", 256, 144)]
    cameras[1] = replace(cameras[1], distortion=LENS)
    cameras[2] = replace(cameras[2], distortion=np.array([*LENS[:4], 0.0]))
    views, hands = pushing_sequence(FRAMES, cameras)
    sensor = ring_camera(2.53, "b", 212, 159)
    apart = np.linalg.inv(cameras[1].T_world_camera) @ sensor.T_world_camera
    cameras[1] = replace(cameras[1], depth_view=DepthView(212, 159, sensor.K, sensor.distortion, apart))
    write_cameras(folder, cameras)
    for f, row in enumerate(views):
        moved = max(0.0, (f - FRAMES * 0.4) / FRAMES)
        own = render(sensor, (0.03 - 0.15 * moved, 0.02), 0.5 * moved, hands[f]).depth
        for c, camera in enumerate(cameras):
            write_frame(folder / "s", camera, f, row[c].image, own if c == 1 else row[c].depth, 95)
    for camera in cameras:
        write_times(folder / "s", camera, np.arange(FRAMES) / 5)
    arrays, warnings = read_sequence(folder / "s", IngestParams(workspace=BOX))
    assert not warnings
    arrays["camera_name"] = arrays["camera_name"].astype("S")
    frames = artifact(arrays, {"workspace": BOX})
    pixels = np.array([[camera.project(hand)[0] for camera in cameras] for hand in hands])
    hands = artifact({"landmarks": pixels, "seen": np.ones(pixels.shape[:2], bool), "end_effector": hands[:, 8]})
    run = SimpleNamespace(**vars(context()))
    masks = artifact(segment.run({"frames": frames, "hands": hands}, SegmentParams(), run).arrays)
    inputs = {"frames": frames, "hands": hands, "masks": masks}
    clouds = fuse.run(inputs, FuseParams(), run).arrays
    return SimpleNamespace(cameras=cameras, views=views, clouds=clouds, **inputs)


def mask(chain, frame, camera):
    data, offsets, k = chain.masks["mask"], chain.masks["mask_offsets"], frame * 3 + camera
    return cv2.imdecode(data[offsets[k] : offsets[k + 1]], cv2.IMREAD_GRAYSCALE) > 0


@pytest.mark.parametrize("camera", [0, 1, 2])
def test_each_camera_masks_the_object_at_its_own_size(chain, camera):
    for f in range(FRAMES):
        found, true = mask(chain, f, camera), chain.views[f][camera].object
        assert found.shape == true.shape
        assert (found & true).sum() / (found | true).sum() > 0.8


def test_the_clouds_of_all_cameras_meet_on_the_object(chain):
    points = np.split(chain.clouds["points"], chain.clouds["offsets"][1:-1])[0]
    x, y = np.abs(points[:, :2] - [0.03, 0.02]).T
    on_the_t = ((x < 0.106) & (points[:, 1] > 0.009)) | (x < 0.031)
    assert len(points) > 500
    assert on_the_t.mean() > 0.97
    assert (y < 0.115).all()
    assert np.median(points[points[:, 2] > 0.02, 2]) == pytest.approx(0.03, abs=0.002)


def test_lenses_come_through_padded(chain):
    assert chain.frames["distortion"].shape == (3, 8)
    np.testing.assert_allclose(chain.frames["distortion"][0][5:], 0)
    np.testing.assert_allclose(chain.frames["distortion"][1], LENS)


def test_pictures_of_all_sizes_fit_on_a_sheet(chain):
    seen = Seen("take", frames=chain.frames, masks=chain.masks, hands=chain.hands)
    _, sheet = draw_sequence(seen, SEQUENCE, "p")
    assert (sheet.height, sheet.width) == (FRAMES * (159 + 4) - 4, 3 * 256 + 8)
    one, other = np.zeros((4, 9, 3), np.uint8), np.full((6, 2, 3), 7, np.uint8)
    sheet = tile([[one, other]], gap=1)
    assert sheet.shape == (6, 19, 3)
    assert (sheet[:4, :9] == 0).all()
    assert (sheet[:, 10:12] == 7).all()
    assert (sheet[4:, :9] == 255).all()
