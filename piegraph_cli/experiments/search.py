"""The table of a search: the lowest validation loss of every candidate, and the best as lines of recipes."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from piegraph_cli.dynamics.params import split_label
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.results import Results


def search_rows(results: Results) -> list[dict[str, Any]]:
    """The lowest validation loss of every variant of every model, the best ones marked.

    A model of which a candidate was not tried has no best one; those that failed or did not learn are none.
    """
    rows = []
    for env, of in results.models.items():
        found = {label: float(np.mean([_loss(piece) for piece in seeds])) for label, seeds in of.items()}
        names = {label: split_label(label)[0] for label in found}
        lacking = {split_label(e.model)[0] for e in results.empty if e.environment == env and not e.tried}
        for label, loss in found.items():
            rivals = [found[other] for other in found if names[other] == names[label]]
            best = names[label] not in lacking and loss <= min(rivals)
            rows.append({"environment": env, "model": label, "loss": loss, "best": best})
    return rows


def _loss(piece: Any) -> float:
    loss = piece.training.loss if piece.training else None
    return np.nan if loss is None else loss


def search_lines(params: ExperimentParams, rows: Sequence[dict[str, Any]]) -> list[str]:
    """`search_rows` for people, and what of it belongs into recipes."""
    lines = [f"{'environment':12s} {'model':28s} {'validation loss':>16s}"]
    lines += [f"{r['environment']:12s} {r['model']:28s} {r['loss']:16.5f}{' *' if r['best'] else ''}" for r in rows]
    return lines + recipe_lines(params, rows)


def recipe_lines(params: ExperimentParams, rows: Sequence[dict[str, Any]]) -> list[str]:
    """The settings of the best candidates, as sections of each environment's recipe."""
    lines: list[str] = []
    for env in dict.fromkeys(row["environment"] for row in rows):
        best = [row["model"].partition("@")[0] for row in rows if row["environment"] == env and row["best"]]
        chosen = [(label.partition(":")[0], params.variants[label]) for label in best if params.variants.get(label)]
        if chosen:
            lines += ["", f"# pipelines/{env}.toml: the best of `piegraph reproduce search`"]
        for name, settings in chosen:
            lines += [f"[train.{name}]", *(f"{key} = {json.dumps(value)}" for key, value in settings.items())]
    return lines
