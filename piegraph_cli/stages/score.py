"""Stage `score`: a simulated recording's perception and tracking against its truth.h5, which nothing else reads."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.params import ScoreParams
from piegraph_cli.stages import ingest
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.run import Run


def _units(run: "Run") -> Sequence[Unit]:
    """The sequences that have a truth, or were scored before the recording went."""
    names = run.units(ingest.STAGE)
    return [n for n in names if n and (_truth_file(run, n).is_file() or run.path("scores", n).is_file())]


STAGE = Stage(
    "score",
    "score a simulated recording against its truth",
    ("frames", "hands", "masks", "clouds", "tracks"),
    "scores",
    ScoreParams,
    version=1,
    run="piegraph_cli.stages.score:run",
    units=_units,
)


def _truth_file(run: "Run", sequence: str) -> Path:
    return ingest.sequence_folder(run, sequence) / "truth.h5"


def read_truth(run: "Run", sequence: str) -> "Artifact | None":
    """The truth of a sequence in the run's world, whose table is z = 0, or None for a recording that has none."""
    from piegraph_cli.recording.ground import level, moved
    from piegraph_cli.workspace.artifact import read_artifact

    try:
        path = _truth_file(run, sequence)
    except DataError:  # what is gone has no truth
        return None
    if not path.is_file():
        return None
    truth, T = read_artifact(path, "truth", foreign=True), level(run.params(ingest.STAGE.name).table)
    points = {"particles", "vertices", "hand_keypoints", "end_effector"} & truth.arrays.keys()
    placed = {name: moved(truth[name], T) for name in points}
    placed |= {name: T @ values for name, values in truth.arrays.items() if name.startswith("pose/")}
    return replace(truth, arrays=truth.arrays | placed)


def run(inputs: dict[str, Any], params: ScoreParams, context: Context) -> Output:
    """Score one sequence; one whose truth is gone gives no scores and no true positions."""
    import numpy as np

    from piegraph_cli.evaluation.scores import AT_ENDS, score_sequence
    from piegraph_cli.evaluation.truth import carry_with_mesh
    from piegraph_cli.stages.images import source_frames

    tracked = inputs["tracks"]["positions"]
    truth = read_truth(context.run, str(context.unit))
    scores: list[tuple[str, float]] = []
    true = np.zeros((0, *tracked.shape[1:]), np.float32)
    if truth is not None:
        rows = source_frames(inputs["frames"])
        true = carry_with_mesh(tracked[0], truth["vertices"][rows], truth["triangles"], 0).astype(np.float32)
        scores = list(score_sequence(inputs, truth.arrays, true, rows))
    arrays = {
        "score_name": np.array([name for name, _ in scores], "S128"),
        "score_value": np.array([value for _, value in scores], float),
        "true_positions": true,
    }
    at_ends = [value for name, value in scores if name == AT_ENDS]
    quality = f"{np.mean(at_ends):.1f} mm from the truth at stroke ends" if at_ends else "no truth to score against"
    return Output(arrays, quality)
