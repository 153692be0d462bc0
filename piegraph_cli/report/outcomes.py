"""Verdicts on what a run was made for: how well its model predicts, what its plan reached, what its trials reached."""

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from piegraph_cli.evaluation.statistics import bootstrap_mean
from piegraph_cli.evaluation.tables import Metrics, difference, interval, sequence_means
from piegraph_cli.evaluation.trials import Trial, select
from piegraph_cli.report.found import Found
from piegraph_cli.report.verdicts import Verdict
from piegraph_cli.report.words import Word, worst
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.plan import METRICS
from piegraph_cli.text import counted
from piegraph_cli.workspace.artifact import Artifact

SOLVED = 0.5
"""Share of the trials that makes a model good."""


def main_model(found: Found, labels: Sequence[str]) -> str | None:
    """The model a run is about: the one that plans, `piegraph`, or else the first that learns."""
    wanted = [found.run.params("plan").model, "piegraph", *labels]
    return next((label for label in wanted if label in labels and label != "static"), None)


def model_verdict(found: Found, metrics: Metrics) -> Verdict:
    """Predictions against an object that stays where it is, on held-out sequences."""
    stages = ("dataset", "train", "evaluate")
    said = [text for (stage, _), texts in found.warnings.items() if stage in stages for text in texts]
    main = main_model(found, list(metrics))
    if main is None:
        waiting = next(iter(found.units("evaluate", "stale", "missing", "failed")), None)
        row = found.rows.get(("evaluate", waiting), {})
        why = row.get("failure") or (f"out of date: {row['reason']}" if row.get("reason") else "not made yet")
        return Verdict("model", "not yet", why.splitlines()[0], said, found.command(STAGES["evaluate"], waiting))
    horizons = sorted({int(h) for one in metrics[main] for h in one["horizon"]})
    first = horizons[0]
    ours = float(sequence_means(metrics[main], "pd", first).mean())
    figure = f"{main} is {ours:.2f} cm off after {counted(first, 'stroke')}"
    if "static" not in metrics:
        todo = ["evaluate static beside it: how far does the object move?"]
        return Verdict("model", "check", figure, said + todo, "", "model")
    gains = {h: difference(metrics, main, "static", "pd", h) for h in horizons}
    static = ours + gains[first][0]
    figure += f", {interval(gains[first])} cm better than an object that stays where it is ({static:.2f} cm)"
    word, todo = _word_of_gains(gains)
    return Verdict("model", worst([word, "check" if said else word]), figure, said + todo, "", "model")


def _word_of_gains(gains: dict[int, tuple[float, float, float]]) -> tuple[Word, list[str]]:
    """From how much better (cm; mean, low, high) a model is than nothing at each horizon."""
    first, todo = next(iter(gains)), []
    _, low, high = gains[first]
    worse = [h for h, (mean, _, _) in gains.items() if mean <= 0]
    if worse:
        todo.append(
            f"no better than standing still at {', '.join(map(str, worse))} strokes: more sequences, longer training"
        )
    if not np.isfinite(low):
        return "check", [
            *todo,
            "one held-out sequence gives no interval: hold out two and more, a smaller dataset.train",
        ]
    if high < 0:
        return "bad", todo
    if low <= 0 and first not in worse:
        todo.append("the interval holds zero: more sequences to train on, or to test on")
    return ("good" if low > 0 and not worse else "check"), todo


def plan_verdict(found: Found) -> Verdict:
    """What the plan reached."""
    plan, why = found.plan
    command = _example(found)
    if plan is None:
        asked = found.has("plan")
        if asked:
            command = found.command(STAGES["plan"], None)
            why = found.rows["plan", None]["failure"] or why
        word: Word = "bad" if asked and found.rows["plan", None]["state"] == "failed" else "not yet"
        return Verdict("plan", word, why.splitlines()[0], why.splitlines()[1:], command)
    said = found.warnings.get(("plan", None), [])
    word, figure = _reached(plan)
    todo = (
        [] if word == "good" else ["look at the strokes: a goal that is too far, a blocked way, or a model that is off"]
    )
    return Verdict("plan", "check" if said and word == "good" else word, figure, [*said, *todo], "", "plan")


def _example(found: Found) -> str:
    """A plan that this run could make: in its own simulation, or from where an object was tracked."""
    if found.has("simulate"):
        return f"piegraph plan {found.option} --env {found.run.params('simulate').environment}"
    state = shlex.quote(str(found.run.path("tracks", next(iter(found.sequences), "SEQUENCE"))))
    return f"piegraph plan {found.option} --state {state} --goal-pose 0.1,0,0.5"


def _reached(plan: Artifact) -> tuple[Word, str]:
    limit, metric = float(plan.params["success"]), plan.texts("metric")[0]
    what, ends = METRICS.get(metric, metric), plan["end_distance"]
    if np.isfinite(ends).any():
        solved = int((ends < limit).sum())
        figure = f"{solved} of {len(ends)} goals reached: below {limit * 100:g} cm of {what}"
        return ("good" if solved == len(ends) else "check" if solved else "bad"), figure
    left = float(plan["cost"][-1]) if len(plan["cost"]) else float(plan["start_distance"][0])
    figure = f"predicted to end {left * 100:.1f} cm from the goal ({what}; success is {limit * 100:g} cm)"
    return ("good" if left < limit else "check"), figure


def trial_rates(trials: Sequence[Trial], threshold: float) -> list[dict[str, Any]]:
    """By environment and model: trials, and the share (mean, low, high) that came below a distance (m)."""
    rows = []
    for environment, model in dict.fromkeys((t.environment, t.model) for t in trials):
        own = select(trials, environment, model)
        rate = bootstrap_mean(np.array([np.isfinite(t.strokes_to(threshold)) for t in own], float))
        rows.append({"environment": environment, "model": model, "trials": len(own), "rate": rate})
    return rows


def trials_verdict(found: Found, trials: Sequence[Trial]) -> Verdict:
    """How many tasks the run's main model solves."""
    params, waiting = found.run.params("trials"), found.units("trials", "stale", "missing")
    command = found.command(STAGES["trials"], waiting[0]) if waiting else ""
    main = main_model(found, list(dict.fromkeys(t.model for t in trials)))
    if main is None:
        return Verdict("trials", "not yet", "not made yet", command=command)
    limit = min(params.thresholds)
    rates = [row for row in trial_rates(trials, limit) if row["model"] == main]
    told = ", ".join(f"{row['rate'][0]:.0%} in {row['environment']}" for row in rates)
    figure = f"{main} solves {told} of the trials, below {limit * 100:g} cm within {counted(params.strokes, 'stroke')}"
    least = min(row["rate"][0] for row in rates)
    word: Word = "good" if least >= SOLVED else "check" if max(row["rate"][0] for row in rates) > 0 else "bad"
    todo = [f"{len(waiting)} trials are not made yet"] if waiting else []
    return Verdict("trials", "check" if waiting and word == "good" else word, figure, todo, command, "trials")
