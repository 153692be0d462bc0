"""What stages read of a dataset, and models of runs and files."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.models import Trained, make_network
from piegraph_cli.dynamics.params import LEARNED, split_label, trained_label
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK, validated
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages import open_run, train
from piegraph_cli.workspace.artifact import Artifact, read_artifact, write_artifact


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
    )


def read_model(model: Artifact) -> Trained:
    """What a model artifact holds. Raises `DataError` where the weights do not fit its settings."""
    name = split_label(model.params["label"])[0]
    settings = LEARNED[name].model_validate(model.params["settings"])
    network = make_network(name, settings, PICK in model["modes"], model.params["seed"])
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
    return Trained(network, settings, float(model["pace"]), modes, int(model["particles"]))


def load_model(source: Path | str, label: str | None = None, *, seed: int | None = None) -> Model:
    """A model of a run folder, by label (`piegraph`) and seed (the first trained), or of one file.

    A file may come from another computer: it is one of RUN/model, or of `save_model`, which keeps the settings to plan with
    too. In a run these are its recipe's. Raises `DataError` where there is no such model.
    """
    set_up_torch()
    path = Path(source)
    if path.is_dir():
        label = label or "piegraph"
        artifact, plan = _model_of_run(path, label, seed)
        return Model(label, read_model(artifact) if artifact else None, plan)
    artifact = read_artifact(path, "model")
    own = artifact.params["label"]
    if label is not None and trained_label(label) != own:
        raise DataError(f"holds {own}, not {label}", str(path), "another file, or no label")
    plan = validated(PlanParams, artifact.params.get("plan", {}), "plan", str(path), "another model file")
    return Model(label or own, read_model(artifact), plan)


def save_model(run: Path | str, path: Path | str, label: str = "piegraph", *, seed: int | None = None) -> None:
    """Write a trained model of a run folder, with the run's settings to plan with, as one file for `load_model`.

    Raises `DataError` where it is not trained, or the disk is full.
    """
    artifact, plan = _model_of_run(Path(run), label, seed)
    if artifact is None:
        raise DataError(f"{label} is not trained: there is nothing to save", str(run), "another label")
    settings = plan.model_dump(mode="json", exclude={*PlanParams.query, "model", "daxbench_python", "daxbench_repo"})
    write_artifact(
        Path(path),
        "model",
        artifact.arrays,
        stage=train.STAGE.name,
        stage_version=train.STAGE.version,
        key=artifact.key,
        params=artifact.params | {"plan": settings},
        inputs=artifact.inputs,
        quality=artifact.quality,
    )


def _model_of_run(folder: Path, label: str, seed: int | None) -> tuple[Artifact | None, PlanParams]:
    """What a model of a run has learned, if anything, and the run's settings to plan with."""
    run = open_run(folder)
    seeds = run.params("train").seeds_of(label)
    own = train.trained_name(train.model_name(label, seeds[0] if seed is None else seed))
    plan = run.params("plan").model_copy(update=dict.fromkeys(PlanParams.query))
    return run.read("model", own) if own else None, plan


def read_sequence(data: Artifact, index: int) -> dict[str, Any]:
    """One sequence: `rest` [N, 3], and per stroke `before`, `after` [S, N, 3], `strokes` [S], `frames` [S, 2]."""
    chosen = data["stroke_sequence"] == index
    first, last = data["strokes"][chosen].T
    hand = data["end_effector"]
    start = int(data["sequence_start"][index])
    return {
        "rest": data["positions"][start],
        "before": data["positions"][first],
        "after": data["positions"][last],
        "strokes": Strokes.of(hand[first], hand[last], data["stroke_mode"][chosen]),
        "frames": np.stack([first, last], 1) - start,
    }
