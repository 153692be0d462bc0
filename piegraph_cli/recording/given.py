"""What the entries of cameras show by themselves, without an image: where a check is bad, that comes first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import Check, listed

SAME = 1e-6
"""Metres, and parts of a rotation, within which two poses are one."""
BESIDE = 0.06
"""Share of an image's size by which the middle of its lens lies beside its own in hardly any camera."""


def explained_by_entries(checks: Sequence[Check], cameras: Sequence[Camera]) -> list[Check]:
    """The checks, the bad ones between cameras and of tables with what is odd in the entries of these cameras as the cause."""
    return [_explained(check, cameras) if check.verdict == "bad" else check for check in checks]


def _explained(check: Check, cameras: Sequence[Camera]) -> Check:
    if check.name not in ("table", "view", "clouds", "outlines", "texture"):
        return check
    of_check = [camera for camera in cameras if camera.name in check.cameras]
    same = sorted({name for camera in of_check for name in _sharing(camera, cameras)})
    if same:
        cause, remedy = (
            f"{listed(same)} have the same T_world_camera",
            "give each camera its own pose: piegraph calibrate",
        )
        if len(check.cameras) == 1 and check.cause:  # its table may be wrong for another reason as well
            cause, remedy = f"{cause}; {check.cause}", f"{remedy}; {check.remedy}"
        return replace(check, cause=cause, remedy=remedy)
    lens = next((camera.name for camera in cameras if is_world(camera)), None)
    if lens and check.name in ("table", "view"):
        return replace(
            check,
            cause=f"the world is that of {lens}, whose T_world_camera is the identity",
            remedy="piegraph calibrate RECORDING --table moves all cameras so that the table is z = 0",
        )
    beside = [camera for camera in of_check if _beside(camera) > BESIDE]
    if beside and len(check.cameras) > 1:
        camera = beside[0]
        middle = f"{camera.K[0, 2]:.0f}, {camera.K[1, 2]:.0f} px"
        cause = (
            f"K of {camera.name} has its middle at {middle}, far from that of images of {camera.width} x {camera.height}: "
            "were they cropped or turned after calibration?"
        )
        return replace(check, cause=cause, remedy="give K of the images as they are; otherwise " + check.remedy)
    return check


def is_world(camera: Camera) -> bool:
    """Whether a camera's own frame is the world, as calibrations of several cameras alone leave it."""
    return bool(np.abs(camera.T_world_camera - np.eye(4)).max() < SAME)


def _sharing(camera: Camera, cameras: Sequence[Camera]) -> list[str]:
    """Names of the cameras that have this one's pose, its own among them; none where no other has it."""
    poses = [other.T_world_camera for other in cameras]
    names = [c.name for c, T in zip(cameras, poses, strict=True) if np.abs(T - camera.T_world_camera).max() < SAME]
    return names if len(names) > 1 else []


def _beside(camera: Camera) -> float:
    """How far the middle of the lens lies beside that of the image, as a share of the image's size."""
    return float(max(abs(camera.K[0, 2] / camera.width - 0.5), abs(camera.K[1, 2] / camera.height - 0.5)))
