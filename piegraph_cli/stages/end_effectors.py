"""What stands in for the hand in a `hands` artifact: the path of an end-effector that came with the recording."""

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.hands import LANDMARKS
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.stage import Output

FILE = 1
"""As it is in the dataset `source`."""
POOR = 0.5
"""Share of frames with a position below which the user is warned."""


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
    low, high = np.reshape(frames.params["workspace"], (3, 2)).T
    if ((tips >= low) & (tips <= high)).all(axis=1).any():
        return None
    middle = ", ".join(f"{value:+.2f}" for value in np.median(tips, axis=0))
    return (
        f"the end-effector never comes into the workspace: its middle is x, y, z = {middle} m\n"
        "  try: give positions in the world of the cameras, not in the robot's frame; or check ingest.workspace"
    )
