"""Stage `train`: the network's weights, resumed from the last checkpoint."""

import numpy as np
import torch

from piegraph_cli.dynamics.action import make_strokes
from piegraph_cli.dynamics.egnn import EGNN
from piegraph_cli.dynamics.training import Pairs, Trainer, make_network
from piegraph_cli.errors import DataError, MissingError
from piegraph_cli.params import PICK, TrainParams
from piegraph_cli.process import set_up_torch
from piegraph_cli.stages.dataset import TRAIN, VALIDATION
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.execute import Context, Output

RECORDS = 50
"""Losses are noted this many times in a training."""


def run(inputs: dict[str, Artifact], params: TrainParams, context: Context) -> Output:
    """Train on the dataset's training sequences."""
    set_up_torch()
    device = choose_device(context.device)
    data = inputs["dataset"]
    validation = read_pairs(data, VALIDATION, params.neighbors, device)
    trainer = Trainer(read_pairs(data, TRAIN, params.neighbors, device), validation, params, device)
    saved = context.checkpoint.load()
    if saved is not None:
        trainer.load(saved)
    every = max(1, params.steps // RECORDS)
    writer = _tensorboard(context) if params.tensorboard else None
    for step in context.progress(range(trainer.done + 1, params.steps + 1), "train"):
        trainer.step()
        if step % every == 0 or step == params.steps:
            _, loss, held_out = trainer.record()
            if writer is not None:
                writer.add_scalar("loss/train", loss, step)
                writer.add_scalar("loss/validation", held_out, step)
        if step % params.checkpoint_every == 0 and step < params.steps:
            context.checkpoint.save(trainer.state())
    steps, train, validation_loss = np.array(trainer.history).T
    arrays = {f"weights/{name}": value.cpu().numpy() for name, value in trainer.best.items()}
    arrays |= {"step": steps, "train_loss": train, "validation_loss": validation_loss}
    arrays["particles"] = np.array(data["positions"].shape[1])
    arrays["modes"] = np.unique(trainer.pairs.strokes[:, 4].cpu().numpy()).astype(np.uint8)
    quality = f"loss {train[-1]:.4f} dm^2 after {params.steps} steps on {len(trainer.pairs)} pairs"
    return Output(arrays, quality)


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


def read_pairs(data: Artifact, split: int, neighbors: int, device: str) -> Pairs:
    """The training pairs of one split."""
    chosen = data["sequence_split"][data["stroke_sequence"][data["pair_stroke"]]] == split
    first, last = data["pairs"][chosen].T
    stroke = data["pair_stroke"][chosen]
    begin, finish = data["strokes"][stroke].T
    hand, positions = data["end_effector"], data["positions"]
    strokes = make_strokes(
        hand[first], hand[last], data["stroke_mode"][stroke], np.stack([first > begin, last < finish], 1)
    )
    apart = np.linalg.norm(positions[data["strokes"][:, 0], :, :2] - hand[data["strokes"][:, 0], None], axis=-1)
    rest, owner = positions[data["sequence_start"]], data["stroke_sequence"][stroke]
    grasp = apart.argmin(-1)[stroke]
    return Pairs(positions[first], positions[last], strokes.numpy(), rest, owner, grasp, neighbors, device)


def read_network(model: Artifact) -> EGNN:
    """The trained network of a model artifact. Raises `DataError` where the weights do not fit its settings."""
    fields = {name: model.params[name] for name in TrainParams.model_fields if name in model.params}
    network = make_network(TrainParams(**fields), PICK in model["modes"])
    weights = {
        n.removeprefix("weights/"): torch.as_tensor(v) for n, v in model.arrays.items() if n.startswith("weights/")
    }
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise DataError(f"weights do not fit: {reason}", str(model.path), "piegraph train --force") from None
    return network.eval()
