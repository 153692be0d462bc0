"""The tables of experiments: our figures with their intervals, the paper's beside them, and what differs from what."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from piegraph_cli.environments.params import split_task
from piegraph_cli.evaluation.statistics import verdict
from piegraph_cli.evaluation.tables import Metrics, difference, interval, sequence_means, summarise
from piegraph_cli.evaluation.trials import Trial, compare_trials, summarise_trials, trial_lines
from piegraph_cli.experiments.budget import budget_lines, budget_rows, hours
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import Piece
from piegraph_cli.experiments.results import NOT_MEASURED, Results
from piegraph_cli.experiments.search import search_lines, search_rows


def describe(
    params: ExperimentParams, results: Results, kept: Sequence[Piece] = ()
) -> tuple[dict[str, Any], list[str]]:
    """The experiment's results as one object and as lines for people; `kept` pieces say how much was searched."""
    value: dict[str, Any] = {"title": params.title, "seeds": list(params.seeds)}
    lines = [params.title, "", *origin_lines(results.pieces)]
    if params.table == "search":
        value["search"] = search_rows(results)
        lines += search_lines(params, value["search"])
    else:
        lines += _measured(params, results, value)
    value["budget"] = budget_rows(results, kept)
    value["empty"] = [vars(empty) for empty in results.empty]
    return value, [*lines, *budget_lines(value["budget"]), *empty_lines(results)]


def origin_lines(pieces: Sequence[Piece]) -> list[str]:
    """When, on which machine, by which versions of the stages and by which commands figures were made."""
    if not pieces:
        return []
    dates = sorted({d for p in pieces for d in (p.made.date, p.training.made.date if p.training else "") if d})
    machines = sorted({m for p in pieces for m in p.made.machine.split("; ") if m})
    versions: dict[str, set[int]] = {}
    for piece in pieces:
        for stage, version in piece.versions.items():
            versions.setdefault(stage, set()).add(version)
    software = sorted({s for p in pieces for s in p.made.software.split("; ") if s})
    stages = [f"{stage} {', '.join(map(str, sorted(of)))}" for stage, of in versions.items()]
    taken = hours(pieces)
    commands = sorted({p.command for p in pieces if p.command})
    return [
        f"{' to '.join(dict.fromkeys([dates[0], dates[-1]])) if dates else 'no date'}; "
        f"{'; '.join(machines) or 'no machine is known'}",
        f"{', '.join(software)}; versions: {', '.join(stages)}",
        *([] if taken is None else [f"{taken:.1f} hours of one core"]),
        *commands,
        "",
    ]


def empty_lines(results: Results) -> list[str]:
    """Which rows are empty, and why; those of one reason together."""
    found: dict[tuple[str, str], list[str]] = {}
    for empty in results.empty:
        reason = f"{'trials ' if empty.trials and empty.reason == NOT_MEASURED else ''}{empty.reason}"
        found.setdefault((empty.environment, reason), []).append(empty.model)
    lines = [f"{env}: {', '.join(models)}: {reason}" for (env, reason), models in found.items()]
    return ["", "Rows that are left empty", *lines] if lines else []


def _measured(params: ExperimentParams, results: Results, value: dict[str, Any]) -> list[str]:
    """The tables of predictions and trials: put into `value`, and as lines."""
    metrics = plain_metrics(params, results)
    value["predictions"] = prediction_rows(params, results)
    lines = prediction_lines(value["predictions"])
    value["guidance"] = guidance_rows(metrics)
    if value["guidance"]:
        lines += ["", *guidance_lines(value["guidance"])]
    if params.table == "dynamics":
        value["against"] = against_rows(metrics)
        lines += ["", *against_lines(value["against"])]
    if params.table == "interactions":
        value["loss"] = loss_rows(metrics)
        lines += ["", *loss_lines(value["loss"])]
    if params.paper:
        value["paper"] = paper_rows(params, metrics)
        lines += ["", *paper_lines(value["paper"])]
    if results.trials and params.trials:
        trials = plain_trials(params, results.trials)
        rows, compared = (
            summarise_trials(trials, params.trials.thresholds),
            compare_trials(trials, params.trials.thresholds),
        )
        value["trials"], value["cliffs_delta"] = rows, compared
        lines += ["", *trial_lines(rows, compared, params.trials.strokes)]
    return lines


