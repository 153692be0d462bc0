"""Pieces of experiments with known numbers, made as the settings in force would make them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from piegraph_cli.dynamics.params import trained_label
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import Made, Piece, Training
from piegraph_cli.experiments.recipes import in_force, recipe_of, recording_of, trials_in_force

MADE = Made(date="2026-11-27", software="piegraph 1.2.0", machine="a processor, 2 cores", wall_s=60.0, cpu_s=30.0)
COMMAND = "piegraph reproduce known"


def experiment(table: str = "dynamics", **settings: Any) -> ExperimentParams:
    """Two seeds of `piegraph`, `pgnd` and `static` on the T-block."""
    values: dict[str, Any] = {
        "interactions": {"tblock": (6,)},
        "models": ("piegraph", "pgnd", "static"),
        "seeds": (0, 1),
    }
    return ExperimentParams.model_validate({"title": "known", "table": table, "horizons": (1, 4)} | values | settings)


def predicted(
    params: ExperimentParams, environment: str, label: str, seed: int, pd: Sequence[float], **more: Any
) -> Piece:
    """Predictions of one model from one seed: `pd` of each sequence four strokes ahead, a quarter of it one ahead.

    CD is ten times, S a hundred times that.
    """
    own = trained_label(label)
    rows = [[f"s{k}", *(value * f for value in (d / 4, d) for f in (1, 10, 100))] for k, d in enumerate(pd)]
    versions = {"simulate": 3, "dataset": 4, "evaluate": 5} | ({"train": 7} if own else {})
    keys = {"dataset": "d" * 64, "metrics": f"{label}{seed}"} | ({"model": f"{own}{seed}"} if own else {})
    training = Training(steps=2600, parameters=26884, loss=0.1, static_loss=0.5, made=MADE) if own else None
    recipe = recipe_of(params, environment, recording_of(params, environment, Path()))
    return Piece(
        **{
            "kind": "model",
            "place": params.run_name(environment),
            "environment": environment,
            "model": label,
            "seed": seed if own else None,
            "command": COMMAND,
            "made": MADE,
            "versions": versions,
            "keys": keys,
            "settings": in_force(recipe, label),
            "training": training,
            "windows": {1: 4 * len(pd), 4: len(pd)},
            "columns": ["sequence", *(f"{m} {h}" for h in (1, 4) for m in ("pd", "cd", "s"))],
            "rows": rows,
        }
        | more
    )


def played(
    params: ExperimentParams, name: str, environment: str, label: str, ends: Sequence[Sequence[float]], **more: Any
) -> Piece:
    """Trials of one model: by goal and start the distance (m) after the one stroke, 0.3 before it."""
    rows = [
        [goal, seed, [0.3, end], [0.6, 2 * end], [0.5]] for goal, of in enumerate(ends) for seed, end in enumerate(of)
    ]
    return Piece(
        **{
            "kind": "trials",
            "place": f"{name}/{environment}",
            "environment": environment,
            "model": label,
            "seed": None,
            "command": COMMAND,
            "made": MADE,
            "versions": {"trials": 4, "train": 7},
            "keys": {"goal00.seed00": label},
            "settings": trials_in_force(params, environment),
            "columns": ["goal", "seed", "pd", "cd", "seconds"],
            "rows": rows,
        }
        | more
    )
