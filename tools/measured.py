"""The tables of docs/ that are made from the pieces of experiments in results/pieces/, and the verdicts on claims.

Each is a function of what the pieces say; one of which nothing is measured with this version is None.
"""

import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from piegraph_cli.evaluation.statistics import verdict
from piegraph_cli.evaluation.tables import difference, interval, summarise
from piegraph_cli.evaluation.trials import compare_trials, summarise_trials
from piegraph_cli.experiments.budget import budget_rows
from piegraph_cli.experiments.claims import CLAIMS, Claim, Finding, findings
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.pieces import Piece, read_pieces
from piegraph_cli.experiments.recipes import load_experiment
from piegraph_cli.experiments.results import Results, put_together
from piegraph_cli.experiments.search import search_rows
from piegraph_cli.experiments.tables import (
    empty_lines,
    loss_rows,
    origin_lines,
    paper_rows,
    plain_metrics,
    plain_trials,
)

OBJECTS = {
    "tblock": "T-block",
    "rope-stiff": "stiff rope",
    "rope-bendy": "bendy rope",
    "tshirt": "T-shirt",
    "toy": "toy",
    "cloth": "cloth",
    "measured": "measured",
}
NOT_MEASURED = "Not measured with this version."
SHORT = ("piegraph", "piegraph-ng", "egnn-g", "gnn-aug", "sms-o", "pgnd", "gbnd", "rigid", "static")
"""Models of the short table of predictions."""


class Measured:
    """The pieces of a folder, put together for every experiment that they are of."""

    def __init__(self, folder: Path):
        self.pieces: list[Piece] = read_pieces(folder) if folder.is_dir() else []
        self.of = cache(self._of)

    def _of(self, name: str) -> tuple[ExperimentParams, Results]:
        params = load_experiment(name, quick=False)
        return params, put_together(name, params, self.pieces)

    def table(self, name: str) -> str | None:
        """A table by its name, as Markdown; None where nothing of it was measured."""
        if name.startswith("claim-"):
            return self._claim(next(claim for claim in CLAIMS if f"claim-{claim.name}" == name))
        if name == "claims":
            return self._claims()
        experiment, make = TABLES[name]
        params, results = self.of(experiment)
        head_rows = make(params, results, self.pieces) if results.pieces else []
        return None if len(head_rows) < 2 else _markdown(head_rows) + _notes(results)

    def _claim(self, claim: Claim) -> str | None:
        """Gains by object, the verdict, and where they are from."""
        params, results = self.of(claim.experiment)
        found = findings(claim, params, results)
        if not any(one.verdict for one in found):
            return None
        slots = dict.fromkeys((one.rival, one.metric) for one in found)
        head = ["piegraph's gain on", *(OBJECTS[env] for env in params.interactions)]
        rows = [
            [f"`{rival}`, {metric.upper() if metric != 'final PD' else 'δ of the final PD'}"]
            + [_gain(one) for one in found if (one.rival, one.metric) == (rival, metric)]
            for rival, metric in slots
        ]
        return _markdown([head, *rows]) + f"\nVerdict: {_in_words(found)}.\n" + _notes(results, empty=False)

    def _claims(self) -> str | None:
        """All claims with the verdict on every object."""
        envs = [env for env in OBJECTS if env != "measured"]
        rows, any_found = [], False
        for claim in CLAIMS:
            params, results = self.of(claim.experiment)
            found = findings(claim, params, results)
            any_found |= any(one.verdict for one in found)
            rows.append([claim.text, *(_word([one for one in found if one.environment == env]) for env in envs)])
        return _markdown([["claim", *(OBJECTS[env] for env in envs)], *rows]) if any_found else None


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    lines = ["|" + "".join(f" {cell} |" if cell else " |" for cell in row) for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]) + "\n"


def _notes(results: Results, empty: bool = True) -> str:
    """Where figures are from and which rows are empty, below a table."""
    lines = [
        f"`{_of_all_models(line)}`" if line.startswith("piegraph reproduce") else line
        for line in origin_lines(results.pieces)
        if line
    ]
    text = "\nMeasured " + ". ".join(dict.fromkeys(lines)) + ".\n"
    if empty and (lacking := empty_lines(results)[2:]):
        text += "\nLeft empty: " + "; ".join(lacking) + ".\n"
    return text


def _of_all_models(command: str) -> str:
    """A command without what only chooses whose rows are made; a piece has its own as it was given."""
    return re.sub(r" --set '(trials\.)?models=[^']*'", "", command)


def _gain(one: Finding) -> str:
    return f"{interval(one.gain, '+')} {one.verdict}" if one.gain and one.verdict else "not measured"


