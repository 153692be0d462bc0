"""What stages read of a dataset and of a trained model."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.models import Trained, make_network
from piegraph_cli.dynamics.params import LEARNED
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.evaluation.reliability import calibration_of
from piegraph_cli.params import PICK, validated
from piegraph_cli.physics.particles import Sizes
from piegraph_cli.workspace.artifact import Artifact


def read_sequences(data: Artifact, split: int, count: int | None = None, seed: int = 0) -> Sequences:
    """The sequences of one split, or `count` of them, which the seed chooses. Raises `UsageError` for more than there are."""
    chosen = np.flatnonzero(data["sequence_split"] == split)
    if count is not None and count > len(chosen):
        raise UsageError(
            f"{len(chosen)} sequences to train on, {count} are asked for",
            str(data.path),
            "a larger dataset.train, or a smaller number after @",
        )
    if count is not None:
        chosen = np.sort(np.random.default_rng([seed, count]).permutation(chosen)[:count])
    strokes = np.flatnonzero(np.isin(data["stroke_sequence"], chosen))
    pairs = np.isin(data["pair_stroke"], strokes)
    return Sequences(
        positions=data["positions"],
        hand=data["end_effector"],
        strokes=data["strokes"][strokes],
        mode=data["stroke_mode"][strokes],
        owner=np.searchsorted(chosen, data["stroke_sequence"][strokes]),
        rest=data["positions"][data["sequence_start"][chosen]],
        pairs=data["pairs"][pairs],
        pair_stroke=np.searchsorted(strokes, data["pair_stroke"][pairs]),
        seen=None if data["seen"].all() else data["seen"],
    )


def read_model(model: Artifact) -> Trained:
    """What a model artifact holds. Raises `DataError` where it does not say what it is, or the weights do not fit that."""
    label, seed, where = model.params.get("label"), model.params.get("seed"), str(model.path)
    name = str(label).partition("@")[0].partition(":")[0]
    if name not in LEARNED or type(seed) is not int or seed < 0:
        raise DataError(f"does not hold a model that is known: {str(label)[:40]!r}", where, "piegraph train --force")
    try:
        settings = validated(LEARNED[name], model.params.get("settings"), name, where, "piegraph train --force")
    except UsageError as error:
        raise DataError(error.message, error.where, error.hint) from None
    if (revision := model.params.get("revision", 1)) != settings.revision:
        message = f"{name} of revision {revision}, this piegraph has revision {settings.revision}"
        raise DataError(message, where, "piegraph train --force")
    network = make_network(name, settings, PICK in model["modes"], seed)
    weights = {
        n.removeprefix("weights/"): torch.as_tensor(v) for n, v in model.arrays.items() if n.startswith("weights/")
    }
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise DataError(f"weights do not fit: {reason}", str(model.path), "piegraph train --force") from None
    modes = tuple(int(mode) for mode in model["modes"])
    network = network.eval().requires_grad_(False)
    sizes = Sizes.of_array(model["size"])
    return Trained(network, settings, float(model["pace"]), modes, int(model["particles"]), model["rest"], sizes)


def calibrated(trained: Trained, metrics: Artifact | None) -> Trained:
    """With the errors to expect of its predictions, as its metrics tell them; as it is where there are none."""
    return trained if metrics is None else replace(trained, calibration=calibration_of(metrics.arrays))


def read_sequence(data: Artifact, index: int) -> dict[str, Any]:
    """One sequence: `rest` [N, 3], and per stroke `before`, `after` [S, N, 3], `strokes`, `follows` [S], `frames` [S, 2].

    `seen` [2, S, N]: the particles whose places are known before and after each stroke.
    """
    chosen = data["stroke_sequence"] == index
    first, last = data["strokes"][chosen].T
    hand = data["end_effector"]
    start = int(data["sequence_start"][index])
    return {
        "rest": data["positions"][start],
        "before": data["positions"][first],
        "after": data["positions"][last],
        "strokes": Strokes.of(hand[first], hand[last], data["stroke_mode"][chosen]),
        "follows": data["stroke_follows"][chosen],
        "frames": np.stack([first, last], 1) - start,
        "seen": data["seen"][np.stack([first, last])],
    }
