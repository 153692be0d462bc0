"""What stands in for the hand in a `hands` artifact: a path that came with the recording, or what comes in by depth alone."""

from functools import partial

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.hands import LANDMARKS
from piegraph_cli.perception.incoming import find_tips, hand_tip, stick_tip
from piegraph_cli.perception.params import HandsParams
from piegraph_cli.stages.images import cameras_of, depth_of, workspace_of
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.stage import Output

FILE, INCOMING = 1, 2
"""As they are in the dataset `source`."""
POOR = 0.5
"""Share of frames with a position below which the user is warned."""

AGREE = 0.03
"""Metres by which what comes in may be beside the hand to stand in for it."""
SHOWN = 0.2
"""Share of frames in which something must come in to be named where no hand is found."""


def from_file(frames: Artifact) -> Output:
    """The end-effector that was recorded beside the cameras, as a `hands` artifact. Raises `DataError` without one."""
    if "end_effector" not in frames.arrays:
        raise DataError(
            "the recording has no end-effector",
            str(frames.path),
            "put end_effector.csv beside the sequence's cameras (docs/formats.md) and ingest again, or --source hand",
        )
    tips = frames["end_effector"]
    known = np.isfinite(tips).all(axis=1)
    away = _outside(tips[known], frames)
    warnings = [] if away is None else [away]
    if known.mean() < POOR:
        warnings.append(f"the end-effector is known in {known.mean():.0%} of the frames only")
    arrays = handless(frames, tips, known, np.full(len(tips), FILE))
    quality = f"end-effector from the recording, known in {known.mean():.0%} of {len(tips)} frames"
    if "opening" in frames.arrays:
        arrays["opening"] = frames["opening"]
        quality += ", with its opening"
    return Output(arrays, quality, warnings)


def from_depth(frames: Artifact, params: HandsParams) -> Output:
    """A stick or a gloved hand found in depth alone, as a `hands` artifact. Raises `DataError` where nothing comes in."""
    tips, known = tips_by_depth(frames, params)
    if not known.any():
        raise DataError(
            f"nothing comes in from above in frames 0 to {len(tips) - 1}",
            f"{frames.path}, cameras {', '.join(frames.texts('camera_name'))}",
            "check ingest.workspace; some frames, best the first, must show the object alone",
        )
    what = "stick" if params.source == "stick" else "hand"
    quality = f"tip of a {what} in {known.mean():.0%} of {len(tips)} frames, by depth alone"
    return Output(handless(frames, tips, known, np.full(len(tips), INCOMING)), quality)


def no_hand(frames: Artifact, params: HandsParams) -> DataError:
    """The error that no camera sees a hand; it names what can be taken instead where depth shows something come in."""
    shown = tips_by_depth(frames, params)[1].mean()
    hint = "check that the hand is in view and lit, or remove this sequence"
    if shown > SHOWN:
        hint = (
            f"depth shows something come in, in {shown:.0%} of the frames: take it with --source glove, or stick; "
            "otherwise check that the hand is lit"
        )
    return DataError(
        f"no camera sees a hand in frames 0 to {len(frames['time']) - 1}",
        f"{frames.path}, cameras {', '.join(frames.texts('camera_name'))}",
        hint,
    )


def completed(arrays: dict[str, np.ndarray], frames: Artifact, params: HandsParams) -> list[str]:
    """Put the tip of what comes in where the hand of `arrays` is unknown, and say so.

    Only if it is where the hand is in the frames in which both are known.
    """
    tips, known = tips_by_depth(frames, params)
    lost = np.isnan(arrays["end_effector"]).any(axis=1) & known
    apart = np.linalg.norm((tips - arrays["end_effector"])[known & ~lost, :2], axis=1)
    if not lost.any() or not len(apart) or np.median(apart) > AGREE:
        return []
    arrays["end_effector"] = np.where(lost[:, None], tips, arrays["end_effector"])
    arrays["source"] = np.where(lost, INCOMING, 0)
    agreement = f"which is {np.median(apart) * 1000:.0f} mm from the hand where both are known"
    return [f"in {lost.sum()} frames without a hand what comes in by depth is taken for it, {agreement}"]


def tips_by_depth(frames: Artifact, params: HandsParams) -> tuple[np.ndarray, np.ndarray]:
    """The tips [F, 3] (m, NaN unknown) of what comes in, a stick or a hand, and in which frames [F] they were seen."""
    cameras, depth = cameras_of(frames), depth_of(frames)
    own = [depth.of_camera(c, "depth") for c in range(len(cameras))]
    tip_of = partial(stick_tip, radius=params.stick_radius) if params.source == "stick" else hand_tip
    return find_tips(own, cameras, workspace_of(frames), frames["time"], tip_of, max_gap=params.max_gap)


def handless(frames: Artifact, tips: np.ndarray, known: np.ndarray, source: np.ndarray) -> dict[str, np.ndarray]:
    """The datasets of a `hands` artifact without landmarks: tips [F, 3] (m), where they are known, where from [F]."""
    shape = len(tips), len(frames["K"]), LANDMARKS
    return {
        "landmarks": np.full((*shape, 2), np.nan),
        "seen": np.zeros(shape[:2], bool),
        "keypoints": np.full((len(tips), LANDMARKS, 3), np.nan),
        "end_effector": tips,
        "observed": known,
        "source": source,
        "time": frames["time"],
    }


def _outside(tips: np.ndarray, frames: Artifact) -> str | None:
    """A warning where the path never comes into the workspace: then it is of another frame or clock."""
    low, high = workspace_of(frames).T
    if ((tips >= low) & (tips <= high)).all(axis=1).any():
        return None
    middle = ", ".join(f"{value:+.2f}" for value in np.median(tips, axis=0))
    return (
        f"the end-effector never comes into the workspace: its middle is x, y, z = {middle} m\n"
        "  try: give positions in the world of the cameras, not in the robot's frame; or check ingest.workspace"
    )