def _word(found: Sequence[Finding]) -> str:
    """The verdict on one object in a word; where rivals or measures differ, which is whose."""
    words = {one.verdict or "not measured" for one in found}
    if len(words) < 2:
        return "".join(words)
    several = len({one.rival for one in found}) > 1, len({one.metric for one in found}) > 1
    by: dict[str, list[str]] = {word: [] for word in sorted(words)}
    for one in found:
        parts = (f"`{one.rival}`", one.metric.upper())
        by[one.verdict or "not measured"].append(
            " ".join(part for part, told in zip(parts, several, strict=True) if told)
        )
    return "; ".join(f"{word}: {', '.join(whose)}" for word, whose in by.items())


def _in_words(found: Sequence[Finding]) -> str:
    """Objects by verdict."""
    by: dict[str, list[str]] = {}
    for environment in dict.fromkeys(one.environment for one in found):
        word = _word([one for one in found if one.environment == environment])
        by.setdefault(word, []).append(OBJECTS[environment])
    return "; ".join(f"{word} on {', '.join(objects)}" for word, objects in by.items())


def _head(params: ExperimentParams, first: str = "") -> list[str]:
    """A column per object, with the number of sequences where there is one."""
    return [
        first,
        *(OBJECTS[e] + (f", {of[0]} sequences" if len(of) == 1 else "") for e, of in params.interactions.items()),
    ]


def _predictions(params: ExperimentParams, results: Results, models: Sequence[str] | None) -> list[list[str]]:
    """PD over the most strokes, then of `piegraph` and `static` over one."""
    found = {
        (env, row["model"], row["horizon"]): row["pd"]
        for env, of in plain_metrics(params, results).items()
        for row in summarise(of)
    }
    also = [model for more in params.also.values() for model in more]
    last = max(params.horizons)
    wanted = [m for m in dict.fromkeys([*params.models, *also]) if models is None or m in models]
    if models is not None:
        wanted.sort(key=models.index)
    slots = [(m, last) for m in wanted] + [(m, min(params.horizons)) for m in ("piegraph", "static") if m in wanted]
    rows = [
        [f"`{model}`{'' if horizon == last else f', H = {horizon}'}"]
        + [interval(pd) if (pd := found.get((env, model, horizon))) else "" for env in params.interactions]
        for model, horizon in slots
    ]
    return [_head(params, f"PD [cm], H = {last}"), *rows]


