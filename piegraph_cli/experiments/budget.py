"""What each model was given: candidates searched, steps, processor time, learned numbers; and what an experiment takes."""

from collections.abc import Sequence
from typing import Any

from piegraph_cli.dynamics.params import split_label, trained_label
from piegraph_cli.environments.params import split_task
from piegraph_cli.experiments.pieces import Piece
from piegraph_cli.experiments.recipes import load_experiment
from piegraph_cli.experiments.results import Results


def searched(kept: Sequence[Piece]) -> dict[tuple[str, str], int]:
    """How many candidates of each environment and model a search has tried, by its pieces."""
    search = load_experiment("search", quick=False)
    places = {search.run_name(environment) for environment in search.interactions}
    tried = {(p.environment, p.model) for p in kept if p.kind == "model" and p.place in places}
    found: dict[tuple[str, str], int] = {}
    for environment, label in tried:
        slot = environment, split_label(label)[0]
        found[slot] = found.get(slot, 0) + 1
    return found


def budget_rows(results: Results, kept: Sequence[Piece]) -> list[dict[str, Any]]:
    """A row for every trained model of every environment, means over seeds; None of what is not known.

    `minutes` are the processor's for one training, `trial_minutes` for all trials of the model.
    """
    candidates, rows = searched(kept), []
    for table in (results.metrics, results.models):
        for env, of in table.items():
            for label, pieces in of.items():
                trainings = [p.training for p in pieces if p.training]
                if trained_label(label) != label or not trainings:
                    continue  # what uses the weights of another has that one's budget
                times = [t.made.cpu_s for t in trainings]
                played = [p for p in results.played if (split_task(p.environment)[0], p.model) == (env, label)]
                playing = _minutes([p.made.cpu_s for p in played])
                rows.append(
                    {
                        "environment": env,
                        "model": label,
                        "candidates": candidates.get((env, split_label(label)[0])),
                        "steps": _mean([t.steps for t in trainings]),
                        "parameters": trainings[0].parameters,
                        "minutes": _minutes(times),
                        "candidates_per_plan": _per_plan(played[0]) if played else None,
                        "trial_minutes": None if playing is None else playing * len(played),
                    }
                )
    return rows


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _minutes(seconds: Sequence[float | None]) -> float | None:
    known = [s for s in seconds if s is not None]
    return _mean(known) / 60 if known and len(known) == len(seconds) else None


def _per_plan(piece: Piece) -> int | None:
    """Candidates that one plan looks at, at most."""
    plan = piece.settings.get("plan", {})
    return plan["samples"] * plan["cem_iterations"] if {"samples", "cem_iterations"} <= plan.keys() else None


def budget_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """`budget_rows` for people."""
    if not rows:
        return []
    lines = [
        "",
        "What each model was given: candidates of the search, steps and processor time of one training, learned numbers",
        f"{'environment':12s} {'model':20s} {'candidates':>10s} {'steps':>7s} {'numbers':>8s} {'minutes':>8s} "
        f"{'a plan':>7s} {'minutes of trials':>17s}",
    ]
    for row in rows:
        lines.append(
            f"{row['environment']:12s} {row['model']:20s} {_text(row['candidates'], 10)} {row['steps']:7.0f} "
            f"{row['parameters']:8d} {_text(row['minutes'], 8, '.1f')} {_text(row['candidates_per_plan'], 7)} "
            f"{_text(row['trial_minutes'], 17, '.1f')}"
        )
    return lines


def _text(value: float | None, width: int, form: str = "") -> str:
    return f"{'-' if value is None else format(value, form):>{width}s}"


def hours(pieces: Sequence[Piece]) -> float | None:
    """Processor time [h] of all pieces together, each training counted once; None where a piece does not say."""
    made = [p.made for p in pieces if p.kind == "trials" or "metrics" in p.keys]
    trained = {p.keys["model"]: p.training.made for p in pieces if p.training and "model" in p.keys}
    times = [one.cpu_s for one in [*made, *trained.values()]]
    return sum(t for t in times if t is not None) / 3600 if times and None not in times else None
