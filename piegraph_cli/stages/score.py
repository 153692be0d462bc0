"""Stage `score`: a simulated recording's perception and tracking against its truth.h5, which nothing else reads."""

from collections.abc import Iterator

import numpy as np

from piegraph_cli.evaluation.params import ScoreParams
from piegraph_cli.evaluation.truth import carry_with_mesh, hand_scores, mask_iou, surface_distance, track_errors
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from piegraph_cli.workspace.execute import Context, Output
from piegraph_cli.workspace.run import Run

CLOUD_EVERY = 3
"""Every how many frames cloud and masks are scored."""

AT_ENDS = "tracked particles at stroke ends [mm]"


def read_truth(run: Run, sequence: str) -> Artifact | None:
    """The truth of a sequence, or None for a recording that has none."""
    path = run.recording / sequence / "truth.h5"
    return read_artifact(path, "truth") if path.is_file() else None


def source_frames(frames: Artifact) -> np.ndarray:
    """The recording's frame [F] that each frame of the artifact was taken from (that of the first camera)."""
    return frames["source_frame"][:, 0]


def run(inputs: dict[str, Artifact], params: ScoreParams, context: Context) -> Output:
    """Score one sequence; a recording without truth gives no scores and no true positions."""
    assert context.sequence is not None
    tracked = inputs["tracks"]["positions"]
    truth = read_truth(context.run, context.sequence)
    scores: list[tuple[str, float]] = []
    true = np.zeros((0, *tracked.shape[1:]), np.float32)
    if truth is not None:
        vertices = truth["vertices"][source_frames(inputs["frames"])]
        true = carry_with_mesh(tracked[0], vertices, truth["triangles"], 0).astype(np.float32)
        scores = list(_scores(inputs, truth, true))
    arrays = {
        "score_name": np.array([name for name, _ in scores], "S128"),
        "score_value": np.array([value for _, value in scores], float),
        "true_positions": true,
    }
    at_ends = [value for name, value in scores if name == AT_ENDS]
    quality = f"{np.mean(at_ends):.1f} mm from the truth at stroke ends" if at_ends else "no truth to score against"
    return Output(arrays, quality)


def _scores(inputs: dict[str, Artifact], truth: Artifact, true: np.ndarray) -> Iterator[tuple[str, float]]:
    """Named scores, one value per frame, image or particle set."""
    frames, hands, masks, clouds, tracks = (inputs[n] for n in ("frames", "hands", "masks", "clouds", "tracks"))
    rows = source_frames(frames)
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
