"""Stage `dataset`: strokes cut from the hand's path and contact, training pairs of frames, a split by sequence."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit

if TYPE_CHECKING:
    from piegraph_cli.workspace.run import Run


def _units(run: "Run") -> Sequence[Unit]:
    return [None]


def _inputs(run: "Run", unit: Unit) -> Inputs:
    """All tracks that could be made."""
    return {"tracks": run.made("tracks")}


STAGE = Stage(
    "dataset",
    "cut strokes, pair frames, split",
    ("tracks",),
    "dataset",
    DatasetParams,
    version=1,
    run="piegraph_cli.stages.dataset:run",
    unit="run",
    units=_units,
    inputs=_inputs,
)


def run(inputs: dict[str, Any], params: DatasetParams, context: Context) -> Output:
    """Build the dataset of all tracked sequences."""
    from piegraph_cli.dynamics.dataset import TEST, TRAIN, VALIDATION, build_dataset

    arrays, empty = build_dataset(dict(inputs["tracks"]), params)
    counts = [int((arrays["sequence_split"] == part).sum()) for part in (TRAIN, VALIDATION, TEST)]
    split = f"sequences: {counts[0]} train, {counts[1]} validation, {counts[2]} test"
    quality = f"{len(arrays['strokes'])} strokes, {len(arrays['pairs'])} pairs; {split}"
    warnings = [f"no stroke in {', '.join(empty)}: check the hand with `piegraph report`"] if empty else []
    return Output(arrays, quality, warnings)
