"""What pieces of an experiment say, put together for its tables: whole rows, and why others are empty."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from piegraph_cli.dynamics.params import TrainParams
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import Piece, changed, check_comparable
from piegraph_cli.experiments.recipes import in_force, recipe_of, recording_of, trials_in_force
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.train import model_name, split_model
from piegraph_cli.text import counted
from piegraph_cli.workspace.artifact import Artifact

NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Empty:
    """A row that is left empty, and why."""

    environment: str
    model: str
    reason: str
    tried: bool = False
    """Whether it was done, and failed or did not learn."""
    trials: bool = False


@dataclass(frozen=True)
class Results:
    """What an experiment's tables are made of, by environment."""

    metrics: dict[str, dict[str, list[Piece]]]
    """By environment and model, a piece of each seed."""
    models: dict[str, dict[str, list[Piece]]]
    """By environment and trained model, the same, where nothing but the training counts."""
    trials: list[Trial]
    shown: dict[str, dict[str, Artifact]]
    """By task and model, one trial to look at."""
    empty: list[Empty] = field(default_factory=list)
    played: list[Piece] = field(default_factory=list)
    """The pieces that `trials` are of."""

    @property
    def pieces(self) -> list[Piece]:
        """All that the tables are made of."""
        of = [p for table in (self.metrics, self.models) for by in table.values() for some in by.values() for p in some]
        return of + self.played


def put_together(
    name: str,
    params: ExperimentParams,
    pieces: Sequence[Piece],
    shown: dict[str, dict[str, Artifact]] | None = None,
    strict: bool = True,
) -> Results:
    """The pieces of an experiment, a row for every model that is whole: all seeds, all trials, nothing that failed.

    Raises `DataError` for two pieces that are not made alike; where that is not `strict`, settings may be others than those
    in force.
    """
    of = {(p.place, p.model, p.seed): p for p in pieces}
    results = Results({}, {}, [], shown or {})
    for environment in params.interactions:
        recipe = recipe_of(params, environment, recording_of(params, environment, Path()))
        train = recipe.params(STAGES["train"])
        assert isinstance(train, TrainParams)
        search = params.table == "search"
        table = (results.models if search else results.metrics).setdefault(environment, {})
        for label in train.models if search else recipe.params(STAGES["evaluate"]).models:  # type: ignore[attr-defined]
            names = [split_model(model_name(label, seed)) for seed in train.seeds_of(label)]
            found = {n: of.get((params.run_name(environment), *_slot(label, n[1]))) for n in dict.fromkeys(names)}
            now = in_force(recipe, label) if strict else {}
            if why := _reason({seed: piece for (_, seed), piece in found.items()}, now):
                results.empty.append(Empty(environment, label, *why))
            else:
                table[label] = [piece for piece in found.values() if piece]
        check_comparable([p for some in table.values() for p in some])
    for environment in params.interactions if params.trials else ():
        now = trials_in_force(params, environment) if strict else {}
        for task in params.tasks(environment):
            rows = {label: of.get((f"{name}/{task}", label, None)) for label in params.trial_labels(environment)}
            _put_trials(rows, task, now, results)
    return results


def _put_trials(found: dict[str, Piece | None], task: str, now: dict[str, Any], results: Results) -> None:
    """The trials of a task, by model."""
    for label, piece in found.items():
        if why := _reason({None: piece}, now):
            results.empty.append(Empty(task, label, *why, trials=True))
        elif piece:
            results.played.append(piece)
            results.trials.extend(piece.trials)
    check_comparable([p for p in results.played if p.environment == task])


def _slot(label: str, seed: int) -> tuple[str, int | None]:
    """Model and seed of the piece of a label: what is not trained has no seed."""
    return label, seed if model_name(label, seed) != label else None


def _reason(found: Mapping[int | None, Piece | None], now: dict[str, Any]) -> tuple[str, bool] | None:
    """Why a row is empty, if it is, and whether it was tried: pieces are missing or of other settings, or count for nothing."""
    lacking = [seed for seed, piece in found.items() if piece is None]
    if len(lacking) == len(found):
        return NOT_MEASURED, False
    if lacking:
        return f"{counted(len(lacking), 'seed')} missing: {', '.join(map(str, lacking))}", False
    for seed, piece in found.items():
        assert piece is not None
        of = "" if seed is None else f"seed {seed} "
        if why := changed(piece, now):
            return of + why, False
        if piece.trouble:
            return of + piece.trouble, True
    return None
