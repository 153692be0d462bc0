"""The cameras: where they stand, and beside each what it sees, with the object's mask."""

from typing import ClassVar

import numpy as np

from piegraph_cli.viewer.layer import Layer

SIZE = 0.12
"""Metres from a camera to its picture."""


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """w, x, y, z of a rotation matrix [3, 3]."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(scalar_first=True)


class Cameras(Layer):
    """A frustum per camera with its picture."""

    name: ClassVar[str] = "cameras"
    needs: ClassVar[tuple[str, ...]] = ("frames",)

    def open(self) -> None:
        """Place the cameras."""
        self.frusta = [
            self.scene.add_camera_frustum(
                f"{self.root}/{k}",
                fov=2 * np.arctan(camera.height / 2 / camera.K[1, 1]),
                aspect=camera.width / camera.height,
                scale=SIZE,
                thickness=1.5,
                thickness_units="screen",
                color=(90, 90, 90),
                wxyz=quaternion(camera.T_world_camera[:3, :3]),
                position=camera.T_world_camera[:3, 3],
                cast_shadow=False,
                receive_shadow=False,
            )
            for k, camera in enumerate(self.viewer.sequence.cameras)
        ]
        for k, camera in enumerate(self.viewer.sequence.cameras):
            self.scene.add_label(f"{self.root}/{k}/name", camera.name, font_screen_scale=0.8)

    def draw(self, frame: int) -> None:
        """Show what the cameras saw."""
        for frustum, picture in zip(self.frusta, self.viewer.pictures.at(frame), strict=True):
            frustum.image = picture.drawn
