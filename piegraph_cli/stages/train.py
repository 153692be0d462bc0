"""Stage `train`: what one model learns from the dataset, resumed from the last checkpoint.

A unit is a model trained from one seed, `pgnd@20.seed1`; so a larger grid keeps what is done.
"""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.dynamics.params import (
    LEARNED,
    PRIOR,
    SHIPPED_PRIORS,
    EGNNParams,
    ModelParams,
    TrainParams,
    split_label,
    trained_label,
)
from piegraph_cli.errors import MissingError, UsageError, command_line
from piegraph_cli.params import validated
from piegraph_cli.stages.prior import adopted
from piegraph_cli.text import counted
from piegraph_cli.workspace.call import Call, Given, Option, options_of
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit

if TYPE_CHECKING:
    from piegraph_cli.dynamics.training import Trainer
    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.run import Run

RIGID = "; the object moves rigidly: `piegraph train --model rigid` learns that from fewer strokes"
"""Said once, of piegraph."""

RECORDS = 20
"""Losses are noted this many times in the first cycle of a training."""


def model_name(label: str, seed: int) -> str:
    """`pgnd@20.seed1`; or `static` alone, where nothing is trained."""
    return label if trained_label(label) is None else f"{label}.seed{seed}"


def split_model(name: str) -> tuple[str, int]:
    """Label and seed of a `model_name`; seed 0 where there is none."""
    label, _, seed = name.partition(".seed")
    return label, int(seed or 0)


def trained_name(name: str) -> str | None:
    """The trained model that a model uses: `piegraph.seed1` for `piegraph-ng.seed1`; None where nothing is trained."""
    label, seed = split_model(name)
    own = trained_label(label)
    return None if own is None else model_name(own, seed)


def model_names(labels: tuple[str, ...], train: TrainParams) -> list[str]:
    """Models by name, from every seed that they are trained from."""
    return list(dict.fromkeys(model_name(label, seed) for label in labels for seed in train.seeds_of(label)))


def _units(run: "Run") -> Sequence[Unit]:
    params = run.params(STAGE.name)
    return model_names(params.models, params)


def _settings(run: "Run", unit: str) -> ModelParams:
    params, (label, seed) = run.params(STAGE.name), split_model(unit)
    return ModelParams(
        label=label,
        seed=seed,
        settings=adopted(params.of(label)),
        checkpoint_every=params.checkpoint_every,
        tensorboard=params.tensorboard,
    )


def _inputs(run: "Run", unit: Unit) -> Inputs:
    return {"dataset": None}


def _command(run: "Run", unit: Unit) -> str:
    """A model that the recipe does not train needs a call of its own."""
    if unit in run.units(STAGE):
        return command_line("run", "--run", run.folder, "--until", "train")
    label, seed = split_model(str(unit))
    return command_line("train", "--run", run.folder, "--model", label, "--seed", seed)


_OF_ALL = ("checkpoint_every", "tensorboard")
"""Settings that are not those of one model."""


def _options() -> dict[str, Option]:
    """A model, its seeds, and every setting of any model: what it means, and whose it is with which default."""
    model = f"model to train, beside the run's others; pgnd@20: on 20 sequences; one of {', '.join(LEARNED)}"
    options = {
        "model": Option(str, model, "all of the run"),
        "seed": Option(
            str, "seeds, as in 0,1,2, of weights, batches and choice of sequences; with --model, of this model"
        ),
    }
    by_name: dict[str, dict[str, Option]] = {}
    for learner, params in LEARNED.items():
        for name, option in options_of(params).items():
            by_name.setdefault(name, {})[learner] = option
    by_name["from_"] = by_name.pop("prior")
    for name, of in by_name.items():
        whose = {o.default: [model for model, other in of.items() if other.default == o.default] for o in of.values()}
        models = "; ".join(", ".join(m) + (f" [default: {default}]" if default else "") for default, m in whose.items())
        meanings = ", or: ".join(dict.fromkeys(option.meaning for option in of.values()))
        options[name] = Option(next(iter(of.values())).kind, f"{meanings} ({models})")
    return options | {name: option for name, option in options_of(TrainParams).items() if name in _OF_ALL}


