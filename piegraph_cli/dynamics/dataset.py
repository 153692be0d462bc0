"""A dataset: strokes cut from the hand's path and contact, training pairs of frames, a split by sequence."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from piegraph_cli.dynamics.cutting import cut_strokes, frame_pairs
from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.errors import DataError

TRAIN, VALIDATION, TEST = 0, 1, 2

Arrays = Mapping[str, np.ndarray]


def build_dataset(tracks: Mapping[str, Arrays], params: DatasetParams) -> tuple[dict[str, np.ndarray], list[str]]:
    """The datasets of a dataset artifact, from the arrays of tracks by sequence, and the sequences without a stroke.

    Raises `DataError` where no stroke is found, or particles differ in number.
    """
    _check_particles(tracks)
    columns: dict[str, list[Any]] = {name: [] for name in ("strokes", "owner", "mode", "pairs", "pair_stroke", "start")}
    frames, stroke_count, empty = 0, 0, []
    for index, (name, artifact) in enumerate(tracks.items()):
        strokes = cut_strokes(artifact["end_effector"], artifact["contact"], params.min_stroke)
        if len(strokes) == 0:
            empty.append(name)
        columns["start"].append(frames)
        for first, last in strokes:
            pairs = frame_pairs(first, last, artifact["end_effector"], params.min_gap)
            columns["strokes"].append([first + frames, last + frames])
            columns["owner"].append(index)
            columns["mode"].append(artifact["mode"][first])
            columns["pairs"] += (pairs + frames).tolist()
            columns["pair_stroke"] += [stroke_count] * len(pairs)
            stroke_count += 1
        frames += len(artifact["time"])
    if not stroke_count:
        raise DataError(
            "no stroke was found in any sequence", hint="check the hand with `piegraph report`, or lower min_stroke"
        )
    split = split_sequences(list(tracks), params, set(empty))
    arrays = {
        "positions": np.concatenate([a["positions"] for a in tracks.values()]),
        "end_effector": np.nan_to_num(np.concatenate([a["end_effector"][:, :2] for a in tracks.values()])),
        "strokes": np.array(columns["strokes"]),
        "stroke_sequence": np.array(columns["owner"]),
        "stroke_mode": np.array(columns["mode"]),
        "pairs": np.array(columns["pairs"], np.int64).reshape(-1, 2),
        "pair_stroke": np.array(columns["pair_stroke"]),
        "sequence_name": np.array(list(tracks)),
        "sequence_start": np.array(columns["start"]),
        "sequence_split": split,
    }
    return arrays, empty


def split_sequences(names: list[str], params: DatasetParams, empty: set[str]) -> np.ndarray:
    """Split [sequence]: the first `train` of a seeded order train, the next `validation` validate, the rest test.

    Sequences without strokes go last. Raises `DataError` when there is no sequence left to test on.
    """
    order = np.random.default_rng(params.seed).permutation(len(names))
    order = np.array(sorted(order, key=lambda i: names[i] in empty))
    if len(names) - len(empty) <= params.train + params.validation:
        raise DataError(
            f"{len(names) - len(empty)} sequences with strokes, of which {params.train} are to train and "
            f"{params.validation} to validate: none is left to test on",
            hint="record more, or lower dataset.train",
        )
    split = np.full(len(names), TEST, np.uint8)
    split[order[: params.train]] = TRAIN
    split[order[params.train : params.train + params.validation]] = VALIDATION
    return split


def _check_particles(tracks: Mapping[str, Arrays]) -> None:
    counts = {name: artifact["positions"].shape[1] for name, artifact in tracks.items()}
    if len(set(counts.values())) > 1:
        raise DataError(f"sequences differ in particles: {counts}", hint="track all with the same --particles")
