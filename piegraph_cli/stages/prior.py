"""Priors: how one is made by `piegraph pretrain`, kept as a file, and read for a training to begin with.

What a prior has seen is written in its file.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.dynamics.family.params import PretrainParams
from piegraph_cli.dynamics.params import EGNNParams, FittedParams
from piegraph_cli.errors import DataError
from piegraph_cli.params import validated
from piegraph_cli.text import counted
from piegraph_cli.workspace.stage import Stage

if TYPE_CHECKING:
    from piegraph_cli.dynamics.prior import Pretraining, Prior
    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.execute import Checkpoint

HINT = "--from prior, one of those that are shipped, or a file of piegraph pretrain"
TUNING: dict[str, Any] = {"steps": 600, "learning_rate": 1e-3, "batch": 16, "cycles": 1, "clip": 1.0}
"""How a prior learns from a recording; how many steps its family says."""
KEPT_EVERY = 500
"""Steps between checkpoints."""

PRETRAIN = Stage(
    "pretrain",
    "train a prior on random objects",
    (),
    "prior",
    PretrainParams,
    version=1,
    run="piegraph_cli.stages.prior:pretrain",
)
"""Belongs to no run: what it makes is a file by itself."""


def adopted(settings: FittedParams) -> FittedParams:
    """Settings with the size of the prior's network, where they name a prior, and with how such a one learns.

    Where the file is no prior they stay, and training says so.
    """
    if not isinstance(settings, EGNNParams) or settings.prior is None:
        return settings
    from piegraph_cli.workspace.artifact import read_header

    file = next(iter(settings.files().values()))
    header = read_header(file, PRETRAIN.writes)
    if header is None or header.version != PRETRAIN.version:
        return settings
    seen = _params(header.params, file)
    shape = {name: getattr(seen, name) for name in ("neighbors", "hidden", "layers")}
    plain = EGNNParams().model_dump(exclude={"prior"})
    return EGNNParams(**plain | shape | TUNING, prior=settings.prior)


def read_prior(path: Path) -> "tuple[Prior, list[str]]":
    """A prior and the simulators that its strokes came from.

    Raises `DataError` for a file that is none, or of another version.
    """
    import torch

    from piegraph_cli.dynamics.action import FEATURES
    from piegraph_cli.dynamics.prior import make_prior
    from piegraph_cli.workspace.artifact import read_artifact, read_header

    header = read_header(path, PRETRAIN.writes)
    if header is not None and header.version != PRETRAIN.version:
        made = f"a prior of version {header.version}, this is version {PRETRAIN.version}"
        raise DataError(made, str(path), "make it anew: piegraph pretrain")
    try:
        artifact = read_artifact(path, PRETRAIN.writes, foreign=True)
    except DataError as error:
        raise DataError(f"no prior that can be used: {error.message}", error.where or str(path), HINT) from None
    params = _params(artifact.params, path)
    weights = {name.removeprefix("weights/"): torch.as_tensor(value) for name, value in _weights(artifact)}
    given = weights.get("network.embed.weight")
    if given is not None and given.shape[-1] != FEATURES:
        told = f"takes {given.shape[-1]} features of a particle, there are {FEATURES}"
        raise DataError(told, str(path), "make it anew: piegraph pretrain")
    prior = make_prior(params, False, params.seed)
    try:
        prior.load_state_dict(weights)
    except RuntimeError as error:
        raise DataError(f"weights do not fit: {str(error).splitlines()[-1].strip()}", str(path), HINT) from None
    return prior.requires_grad_(True), [str(name) for name in artifact.params.get("simulators", [])]


def _weights(artifact: "Artifact") -> Iterable[tuple[str, Any]]:
    return ((name, value) for name, value in artifact.arrays.items() if name.startswith("weights/"))


def _params(told: Any, path: Path) -> PretrainParams:
    values = json.loads(told) if isinstance(told, str) else told
    settings = values.get("settings") if isinstance(values, dict) else None
    return validated(PretrainParams, settings, "settings", str(path), HINT)


def pretrain(params: PretrainParams, out: Path, hours: float | None, tell: Any) -> dict[str, Any] | None:
    """Train a prior and write it to `out`; interrupted or out of time it goes on from there the next time.

    `tell(iterable)` shows how far it is. Returns what is told of it, None where the hours ended before the steps.
    """
    import time

    from piegraph_cli.dynamics.prior import Pretraining, make_prior
    from piegraph_cli.process import set_up_torch
    from piegraph_cli.workspace.execute import Checkpoint

    set_up_torch()
    checkpoint = Checkpoint(out.with_name(f".{out.stem}.checkpoint.h5"), PRETRAIN, key_of(params))
    training = Pretraining(make_prior(params, False, params.seed), params)
    saved = checkpoint.load()
    if saved is not None:
        training.load(saved)
    end = None if hours is None else time.monotonic() + 3600 * hours
    for _ in tell(range(training.done, params.steps)):
        training.step()
        if training.done % KEPT_EVERY == 0 and not training.finished:
            checkpoint.save(training.state())
            if end is not None and time.monotonic() > end:
                return None
    told = _write(training, params, out, checkpoint)
    checkpoint.path.unlink(missing_ok=True)
    return told


def _write(training: "Pretraining", params: PretrainParams, out: Path, checkpoint: "Checkpoint") -> dict[str, Any]:
    """Write what was learned, beside what it has seen; returns what is told of it."""
    from piegraph_cli.workspace.artifact import write_artifact

    spent, loss = checkpoint.clock.spent(), training.history[-1][1]
    about = described(params, spent["cpu_ms"] / 60_000)
    write_artifact(
        out,
        PRETRAIN.writes,
        _arrays(training),
        stage=PRETRAIN.name,
        stage_version=PRETRAIN.version,
        key=checkpoint.key,
        params=about,
        inputs={},
        quality=f"loss {loss:.4f} after {counted(training.done, 'step')}",
        spent=spent,
    )
    return about | {"loss": loss, "file": str(out)}


def key_of(params: PretrainParams) -> str:
    """The key of the prior that these settings make."""
    text = json.dumps([PRETRAIN.name, PRETRAIN.version, params.content()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _arrays(training: "Pretraining") -> dict[str, Any]:
    import numpy as np

    steps, losses = np.array(training.history).T
    weights = {f"weights/{name}": value.numpy() for name, value in training.prior.state_dict().items()}
    return weights | {"step": steps, "loss": losses}


def described(params: PretrainParams, minutes: float) -> dict[str, Any]:
    """What a prior has seen, for its file and for people."""
    from piegraph_cli.dynamics.prior import FAMILIES

    family = FAMILIES[params.family]
    return {
        "settings": params.content(),
        "simulators": [family.simulator],
        "seen": family.seen,
        "strokes": params.steps * params.batch,
        "cpu_minutes": round(minutes, 1),
    }
