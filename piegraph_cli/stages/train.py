"""Stage `train`: what one model learns from the dataset, resumed from the last checkpoint."""

import math

import numpy as np
import torch
from torch import nn

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.models import MODELS, Trained
from piegraph_cli.dynamics.params import LEARNED, LearningParams, ModelParams, split_label
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.params import PICK
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages.dataset import TRAIN, VALIDATION
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.execute import Context, Output

RECORDS = 20
"""Losses are noted this many times in a training."""


def run(inputs: dict[str, Artifact], params: ModelParams, context: Context) -> Output:
    """Train one model on the dataset's training sequences."""
    set_up_torch()
    device = choose_device(context.device)
    name, _, count = split_label(params.label)
    learner = MODELS[name].learner
    assert learner is not None
    data, settings = read_sequences(inputs["dataset"], TRAIN, count, params.seed), params.settings
    held_out = read_sequences(inputs["dataset"], VALIDATION)
    validation = learner.examples(held_out, settings, device) if len(held_out.strokes) else None
    network = make_network(name, settings, data.picks, params.seed)
    trainer = Trainer(network, learner.examples(data, settings, device), validation, settings, params.seed, device)
    saved = context.checkpoint.load()
    if saved is not None:
        trainer.load(saved)
    every = max(1, settings.steps // RECORDS)
    writer = _tensorboard(context) if params.tensorboard else None
    for step in context.progress(range(trainer.done + 1, settings.steps + 1), "train"):
        trainer.step()
        if step % every == 0 or step == settings.steps:
            _, loss, found = trainer.record()
            if writer is not None:
                writer.add_scalar("loss/train", loss, step)
                writer.add_scalar("loss/validation", found, step)
        if step % params.checkpoint_every == 0 and step < settings.steps:
            context.checkpoint.save(trainer.state())
    steps, train, validation_loss = np.array(trainer.history).T
    arrays = {f"weights/{name}": value.cpu().numpy() for name, value in trainer.best.items()}
    arrays |= {"step": steps, "train_loss": train, "validation_loss": validation_loss}
    arrays["particles"] = np.array(data.positions.shape[1])
    arrays["modes"] = np.unique(data.mode)
    arrays["pace"] = np.array(data.pace)
    quality = f"loss {train[-1]:.4f} after {settings.steps} steps on {len(trainer.examples)} examples"
    if not math.isnan(trainer.best_loss) and validation is not None:
        quality += f", {trainer.best_loss:.4f} on validation"
    return Output(arrays, quality)


def make_network(name: str, settings: LearningParams, picks: bool, seed: int) -> nn.Module:
    """A network with fresh weights, drawn from the seed; `picks` where the data has picks."""
    torch.manual_seed(seed)
    learner = MODELS[name].learner
    assert learner is not None
    return learner.network(settings, picks)


def _tensorboard(context: Context):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingError("tensorboard is not installed", hint="pip install tensorboard") from None
    return SummaryWriter(str(context.run.folder / "tensorboard"))


def choose_device(name: str) -> str:
    """`cuda` or `cpu` from `auto`, `cuda` or `cpu`. Raises `MissingError` for an absent GPU."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise MissingError("no CUDA device", hint="use --device cpu")
    return name


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
