"""Stage `hands`: the hand's landmarks in every camera, and its keypoints and end-effector in the world."""

from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.perception.params import HandsParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    import numpy as np

STAGE = Stage(
    "hands", "find the hand in 3-D", ("frames",), "hands", HandsParams, version=1, run="piegraph_cli.stages.hands:run"
)

POOR = 0.5
"""Share of frames with a hand below which the user is warned."""
SHALLOW, FEWEST = 0.6, 5
"""Share of a hand's landmarks with a depth below which a camera that saw it in so many frames is named; good ones have
0.84 and more, unregistered depth 0.1 to 0.7."""


def run(inputs: dict[str, Any], params: HandsParams, context: Context) -> Output:
    """Find the hand in one sequence."""
    import numpy as np

    from piegraph_cli.perception.hands import detect_hands, end_effector, lift_hands
    from piegraph_cli.stages.images import cameras_of, color_of, depth_of
    from piegraph_cli.weights import cached_weights

    frames: Any = inputs["frames"]
    cameras, color, depth, time = cameras_of(frames), color_of(frames), depth_of(frames), frames["time"]
    model = params.hand_model or cached_weights("hand-landmarker")
    landmarks = np.stack(
        [
            detect_hands(context.progress(color.of_camera(c), f"hands {camera.name}", len(time)), time, model)[0]
            for c, camera in enumerate(cameras)
        ],
        axis=1,
    )
    if not np.isfinite(landmarks).any():
        raise DataError(
            f"no camera sees a hand in frames 0 to {len(time) - 1}",
            f"{frames.path}, cameras {', '.join(c.name for c in cameras)}",
            "check that the hand is in view and lit, or remove this sequence",
        )
    hand = lift_hands(landmarks, depth.depth, cameras, time, max_gap=params.max_gap)
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
    warnings = _without_depth([c.name for c in cameras], hand.seen, hand.deep)
    if hand.observed.mean() < POOR:
        warnings.append(f"hand found in {hand.observed.mean():.0%} of the frames only: see `piegraph report`")
    return Output(arrays, quality, warnings)


def _without_depth(names: list[str], seen: "np.ndarray", deep: "np.ndarray") -> list[str]:
    """A warning about cameras that see the hand [F, C] in colour, while their depth [F, C] is beside it."""
    shares = {name: deep[seen[:, c], c].mean() for c, name in enumerate(names) if seen[:, c].sum() >= FEWEST}
    shallow = [f"{name} {share:.0%}" for name, share in shares.items() if share < SHALLOW]
    if not shallow:
        return []
    return [
        f"the hand is seen in colour, but few of its landmarks have a depth: {', '.join(shallow)}\n"
        "  try: register depth to colour; see the check of edges (docs/checks.md)"
    ]
