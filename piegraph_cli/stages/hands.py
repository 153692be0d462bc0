"""Stage `hands`: the hand's landmarks in every camera, and its keypoints and end-effector in the world."""

from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.perception.params import HandsParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from piegraph_cli.recording.images import CameraImages

STAGE = Stage(
    "hands", "find the hand in 3-D", ("frames",), "hands", HandsParams, version=2, run="piegraph_cli.stages.hands:run"
)

POOR = 0.5
"""Share of frames with a hand below which the user is warned."""

BOTH_MOVE = 0.06
"""How far (m) both of two hands must go for the user to be warned."""


def run(inputs: dict[str, Any], params: HandsParams, context: Context) -> Output:
    """Find the hand in one sequence."""
    import numpy as np

    from piegraph_cli.perception.hands import end_effector, lift_hands
    from piegraph_cli.perception.two_hands import separate_hands, travel
    from piegraph_cli.stages.images import cameras_of, color_of, depth_of
    from piegraph_cli.weights import cached_weights

    frames: Any = inputs["frames"]
    cameras, color, depth, time = cameras_of(frames), color_of(frames), depth_of(frames), frames["time"]
    model = params.hand_model or cached_weights("hand-landmarker")
    landmarks = _landmarks(frames, cameras, color, time, model, context)
    both = landmarks.shape[2] == 2
    each = separate_hands(landmarks, depth.depth, cameras) if both else landmarks[None, :, :, 0]
    tracks = [lift_hands(one, depth.depth, cameras, time, max_gap=params.max_gap) for one in each]
    ways = [travel(end_effector(track.keypoints)) for track in tracks]
    hand = tracks[int(np.argmax(ways))]
    arrays = {
        "landmarks": hand.pixels,
        "seen": hand.seen,
        "keypoints": hand.keypoints,
        "end_effector": end_effector(hand.keypoints),
        "observed": hand.observed,
        "time": time,
    }
    rates = ", ".join(f"{c.name} {rate:.0%}" for c, rate in zip(cameras, hand.seen.mean(0), strict=True))
    quality = f"hand in {hand.seen.any(1).mean():.0%} of {len(time)} frames ({rates})"
    if both:
        quality += f"; of two hands the one that moves {max(ways) * 1000:.0f} mm, not {min(ways) * 1000:.0f} mm"
    warnings = []
    if both and min(ways) > BOTH_MOVE:
        warnings.append("two hands move: the one that moves more is taken, and strokes of the other are not seen")
    if hand.observed.mean() < POOR:
        warnings.append(f"hand found in {hand.observed.mean():.0%} of the frames only: see `piegraph report`")
    return Output(arrays, quality, warnings)


def _landmarks(frames: Any, cameras: list, color: Any, time: "np.ndarray", model: "Path", context: Context) -> Any:
    """Landmarks [F, C, N, 21, 2] (px) of one hand, or of two where two are seen."""
    import numpy as np

    from piegraph_cli.perception.hands import detect_several

    images = [color.of_camera(c) for c in range(len(cameras))]
    hands = 2 if _second_hand(images, time, model) else 1
    found = []
    for one, camera in zip(images, cameras, strict=True):
        found.append(detect_several(context.progress(one, f"hands {camera.name}", len(time)), time, model, hands)[0])
    landmarks = np.stack(found, axis=1)
    if not np.isfinite(landmarks).any():
        raise DataError(
            f"no camera sees a hand in frames 0 to {len(time) - 1}",
            f"{frames.path}, cameras {', '.join(c.name for c in cameras)}",
            "check that the hand is in view and lit, or remove this sequence",
        )
    return landmarks


def _second_hand(images: "list[CameraImages]", time: "np.ndarray", model: "Path") -> bool:
    """Whether two hands are seen in at least two of a few images."""
    import numpy as np

    from piegraph_cli.perception.hands import detect_several
    from piegraph_cli.perception.two_hands import look_frames, sees_two

    frames = look_frames(len(time))
    found = 0
    for one in images:
        landmarks, score = detect_several((one[f] for f in frames), time[frames], model, 2)
        found += int(np.sum(sees_two(landmarks, score)))
    return found >= 2