def prediction_rows(params: ExperimentParams, results: Results) -> list[dict[str, Any]]:
    """Errors per environment, horizon and model, with the number of windows that they are means over."""
    windows = {
        (env, _plain(params, env, model)): seeds[0].windows
        for env, of in results.metrics.items()
        for model, seeds in of.items()
    }
    return [
        {"environment": env} | row | {"windows": windows[env, row["model"]][row["horizon"]]}
        for env, of in plain_metrics(params, results).items()
        for row in summarise(of)
    ]


def plain_metrics(params: ExperimentParams, results: Results) -> dict[str, Metrics]:
    """Arrays by environment and model; the number of sequences is left out of names where there is only one."""
    return {
        env: {_plain(params, env, model): [one.arrays for one in seeds] for model, seeds in of.items()}
        for env, of in results.metrics.items()
        if of
    }


def plain_trials(params: ExperimentParams, trials: Sequence[Trial]) -> list[Trial]:
    """Trials with the names of `plain_metrics`."""
    return [
        Trial(t.environment, _plain(params, t.environment, t.model), t.goal, t.seed, t.pd, t.cd, t.seconds)
        for t in trials
    ]


def _plain(params: ExperimentParams, task: str, label: str) -> str:
    environment = split_task(task)[0]
    return label.partition("@")[0] if len(params.interactions[environment]) == 1 else label  # type: ignore[index]


def prediction_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """PD with its interval, CD, S and CD+S, per environment, horizon and model."""
    head = f"{'PD [cm]':>22s} {'CD [cm]':>8s} {'S [cm2]':>8s} {'CD+S':>7s}"
    truth = any(np.isfinite(row["pd_truth"][0]) for row in rows)
    lines = [f"{'environment':12s} {'H':>2s} {'model':20s} {'seeds':>5s} {head}{'  PD truth' if truth else ''}"]
    for row in rows:
        numbers = f"{row['cd'][0]:8.2f} {row['s'][0]:8.2f} {row['cd+s'][0]:7.2f}"
        more = f"{row['pd_truth'][0]:10.2f}" if truth else ""
        lines.append(
            f"{row['environment']:12s} {row['horizon']:2d} {row['model']:20s} {row['seeds']:5d} "
            f"{interval(row['pd']):>22s} {numbers}{more}"
        )
    return [*lines, "PD particle distance, CD chamfer distance (both ways, summed), S shape error; [95 % interval]"]


def guidance_rows(metrics: dict[str, Metrics]) -> list[dict[str, Any]]:
    """How much the unguided network is worse than the guided one, per environment and horizon."""
    return [
        {
            "environment": env,
            "model": model,
            "horizon": horizon,
            "pd": difference(of, model, unguided, "pd", horizon),
            "cd+s": difference(of, model, unguided, "cd+s", horizon),
        }
        for env, of in metrics.items()
        for model in of
        if model.startswith("piegraph") and (unguided := model.replace("piegraph", "piegraph-ng", 1)) in of
        for horizon in _horizons(of)
    ]


def guidance_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """`guidance_rows` for people."""
    lines = [
        "What guidance gains: unguided less guided, paired by seed and sequence (above 0: guidance helps)",
        f"{'environment':12s} {'H':>2s} {'model':20s} {'PD [cm]':>24s} {'CD+S':>26s}",
    ]
    return lines + [
        f"{r['environment']:12s} {r['horizon']:2d} {r['model']:20s} "
        f"{interval(r['pd'], '+'):>24s} {interval(r['cd+s'], '+'):>26s}"
        for r in rows
    ]


