"""What stages read of a frames artifact: its cameras, images and workspace."""

from collections.abc import Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.workspace.artifact import Artifact

if TYPE_CHECKING:
    from piegraph_cli.physics.visibility import View


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


class Views(Sequence["list[View]"]):
    """Per frame what each camera sees, decoded when it is asked for."""

    def __init__(self, frames: Artifact, masks: Artifact):
        self.cameras, self.depth, self._frames = cameras_of(frames), depth_of(frames), frames
        self.mask = ImageStack(masks["mask"], masks["mask_offsets"], len(self.cameras), "mask")
        self.frames = len(frames["time"])

    def __len__(self) -> int:
        return self.frames

    def __getitem__(self, frame):
        from piegraph_cli.physics.visibility import View

        return [
            View(camera, self.depth.depth(frame, c), self.mask.mask(frame, c), partial(self._image, frame, c))
            for c, camera in enumerate(self.cameras)
        ]

    @cached_property
    def _color(self) -> ImageStack:
        return color_of(self._frames)

    def _image(self, frame: int, camera: int) -> np.ndarray:
        return self._color.color(frame, camera)
