"""Stage `hands`: the hand's landmarks in every camera, and its keypoints and end-effector in the world."""

from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.perception.params import HandsParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from piegraph_cli.perception.hands import HandTrack
    from piegraph_cli.recording.images import CameraImages

STAGE = Stage(
    "hands", "find the hand in 3-D", ("frames",), "hands", HandsParams, version=2, run="piegraph_cli.stages.hands:run"
)

POOR = 0.5
"""Share of frames with a hand below which the user is warned."""
SHALLOW, FEWEST = 0.6, 5
"""Share of a hand's landmarks with a depth below which a camera that saw it in so many frames is named; good ones have
0.84 and more, unregistered depth 0.1 to 0.7."""

ASKED = 8
"""Frames of a camera that hardly sees a hand in which its colours are exchanged."""
BLUE = "red and blue are exchanged: a hand is seen once they are put back"
WRITE_RGB = "write the colour images again with their channels in order: cv2.imwrite takes BGR"
GREY = 8
"""By how much (of 255) red, green and blue of nearly all pixels differ at most where an image has no colours."""
NO_COLOR = "the colour images are grey: hands and objects are found by their colours"
WITH_COLOR = "record colour, not infrared; or --source glove, stick or file"
BOTH_MOVE = 0.06
"""How far (m) both of two hands must go for the user to be warned."""


def run(inputs: dict[str, Any], params: HandsParams, context: Context) -> Output:
    """Find the hand in one sequence."""
    import numpy as np

    from piegraph_cli.perception.hands import detect_hands, end_effector, lift_hands
    from piegraph_cli.perception.two_hands import separate_hands, travel
    from piegraph_cli.stages.end_effectors import completed, from_depth, from_file, no_hand
    from piegraph_cli.stages.images import cameras_of, color_of, depth_of
    from piegraph_cli.weights import cached_weights

    frames: Any = inputs["frames"]
    if params.source == "file" or (params.source == "auto" and "end_effector" in frames.arrays):
        return from_file(frames)
    if params.source in ("stick", "glove"):
        return from_depth(frames, params)
    cameras, color, depth, time = cameras_of(frames), color_of(frames), depth_of(frames), frames["time"]
    model = params.hand_model or cached_weights("hand-landmarker")
    images = [color.of_camera(c) for c in range(len(cameras))]
    hands = 2 if _second_hand(images, time, model) else 1
    counted = context.counting(len(cameras) * len(time), "images")
    landmarks = np.stack([detect_hands(counted(of), time, model, hands)[0] for of in images], axis=1)
    rates = np.isfinite(landmarks).any((2, 3, 4)).mean(0)
    poor = [(c.name, of) for c, of, rate in zip(cameras, images, rates, strict=True) if rate < POOR]
    odd = _odd_colors(poor, model)
    if not rates.any():
        raise DataError(odd[0][1], f"{frames.path}, {odd[0][0]}", odd[0][2]) if odd else no_hand(frames, params)
    each = separate_hands(landmarks, depth.depth, cameras) if hands == 2 else landmarks[None, :, :, 0]
    tracks = [lift_hands(one, depth.depth, cameras, time, max_gap=params.max_gap) for one in each]
    ways = [travel(end_effector(track.keypoints)) for track in tracks]
    hand = tracks[int(np.argmax(ways))]
    arrays = {"landmarks": hand.pixels, "seen": hand.seen, "keypoints": hand.keypoints}
    arrays |= {"end_effector": end_effector(hand.keypoints), "observed": hand.observed, "time": time}
    quality, warnings = _told([c.name for c in cameras], hand, ways)
    warnings += [f"{names}: {text}\n  try: {hint}" for names, text, hint in odd]
    if params.source == "auto" and hand.observed.mean() < POOR:
        warnings += completed(arrays, frames, params)
    return Output(arrays, quality, warnings)


def _odd_colors(poor: "list[tuple[str, CameraImages]]", model: "Path") -> list[tuple[str, str, str]]:
    """What is wrong with the colours of cameras that hardly see a hand: their names, what it is, and what to do."""
    blue = ", ".join(name for name, images in poor if _exchanged(images, model))
    grey = ", ".join(name for name, images in poor if _is_grey(images))
    found = [(blue, BLUE, WRITE_RGB), (grey, NO_COLOR, WITH_COLOR)]
    return [one for one in found if one[0]]


def _exchanged(images: "CameraImages", model: "Path") -> bool:
    """Whether a camera shows a hand once red and blue are exchanged, and hardly one as it is."""
    import numpy as np

    from piegraph_cli.perception.hands import find_hands

    frames = np.unique(np.linspace(0, len(images) - 1, ASKED).round().astype(int))
    looks = [images[int(frame)] for frame in frames]
    as_is, other = (
        int(np.isfinite(find_hands(of, model, 1)[0]).any((1, 2, 3)).sum())
        for of in (looks, [np.ascontiguousarray(image[..., ::-1]) for image in looks])
    )
    return other >= ASKED // 2 and other > 2 * as_is


def _is_grey(images: "CameraImages") -> bool:
    """Whether a camera's images have no colours."""
    import numpy as np

    looks = [images[frame][::4, ::4].astype(int) for frame in {0, len(images) // 2}]
    return all(float(np.quantile(np.ptp(image, axis=-1), 0.999)) <= GREY for image in looks)


def _told(names: list[str], hand: "HandTrack", ways: list[float]) -> tuple[str, list[str]]:
    """The line on quality, and warnings; `ways` is how far (m) each hand that was seen goes."""
    rates = ", ".join(f"{name} {rate:.0%}" for name, rate in zip(names, hand.seen.mean(0), strict=True))
    quality = f"hand in {hand.seen.any(1).mean():.0%} of {len(hand.seen)} frames ({rates})"
    if len(ways) == 2:
        quality += f"; of two hands the one that moves {max(ways) * 1000:.0f} mm, not {min(ways) * 1000:.0f} mm"
    warnings = _without_depth(names, hand.seen, hand.deep)
    if len(ways) == 2 and min(ways) > BOTH_MOVE:
        warnings.append(
            f"two hands move, {ways[0] * 1000:.0f} and {ways[1] * 1000:.0f} mm: the one that moves more is taken"
        )
    if hand.observed.mean() < POOR:
        warnings.append(f"hand found in {hand.observed.mean():.0%} of the frames only: see `piegraph report`")
    return quality, warnings


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


def _second_hand(images: "list[CameraImages]", time: "np.ndarray", model: "Path") -> bool:
    """Whether two hands are seen in at least two of a few images."""
    import numpy as np

    from piegraph_cli.perception.hands import find_hands
    from piegraph_cli.perception.two_hands import look_frames, sees_two

    frames = look_frames(len(time))
    landmarks, score = find_hands((one[f] for one in images for f in frames), model, 2)
    return int(np.sum(sees_two(landmarks, score))) >= 2