def _apply(run: "Run", given: Given) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Settings of the call's model, and its units from the seeds of the call: the run's other models are left alone.

    A model that the run has already keeps its seeds beside those of the call. Without a model, seeds are those of all.
    """
    values = {name: value for name, value in given.items() if name in _OF_ALL}
    settings = {name: value for name, value in given.items() if name not in (*_OF_ALL, "model", "seed")}
    params: TrainParams = run.params(STAGE.name)
    model, seeds = given.get("model"), _seeds(given.get("seed"))
    label = (trained_label(model) or model) if model else "piegraph"
    if "from_" in settings:
        settings["prior"] = settings.pop("from_")
    if settings:
        name = re.split("[:@]", label)[0]
        values[name] = run.recipe.sections.get(STAGE.name, {}).get(name, {}) | settings
    if model is None:
        return values | ({"seeds": seeds} if seeds else {}), ()
    named = "models" in run.recipe.sections.get(STAGE.name, {})
    known = [other for other in params.models if named or any((run.folder / "model").glob(f"{other}.seed*.h5"))]
    if seeds:
        own = params.seeds_of(label) if label in known else ()
        values["model_seeds"] = params.model_seeds | {label: tuple(dict.fromkeys((*own, *seeds)))}
    names = tuple(model_name(label, seed) for seed in seeds or params.seeds_of(label))
    return values | {"models": list(dict.fromkeys([*known, label]))}, names


def _seeds(text: str | None) -> tuple[int, ...]:
    """The seeds of the command line, checked; none where it names none."""
    if text is None:
        return ()
    return validated(TrainParams, {"seeds": text}, "train", "piegraph train", "piegraph train --help").seeds


STAGE = Stage(
    "train",
    "train models",
    ("dataset",),
    "model",
    TrainParams,
    version=7,
    run="piegraph_cli.stages.train:run",
    unit="model",
    units=_units,
    settings=_settings,
    inputs=_inputs,
    command=_command,
    call=Call(
        more="Settings are those of --model (piegraph where it is left out); those that it does not have are refused.",
        first=("model", "seed", "from_", "steps", "batch", "learning_rate", "hidden", "layers"),
        options=_options,
        apply=_apply,
    ),
)


def run(inputs: dict[str, Any], params: ModelParams, context: Context) -> Output:
    """Train one model on the dataset's training sequences."""
    from piegraph_cli.dynamics.models import MODELS, make_network
    from piegraph_cli.dynamics.params import LearningParams
    from piegraph_cli.dynamics.rigid_body import RigidBody, is_rigid
    from piegraph_cli.dynamics.splits import TRAIN, VALIDATION
    from piegraph_cli.dynamics.spring_fit import SMS
    from piegraph_cli.dynamics.training import Trainer
    from piegraph_cli.process import choose_device, set_up_torch
    from piegraph_cli.stages.comparing import advice
    from piegraph_cli.stages.fitted import about, fit_body, fit_springs
    from piegraph_cli.stages.learning import read_sequences

    set_up_torch()
    name, _, count = split_label(params.label)
    learner = MODELS[name].learner
    assert learner is not None
    if isinstance(params.settings, EGNNParams) and params.settings.prior is not None:
        return _tune(inputs["dataset"], params, context)
    if count == 0:
        raise UsageError("no strokes to learn from", params.label, "only what begins with a prior does without: --from")
    data = read_sequences(inputs["dataset"], TRAIN, count, params.seed)
    network = make_network(name, params.settings, data.picks, params.seed)
    if isinstance(network, RigidBody):
        return fit_body(network, data)
    if isinstance(network, SMS):
        return fit_springs(network, data)
    assert isinstance(params.settings, LearningParams)
    assert learner.examples is not None
    device, settings = choose_device(context.device), params.settings
    held_out = read_sequences(inputs["dataset"], VALIDATION)
    validation = learner.examples(held_out, settings, device) if len(held_out.strokes) else None
    trainer = Trainer(network, learner.examples(data, settings, device), validation, settings, params.seed, device)
    _fit(trainer, params, context)
    arrays, quality, warnings = _learned(trainer)
    if name == "piegraph":
        assert isinstance(settings, EGNNParams)
        told = advice(data, settings, params.seed, context) if params.label == name else ""
        quality += told or (RIGID if is_rigid(data) else "")
    return Output(arrays | about(data), quality, warnings)


