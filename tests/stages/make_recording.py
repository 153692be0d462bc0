"""A recording folder of noise, small and quick to write, to be broken by tests."""

from pathlib import Path

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times


def make_cameras(names: tuple[str, ...] = ("front", "left cam")) -> list[Camera]:
    T = np.eye(4)
    T[:3, :3] = np.diag([1, -1, -1])
    T[2, 3] = 0.8
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    return [Camera(name, 64, 48, K, np.zeros(5), T) for name in names]


def make_recording(folder: Path, sequences: int = 2, frames: int = 4, fps: float = 5.0) -> Path:
    rng = np.random.default_rng(0)
    cameras = make_cameras()
    write_cameras(folder, cameras)
    for s in range(sequences):
        for k, camera in enumerate(cameras):
            for f in range(frames):
                color = rng.integers(0, 255, (48, 64, 3), np.uint8)
                write_frame(
                    folder / f"seq {s}", camera, f, color, rng.integers(500, 900, (48, 64)).astype(np.uint16), 80
                )
            write_times(folder / f"seq {s}", camera, np.arange(frames) / fps + 0.002 * k)
    return folder
