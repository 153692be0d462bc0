"""Scoring a simulated recording: the one place that reads truth.h5, for `evaluate` and `report`."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from piegraph_cli.evaluation.truth import carry_with_mesh, hand_scores, mask_iou, surface_distance, track_errors
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.run import Run

CLOUD_EVERY = 3
"""Every how many frames cloud and masks are scored."""


def read_truth(run: Run, sequence: str) -> Artifact | None:
    """The truth of a sequence, or None for a recording that has none."""
    path = run.recording / sequence / "truth.h5"
    return read_artifact(path, "truth") if path.is_file() else None


def source_frames(frames: Artifact) -> np.ndarray:
    """The recording's frame [F] that each frame of the artifact was taken from (that of the first camera)."""
    return frames["source_frame"][:, 0]


def true_positions(inputs: dict[str, Any], sequence: str, run: Run) -> np.ndarray | None:
    """Where the tracked particles of the first frame truly are in each frame [F, N, 3] (m)."""
    truth = read_truth(run, sequence)
    if truth is None:
        return None
    vertices = truth["vertices"][source_frames(inputs["frames"][sequence])]
    return carry_with_mesh(inputs["tracks"][sequence]["positions"][0], vertices, truth["triangles"], 0)


def score_sequence(inputs: dict[str, Any], sequence: str, run: Run) -> Iterator[tuple[str, float]]:
    """Named scores of one sequence, one value per frame, image or particle set."""
    truth, frames = read_truth(run, sequence), inputs["frames"][sequence]
    assert truth is not None
    rows = source_frames(frames)
    hands, masks, clouds, tracks = (inputs[name][sequence] for name in ("hands", "masks", "clouds", "tracks"))
    for name, values in hand_scores(hands["seen"], hands["end_effector"], truth["end_effector"][rows]).items():
        yield from ((name, value) for value in values)
    cameras = len(frames["camera_name"])
    found = ImageStack(masks["mask"], masks["mask_offsets"], cameras, "mask")
    true = ImageStack(truth["object_mask"], truth["object_mask_offsets"], cameras, "true mask")
    for frame in range(0, len(rows), CLOUD_EVERY):
        for camera in range(cameras):
            yield "object mask IoU", mask_iou(found.mask(frame, camera), true.mask(int(rows[frame]), camera))
        points = clouds["points"][clouds["offsets"][frame] : clouds["offsets"][frame + 1]]
        if len(points):
            distances = surface_distance(points, truth["vertices"][rows[frame]], truth["triangles"])
            yield "fused cloud to surface, median [mm]", float(np.median(distances)) * 1000
    errors = track_errors(tracks["positions"], true_positions(inputs, sequence, run))  # type: ignore[arg-type]
    stroke = truth["stroke"][rows]
    ends = np.flatnonzero((stroke >= 0) & (stroke != np.append(stroke[1:], -1)))
    yield from (("tracked particles at stroke ends [mm]", errors[end]) for end in ends)
    yield from (("tracked particles, all frames [mm]", error) for error in errors)
