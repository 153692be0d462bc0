"""Stage `dataset`: strokes cut from the hand's path and contact, training pairs of frames, a split by sequence."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.errors import DataError
from piegraph_cli.text import counted
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit

if TYPE_CHECKING:
    from pathlib import Path

    from piegraph_cli.dynamics.dataset import Found
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
    version=3,
    run="piegraph_cli.stages.dataset:run",
    unit="run",
    units=_units,
    inputs=_inputs,
)


def run(inputs: dict[str, Any], params: DatasetParams, context: Context) -> Output:
    """Build the dataset of all tracked sequences, or of those that a split by name names."""
    from piegraph_cli.dynamics.alike import find_unlike
    from piegraph_cli.dynamics.dataset import build_dataset
    from piegraph_cli.dynamics.splits import PARTS, chosen_sequences, with_split

    tracks = inputs["tracks"]
    if params.split is not None:
        params = with_split(params, _read_split(params.split))
    chosen = chosen_sequences(list(tracks), params)
    arrays, found = build_dataset({name: tracks[name] for name in chosen}, params)
    split = ", ".join(f"{int((arrays['sequence_split'] == number).sum())} {part}" for part, number in PARTS.items())
    quality = [
        f"{counted(len(arrays['strokes']), 'stroke')}, {counted(len(arrays['pairs']), 'pair')}",
        f"sequences: {split}",
    ]
    left, warnings = _left_out(found)
    warnings += find_unlike({name: tracks[name] for name in chosen})
    if len(chosen) < len(tracks):
        quality.append(f"{counted(len(tracks) - len(chosen), 'sequence')} in no part of the split")
    return Output(arrays, "; ".join(quality + left), warnings)


def _read_split(path: "Path") -> dict[str, list[str]]:
    from piegraph_cli.dynamics.splits import parse_split
    from piegraph_cli.recording.text import read_text

    text = read_text(path, "a line NAME,PART per sequence")
    try:
        return parse_split(text)
    except DataError as error:
        raise DataError(error.message, f"{path}, {error.where}", error.hint) from None


def _left_out(found: "Mapping[str, Found]") -> tuple[list[str], list[str]]:
    """What is not in the dataset, or was cut: for the quality line, and as warnings that name the sequences."""
    import numpy as np

    quality, warnings = [], []
    unseen = {name: of for name, of in found.items() if of.unseen}
    if unseen:
        frames, strokes, pairs = (
            sum(getattr(of, what) for of in unseen.values()) for what in ("unseen", "strokes_lost", "pairs_lost")
        )
        quality.append(f"left out, object not seen: {counted(strokes, 'stroke')}, {counted(pairs, 'pair')}")
        where = ", ".join(f"{name} ({of.unseen} frames)" for name, of in unseen.items())
        warnings.append(
            f"{frames} frames see too little of the object or are not trusted, so {strokes} strokes and {pairs} pairs are "
            f"left out: {where}; "
            "look at the clouds with `piegraph report`, or lower min_seen"
        )
    hidden = float(np.mean([of.particles_unseen for of in found.values()]))
    if hidden > 0:
        quality.append(f"{hidden:.0%} of the particles not seen, which teach nothing")
    bent = {name: of.cut for name, of in found.items() if of.cut.bent}
    if bent:
        pushes, pieces, short = (
            sum(getattr(cut, what) for cut in bent.values()) for what in ("bent", "pieces", "short")
        )
        quality.append(f"cut where they bend: {pushes} pushes into {pieces} pieces, {short} of them too short to keep")
        warnings.append(
            f"{pushes} pushes bend by more than max_bend and are cut, in {', '.join(bent)}: push straight and lift the hand"
        )
    empty = [name for name, of in found.items() if len(of.strokes) == 0]
    if empty:
        warnings.append(f"no stroke in {', '.join(empty)}: check the hand with `piegraph report`")
    return quality, warnings
