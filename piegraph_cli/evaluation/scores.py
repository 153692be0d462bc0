"""The figures of a simulated recording's perception and tracking against its truth."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from piegraph_cli.evaluation.spots import Distance
from piegraph_cli.evaluation.truth import MILLIMETRE, hand_scores, mask_iou, surface_distance, track_errors
from piegraph_cli.recording.images import ImageStack

CLOUD_EVERY = 3
"""Every how many frames cloud and masks are scored."""

AT_ENDS = "tracked particles at stroke ends [mm]"
SPOTS, SPOTS_SURE = "spots clicked by hand [mm]", "of that by clicking alone, up to [mm]"

Arrays = Mapping[str, np.ndarray]


def score_sequence(
    inputs: Mapping[str, Arrays], truth: Arrays, true: np.ndarray, rows: np.ndarray
) -> Iterator[tuple[str, float]]:
    """Named scores, one value per frame, image or particle set.

    From the arrays of frames, hands, masks, clouds and tracks, the truth, the true particles [F, N, 3] (m), and the
    recording's frame [F] that each frame was taken from.
    """
    frames, hands, masks, clouds, tracks = (inputs[n] for n in ("frames", "hands", "masks", "clouds", "tracks"))
    for name, values in hand_scores(hands["seen"], hands["end_effector"], truth["end_effector"][rows]).items():
        yield from ((name, value) for value in values)
    cameras = len(frames["camera_name"])
    found = ImageStack(masks["mask"], masks["mask_offsets"], cameras, "mask")
    real = ImageStack(truth["object_mask"], truth["object_mask_offsets"], cameras, "true mask")
    for frame in range(0, len(rows), CLOUD_EVERY):
        for camera in range(cameras):
            yield "object mask IoU", mask_iou(found.mask(frame, camera), real.mask(int(rows[frame]), camera))
        points = clouds["points"][clouds["offsets"][frame] : clouds["offsets"][frame + 1]]
        if len(points):
            distances = surface_distance(points, truth["vertices"][rows[frame]], truth["triangles"])
            yield "fused cloud to surface, median [mm]", float(np.median(distances)) * 1000
    errors = track_errors(tracks["positions"], true)
    stroke = truth["stroke"][rows]
    ends = np.flatnonzero((stroke >= 0) & (stroke != np.append(stroke[1:], -1)))
    yield from ((AT_ENDS, errors[end]) for end in ends)
    yield from (("tracked particles, all frames [mm]", error) for error in errors)


def spot_scores(found: Sequence[Distance]) -> list[tuple[str, float]]:
    """Named scores (mm) of spots clicked by hand: each distance, and how much of it clicking alone may make."""
    return [
        *((SPOTS, one.metres * MILLIMETRE) for one in found),
        *((SPOTS_SURE, one.deviation * MILLIMETRE) for one in found),
    ]


def told_spots(found: Sequence[Distance], cameras: int) -> str:
    """The distances of clicked spots in a line: how many, their median and the worst, and what clicks are good for."""
    if not found:
        return "spots clicked by hand: none in two frames, so nothing is known of tracking"
    worst = max(found, key=lambda one: one.metres)
    middle, sure = (np.median([getattr(one, name) for one in found]) * MILLIMETRE for name in ("metres", "deviation"))
    spots, frames = len({one.spot for one in found}), {one.frame for one in found} | {one.first for one in found}
    return (
        f"spots clicked by hand: median {middle:.1f} mm off, worst {worst.metres * MILLIMETRE:.1f} mm (spot {worst.spot}, "
        f"frame {worst.frame}), clicks good to {sure:.1f} mm; {_count(len(found), 'distance')} of {_count(spots, 'spot')} in "
        f"{_count(len(frames), 'frame')}, {_count(cameras, 'camera')}"
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