def _tune(dataset: "Artifact", params: ModelParams, context: Context) -> Output:
    """What a prior makes of the dataset's training sequences; of none at all, where the label says @0."""
    import numpy as np

    from piegraph_cli.dynamics.doubts import little_told
    from piegraph_cli.dynamics.splits import TRAIN, VALIDATION
    from piegraph_cli.dynamics.tuning import KINDS, family_of, start_tuning, tuned_steps, unseen
    from piegraph_cli.stages.comparing import advice
    from piegraph_cli.stages.fitted import about
    from piegraph_cli.stages.learning import read_sequences
    from piegraph_cli.stages.prior import read_prior

    settings, count = params.settings, split_label(params.label)[2]
    assert isinstance(settings, EGNNParams)
    data = read_sequences(dataset, TRAIN, count or None, params.seed)
    data = unseen(data) if count == 0 else data
    shipped = settings.prior == PRIOR
    prior, simulators = read_prior(SHIPPED_PRIORS[family_of(data)] if shipped else settings.files()["prior"])
    kind = KINDS[prior.family]
    kind.check(data)
    settings = settings.model_copy(update={"steps": kind.steps})
    held_out = None if count == 0 else read_sequences(dataset, VALIDATION)
    if held_out is None or not len(held_out.strokes):
        settings = settings.model_copy(update={"steps": tuned_steps(prior, data, settings, params.seed)})
    own = kind.own(data, settings.neighbors, params.seed)
    trainer = start_tuning(prior, own, data, held_out, settings, params.seed)
    _fit(trainer, params, context)
    arrays, quality, warnings = _learned(trainer)
    quality = quality.replace("examples", "examples and simulated strokes of this object")
    if params.label in ("piegraph", "piegraph:prior"):
        quality += advice(data, settings, params.seed, context)
    warnings += [*own.doubts, *little_told(data)]
    return Output(arrays | about(data) | {"prior_simulator": np.array(simulators)}, quality, warnings)


def _learned(trainer: "Trainer") -> tuple[dict[str, Any], str, list[str]]:
    """Weights and losses of a training, in a line as well; warned of where it did not learn."""
    import numpy as np

    steps, train, validation = np.array(trainer.history).T
    static = trainer.static_loss()
    arrays = {f"weights/{name}": value.cpu().numpy() for name, value in trainer.best.items()}
    arrays |= {"step": steps, "train_loss": train, "validation_loss": validation, "static_loss": np.array(static)}
    quality = f"loss {train[-1]:.4f} after {counted(trainer.done, 'step')} on {len(trainer.examples)} examples"
    if trainer.validation is not None:
        quality += f", {trainer.best_loss:.4f} on validation"
    quality += f" (nothing moves: {static:.4f})"
    if (train[-1] if trainer.validation is None else trainer.best_loss) < static:
        return arrays, quality, []
    why = f"did not learn: the loss is not below {static:.4f}, that of nothing moving"
    return arrays, quality, [f"{why}; try more steps (--steps), another learning rate, or more recordings"]


def _fit(trainer: "Trainer", params: ModelParams, context: Context) -> None:
    """All steps that are not done yet, from the last checkpoint on."""
    saved = context.checkpoint.load()
    if saved is not None:
        trainer.load(saved)
    every = max(1, trainer.params.steps // RECORDS)
    writer = _tensorboard(context) if params.tensorboard else None
    while not trainer.finished:
        end = trainer.cycle[1]
        for step in context.progress(range(trainer.done + 1, end + 1), "steps"):
            trainer.step()
            if step % every == 0 or step == end:
                _, loss, found = trainer.record()
                if writer is not None:
                    writer.add_scalar("loss/train", loss, step)
                    writer.add_scalar("loss/validation", found, step)
            if step % params.checkpoint_every == 0 and not trainer.finished:
                context.checkpoint.save(trainer.state())
    if writer is not None:
        writer.close()


def _tensorboard(context: Context):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingError("tensorboard is not installed", hint="pip install tensorboard") from None
    return SummaryWriter(str(context.run.folder / "tensorboard" / str(context.unit)))