def _dynamics(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    return [*_predictions(params, results, None), _standing(params, results)]


def _four_strokes(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    return _predictions(params, results, SHORT)


def _standing(params: ExperimentParams, results: Results) -> list[str]:
    """Whether `piegraph` is first or level against every rival, by object."""
    cells, last = ["**`piegraph` against the others**"], max(params.horizons)
    for env in params.interactions:
        of = plain_metrics(params, results).get(env, {})
        gains = (
            {m: difference(of, "piegraph", m, "pd", last) for m in of if m != "piegraph"} if "piegraph" in of else {}
        )
        behind = [f"`{model}`" for model, gain in gains.items() if verdict(gain) == "worse"]
        lacking = any(e.environment == env for e in results.empty)
        word = f"behind {', '.join(behind)}" if behind else "first or level" if gains else ""
        cells.append(word + (" of those measured" if word and lacking else ""))
    return cells


def _planning(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    """Final distances, success and strokes of every model, and Cliff's delta of the first over it."""
    assert params.trials is not None
    trials, limits = plain_trials(params, results.trials), params.trials.thresholds
    compared = compare_trials(trials, limits)
    first = params.trials.models[0]
    head = ["", "trials", "final PD [cm]", *(f"below {100 * t:g} cm" for t in limits)]
    rows = [[*head, f"strokes to {100 * min(limits):g} cm, median", f"δ of the final PD, `{first}` over it", "verdict"]]
    for row in summarise_trials(trials, limits):
        env, model, pd = row["environment"], row["model"], row["pd"]
        delta = next(
            (c["pd"] for c in compared if (c["environment"], c["first"], c["second"]) == (env, first, model)), None
        )
        least = min(row["success"], key=lambda s: s["below"])
        strokes = f"over {params.trials.strokes}" if least["strokes"] is None else f"{least['strokes']:g}"
        rows.append(
            [
                f"{OBJECTS[env]}, `{model}`",
                str(row["trials"]),
                interval((100 * pd["mean"], 100 * pd["low"], 100 * pd["high"])),
                *(f"{100 * s['rate']:.0f} %" for s in row["success"]),
                strokes,
                interval(delta, "+") if delta else "",
                verdict(delta) if delta else "",
            ]
        )
    return rows


def _ablations(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    """PD over one and the most strokes; then the final distance of trials and the share below the least threshold."""
    metrics = plain_metrics(params, results)
    ended = {(r["environment"], r["model"]): r for r in summarise_trials(plain_trials(params, results.trials), (0.02,))}
    rows = []
    for model in dict.fromkeys(params.models):
        cells = [f"`{model}`"]
        for env in params.interactions:
            of = {
                r["horizon"]: r["pd"][0]
                for r in summarise({m: s for m, s in metrics.get(env, {}).items() if m == model})
            }
            text = f"{of[min(of)]:.2f} / {of[max(of)]:.2f}" if of else ""
            end = ended.get((env, model))
            more = f"{100 * end['pd']['mean']:.2f}, {100 * end['success'][0]['rate']:.0f} %" if end else ""
            cells.append("; ".join(part for part in (text, more) if part))
        rows.append(cells)
    return [_head(params), *rows]


def _fidelity(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    """PD over one and the most strokes by the number of sequences, and how much the fewest cost."""
    metrics, losses = plain_metrics(params, results), loss_rows(plain_metrics(params, results))
    counts = sorted({n for of in params.interactions.values() for n in of})
    rows = []
    for env in params.interactions:
        by = {(r["model"], r["horizon"]): r["pd"] for r in summarise(metrics.get(env, {}))}
        for horizon in (min(params.horizons), max(params.horizons)):
            grown = {
                r["sequences"]: r["loss"]
                for r in losses
                if (r["environment"], r["model"], r["horizon"]) == (env, "piegraph", horizon)
            }
            cells = [f"{OBJECTS[env]}, H = {horizon}"]
            for n in counts:
                pd = by.get((f"piegraph@{n}", horizon))
                more = f" ({100 * grown[n]:+.0f} %)" if n in grown and math.isfinite(grown[n]) else ""
                cells.append(interval(pd) + more if pd else "")
            rows.append(cells)
    return [["PD [cm] of `piegraph`", *(f"{n} sequences" for n in counts)], *rows]


def _table1(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    rows = [["CD+S, without guidance and with it", "H", "ours", "the paper's", "ours, ratio", "the paper's, ratio"]]
    for row in paper_rows(params, plain_metrics(params, results)):
        (a, b), (c, d) = row["ours"], row["paper"]
        ours, paper = f"({a:.2f}, {b:.2f})", f"({c:.1f}, {d:.1f})"
        rows.append([OBJECTS[row["environment"]], str(row["horizon"]), ours, paper, f"{a / b:.2f}", f"{c / d:.2f}"])
    return rows


def _budget(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    """Candidates, steps, minutes and learned numbers of every model, by object."""
    found = {(r["environment"], r["model"].partition("@")[0]): r for r in budget_rows(results, kept)}
    rows = []
    for model in dict.fromkeys(model for _, model in found):
        cells = [f"`{model}`"]
        for env in params.interactions:
            row = found.get((env, model))
            cells.append(_given(row) if row else "")
        rows.append(cells)
    return [_head(params, "candidates searched; steps; minutes of one core; numbers learned"), *rows]


def _given(row: dict) -> str:
    candidates, minutes = ("–" if row[k] is None else row[k] for k in ("candidates", "minutes"))
    minutes = minutes if isinstance(minutes, str) else f"{minutes:.1f}"
    text = f"{candidates}; {row['steps']:,.0f}; {minutes}; {row['parameters']:,}"
    if row["candidates_per_plan"] is not None:
        trial = "–" if row["trial_minutes"] is None else f"{row['trial_minutes']:.0f}"
        text += f"; {row['candidates_per_plan']:,} a plan, {trial} minutes of trials"
    return text


def _search(params: ExperimentParams, results: Results, kept: Sequence[Piece]) -> list[list[str]]:
    found = {(r["environment"], r["model"].partition("@")[0]): r for r in search_rows(results)}
    rows = []
    for model in params.models:
        texts = [
            (f"{r['loss']:.4g}", r["best"]) if (r := found.get((env, model))) else ("", False)
            for env in params.interactions
        ]
        rows.append([f"`{model}`", *(f"**{text}**" if best else text for text, best in texts)])
    return [_head(params, "lowest validation loss"), *rows]


Make = Callable[[ExperimentParams, Results, Sequence[Piece]], list[list[str]]]
TABLES: dict[str, tuple[str, Make]] = {
    "dynamics": ("dynamics", _dynamics),
    "dynamics-four-strokes": ("dynamics", _four_strokes),
    "planning": ("planning", _planning),
    "ablations": ("ablations", _ablations),
    "data-fidelity": ("data-fidelity", _fidelity),
    "table1": ("table1", _table1),
    "search": ("search", _search),
    "budget": ("dynamics", _budget),
    "budget-planning": ("planning", _budget),
    "budget-ablations": ("ablations", _budget),
}
"""Experiment and maker of every table but those of claims."""
NAMES = [*TABLES, "claims", *(f"claim-{claim.name}" for claim in CLAIMS)]