def against_rows(metrics: dict[str, Metrics]) -> list[dict[str, Any]]:
    """How much further than piegraph every other model is from the truth at the longest horizon."""
    return [
        {
            "environment": env,
            "model": model,
            "horizon": max(_horizons(of)),
            "pd": (found := difference(of, "piegraph", model, "pd", max(_horizons(of)))),
            "verdict": verdict(found),
        }
        for env, of in metrics.items()
        for model in of
        if model != "piegraph" and "piegraph" in of
    ]


def against_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """`against_rows` for people."""
    lines = ["PD less that of piegraph, paired by seed and sequence (above 0: piegraph is nearer)"]
    lines += [f"{'environment':12s} {'H':>2s} {'model':20s} {'PD [cm]':>24s}  piegraph is"]
    lines += [
        f"{r['environment']:12s} {r['horizon']:2d} {r['model']:20s} {interval(r['pd'], '+'):>24s}  {r['verdict']}"
        for r in rows
    ]
    for env in dict.fromkeys(r["environment"] for r in rows):
        behind = [r["model"] for r in rows if r["environment"] == env and r["verdict"] == "worse"]
        lines.append(f"{env}: {'behind ' + ', '.join(behind) if behind else 'first or level against all of these'}")
    return lines


def loss_rows(metrics: dict[str, Metrics]) -> list[dict[str, Any]]:
    """PD with few training sequences over that with the most, per environment, model and horizon."""
    rows = []
    for env, of in metrics.items():
        sized = [(name, int(count), label) for label in of for name, _, count in [label.partition("@")] if count]
        for name in dict.fromkeys(name for name, _, _ in sized):
            own = sorted((count, label) for n, count, label in sized if n == name)
            for horizon in _horizons(of):
                best = sequence_means(of[own[-1][1]], "pd", horizon).mean()
                for count, label in own[:-1]:
                    ratio = sequence_means(of[label], "pd", horizon).mean() / best - 1
                    rows.append(
                        {
                            "environment": env,
                            "model": name,
                            "horizon": horizon,
                            "sequences": count,
                            "of": own[-1][0],
                            "loss": ratio,
                        }
                    )
    return rows


def loss_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """`loss_rows` for people."""
    return ["How much PD grows with fewer training sequences"] + [
        f"{r['environment']:12s} H={r['horizon']} {r['model']:20s} "
        f"{r['sequences']:4d} against {r['of']}: {100 * r['loss']:+.0f} %"
        for r in rows
    ]


def paper_rows(params: ExperimentParams, metrics: dict[str, Metrics]) -> list[dict[str, Any]]:
    """CD+S without and with guidance, ours and the paper's, per environment and horizon."""
    rows = []
    for env, of in metrics.items():
        for horizon in _horizons(of):
            paper = params.paper.get(env, {}).get(str(horizon))
            if paper is None or "piegraph" not in of or "piegraph-ng" not in of:
                continue
            ours = [float(sequence_means(of[m], "cd+s", horizon).mean()) for m in ("piegraph-ng", "piegraph")]
            rows.append({"environment": env, "horizon": horizon, "ours": ours, "paper": list(paper)})
    return rows


def paper_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """`paper_rows` for people."""
    lines = ["CD+S (without guidance, guided), the paper's on its own recordings of real objects"]
    lines += [f"{'environment':12s} {'H':>2s} {'ours':>16s} {'paper':>16s} {'ours, ratio':>12s} {'paper, ratio':>12s}"]
    for row in rows:
        (a, b), (c, d) = row["ours"], row["paper"]
        ours, paper = f"({a:.2f}, {b:.2f})", f"({c:.1f}, {d:.1f})"
        lines.append(
            f"{row['environment']:12s} {row['horizon']:2d} {ours:>16s} {paper:>16s} {a / b:12.2f} {c / d:12.2f}"
        )
    return lines


def _horizons(of: Metrics) -> list[int]:
    return sorted({int(h) for seeds in of.values() for h in np.unique(seeds[0]["horizon"])})
