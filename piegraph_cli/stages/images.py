"""What stages read of a frames artifact: its cameras, images and workspace."""

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.workspace.artifact import Artifact


def cameras_of(frames: Artifact) -> list[Camera]:
    """The cameras of a frames artifact."""
    return [
        Camera(name, int(w), int(h), K, distortion, T, float(scale))
        for name, (w, h), K, distortion, T, scale in zip(
            frames.texts("camera_name"),
            frames["image_size"],
            frames["K"],
            frames["distortion"],
            frames["T_world_camera"],
            frames["depth_scale"],
            strict=True,
        )
    ]


def color_of(frames: Artifact) -> ImageStack:
    """The colour images of a frames artifact."""
    return ImageStack(frames["color"], frames["color_offsets"], len(frames["K"]), "colour")


def depth_of(frames: Artifact) -> ImageStack:
    """The depth images of a frames artifact."""
    return ImageStack(frames["depth"], frames["depth_offsets"], len(frames["K"]), "depth")


def workspace_of(frames: Artifact) -> np.ndarray:
    """The workspace box [3, 2] (m) of a frames artifact."""
    return np.array(frames.params["workspace"], float).reshape(3, 2)


def source_frames(frames: Artifact) -> np.ndarray:
    """The recording's frame [F] that each frame of the artifact was taken from (that of the first camera that kept it)."""
    source = frames["source_frame"]
    return source[np.arange(len(source)), np.argmax(source >= 0, axis=1)]
