"""Recordings without the things beside the object: these are wiped out of the images before the object is followed."""

from collections.abc import Sequence

import numpy as np

from piegraph_cli.perception.choice import STEP, STEP_PER_M2
from piegraph_cli.perception.seeds import ObjectSeed
from piegraph_cli.recording.camera import Camera

RIM = 3
"""Pixels by which a thing is widened, for the blur and the flying pixels of its outline."""
TABLE_AROUND = 12
"""Pixels beyond the rim whose colour a thing is wiped out with."""


class Beside:
    """One camera's view of what lies beside the object in the seed frame: where, how deep, on which table."""

    def __init__(self, mask: np.ndarray, object_mask: np.ndarray, image: np.ndarray, depth: np.ndarray, camera: Camera):
        import cv2

        grown = _grown(mask, RIM) & ~_grown(object_mask, 1)
        ring = _grown(mask, TABLE_AROUND) & ~_grown(mask | object_mask, RIM)
        self.camera, self.grown = camera, grown
        self.depth = cv2.medianBlur(depth, 5)
        self.table = np.median(image[ring if ring.any() else ~grown], axis=0).astype(np.uint8)

    def still(self, depth: np.ndarray) -> np.ndarray:
        """Where [H, W] a frame's depth shows these things as they lay, or shows nothing."""
        import cv2

        scale = np.float32(self.camera.depth_scale)
        smooth = cv2.medianBlur(depth, 5)
        before, now = self.depth * scale, smooth * scale
        near = np.abs(now - before) <= np.maximum(STEP, STEP_PER_M2 * before**2)
        return self.grown & (near | (smooth == 0) | (self.depth == 0))


class WipedColor(Sequence):
    """Colour images of one camera with the things beside the object painted as the table is."""

    def __init__(self, images: Sequence[np.ndarray], depths: Sequence[np.ndarray], beside: Beside):
        self.images, self.depths, self.beside = images, depths, beside

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, frame):
        image = self.images[frame].copy()
        image[self.beside.still(self.depths[frame])] = self.beside.table
        return image


class WipedDepth(Sequence):
    """Depth images of one camera without a reading where things lie beside the object."""

    def __init__(self, depths: Sequence[np.ndarray], beside: Beside):
        self.depths, self.beside = depths, beside

    def __len__(self) -> int:
        return len(self.depths)

    def __getitem__(self, frame):
        depth = self.depths[frame]
        return np.where(self.beside.still(depth), np.zeros_like(depth), depth)


def _grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    import cv2

    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1,) * 2, np.uint8)).astype(bool)


def without_others(
    images: Sequence[Sequence[np.ndarray]],
    depths: Sequence[Sequence[np.ndarray]],
    cameras: Sequence[Camera],
    seed: ObjectSeed,
) -> tuple[list[Sequence[np.ndarray]], list[Sequence[np.ndarray]]]:
    """The images and depths, `[camera][frame]` each, without what lies beside the object; as given where nothing does."""
    if not seed.others:
        return list(images), list(depths)
    colour, depth = list(images), list(depths)
    for c, camera in enumerate(cameras):
        mask = np.logical_or.reduce([part.masks[c] for part in seed.others])
        if mask.any():
            beside = Beside(mask, seed.masks[c], images[c][seed.frame], depths[c][seed.frame], camera)
            colour[c], depth[c] = WipedColor(images[c], depths[c], beside), WipedDepth(depths[c], beside)
    return colour, depth
