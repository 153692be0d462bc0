"""A frame that one camera of several lost: the others' are kept, and that camera shows nothing in it."""

import numpy as np

from piegraph_cli.recording.images import ImageStack
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.sequence import read_sequence
from piegraph_cli.stages.images import source_frames
from piegraph_cli.workspace.artifact import Artifact
from tests.stages.make_recording import make_cameras

FRAMES = 8
LOST = {"cam0": [5], "cam1": [], "cam2": [3]}


def test_the_nearest_picture_stands_in_and_depth_is_empty(tmp_path):
    cameras = make_cameras(tuple(LOST))
    write_cameras(tmp_path, cameras)
    for camera in cameras:
        kept = [f for f in range(FRAMES) if f not in LOST[camera.name]]
        for f in kept:
            color = np.full((48, 64, 3), 20 * f + 10, np.uint8)
            write_frame(tmp_path / "s", camera, f, color, np.full((48, 64), 800, np.uint16), 95)
        write_times(tmp_path / "s", camera, np.array(kept) / 5)
    arrays, warnings = read_sequence(tmp_path / "s", ReadParams())
    depth = ImageStack(arrays["depth"], arrays["depth_offsets"], 3, "depth")
    color = ImageStack(arrays["color"], arrays["color_offsets"], 3, "colour")
    empty = [[not depth.depth(f, c).any() for c in range(3)] for f in range(FRAMES)]
    assert np.argwhere(empty).tolist() == [[3, 2], [5, 0]]
    assert abs(int(color.color(3, 2).mean()) - 20 * 3 - 10) <= 21
    assert arrays["source_frame"][3].tolist() == [3, 3, -1]
    np.testing.assert_allclose(arrays["stamp"], np.repeat(np.arange(FRAMES)[:, None] / 5, 3, axis=1), atol=1e-6)
    assert any("frames that a camera lost, of 8: cam0 1, cam2 1" in said for said in warnings)
    frames = Artifact(tmp_path, "frames", "", {}, {}, "", arrays)
    assert source_frames(frames).tolist() == list(range(FRAMES))
