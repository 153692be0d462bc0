"""What the report's tables say: rows of text and numbers with intervals, ready to be shown."""

import importlib.metadata
import json
import math
import platform
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from piegraph_cli import __version__
from piegraph_cli.evaluation.colors import model_color, model_marker
from piegraph_cli.evaluation.tables import Metrics, difference, interval, summarise
from piegraph_cli.evaluation.trials import Trial, compare_trials, summarise_trials
from piegraph_cli.params import mode_word
from piegraph_cli.report.found import Found
from piegraph_cli.report.outcomes import trial_rates
from piegraph_cli.workspace.artifact import Artifact

GLYPHS = dict(zip("osD^vP*Xdph<>", "●■◆▲▼✚★✖♦⬟⬢◀▶", strict=True))
"""What matplotlib's markers look like in text."""
PACKAGES = ("torch", "numpy", "scipy", "warp-lang", "opencv-python-headless", "mediapipe", "mujoco", "pymunk", "h5py")


def look_of(label: str) -> dict[str, str]:
    """A model as it is drawn: label, colour, marker."""
    return {"label": label, "color": model_color(label), "glyph": GLYPHS[model_marker(label)]}


def metric_rows(metrics: Metrics) -> list[dict[str, Any]]:
    """A row per horizon and model: means with intervals, and how much better than an object that stays where it is."""
    rows = []
    for row in summarise(metrics):
        gain = ""
        if "static" in metrics and row["model"] != "static":
            gain = interval(difference(metrics, row["model"], "static", "pd", row["horizon"]), "+")
        texts = {name: interval(row[name]) for name in ("pd", "cd", "s", "cd+s")}
        truth = interval(row["pd_truth"]) if math.isfinite(row["pd_truth"][0]) else ""
        rows.append(look_of(row["model"]) | row | {"texts": texts, "truth": truth, "gain": gain})
    return rows


def trial_tables(trials: Sequence[Trial], thresholds: Sequence[float]) -> dict[str, Any]:
    """Trials by environment and model, success with intervals, and Cliff's delta between models."""
    rates = {limit: trial_rates(trials, limit) for limit in thresholds}
    rows: list[dict[str, Any]] = []
    for k, row in enumerate(summarise_trials(trials, thresholds)):
        pd, cd = (_centimetres(row[name]) for name in ("pd", "cd"))
        success = [_percent(rates[limit][k]["rate"]) for limit in thresholds]
        strokes = [of["strokes"] for of in row["success"]]
        rows.append(look_of(row["model"]) | row | {"pd": pd, "cd": cd, "success": success, "strokes": strokes})
    deltas = [
        {"environment": c["environment"], "first": c["first"], "second": c["second"], "pairs": c["pairs"]}
        | {"pd": interval(c["pd"], "+"), "strokes": interval(min(c["strokes"], key=lambda s: s["below"])["delta"], "+")}
        for c in compare_trials(trials, thresholds)
        if c["pairs"]
    ]
    return {"rows": rows, "deltas": deltas, "limits": [f"{limit * 100:g}" for limit in thresholds]}


def _centimetres(of: Mapping[str, float]) -> str:
    return f"{of['mean'] * 100:.2f} [{of['low'] * 100:.2f}, {of['high'] * 100:.2f}]"


def _percent(rate: tuple[float, float, float]) -> str:
    return f"{rate[0] * 100:.0f} [{rate[1] * 100:.0f}, {rate[2] * 100:.0f}]"


def plan_rows(plan: Artifact) -> list[dict[str, Any]]:
    """A row per stroke: episode, what is done from where to where (m), and distances (cm)."""
    rows = []
    for k, (start, end) in enumerate(plan["stroke"].tolist()):
        reached = float(plan["distance"][k]) * 100
        rows.append(
            {
                "episode": int(plan["episode"][k]),
                "mode": mode_word(int(plan["mode"][k])),
                "start": ", ".join(f"{x:+.3f}" for x in start),
                "end": ", ".join(f"{x:+.3f}" for x in end),
                "predicted": f"{float(plan['cost'][k]) * 100:.1f}",
                "reached": f"{reached:.1f}" if math.isfinite(reached) else "",
                "blocked": bool(plan["blocked"][k]),
            }
        )
    return rows


def check_rows(found: Found) -> list[dict[str, Any]]:
    """Of each check of geometry and clocks the worst of all sequences, and how many were good."""
    columns = ("name", "camera", "unit", "verdict", "text", "cause", "remedy")
    order, rows = ("good", "doubtful", "bad"), dict[str, dict[str, Any]]()
    for sequence in found.sequences if found.has("ingest") else []:
        frames = found.read("frames", sequence, [f"check_{c}" for c in (*columns, "figure", "threshold")])
        if frames is None:
            continue
        texts = [frames.texts(f"check_{column}") for column in columns]
        numbers = [frames["check_figure"].tolist(), frames["check_threshold"].tolist()]
        for *values, figure, threshold in zip(*texts, *numbers, strict=True):
            check = dict(zip(columns, values, strict=True)) | {
                "sequence": sequence,
                "figure": figure,
                "threshold": threshold,
            }
            verdict = order.index(check["verdict"]) if check["verdict"] in order else 1
            rank = (verdict, abs(np.nan_to_num(figure)) / (abs(threshold) or 1))
            row = rows.setdefault(check["name"], {"counts": [0, 0, 0], "rank": (-1, 0.0)})
            row["counts"][verdict] += 1
            if rank > row["rank"]:
                row |= check | {"rank": rank}
    return list(rows.values())


def setting_rows(found: Found) -> list[dict[str, Any]]:
    """Every setting of the run's stages, what it means, and whether the recipe gives it."""
    rows = []
    for stage in found.run.chain:
        params = found.run.params(stage.name)
        given = found.run.recipe.sections.get(stage.name, {})
        for name, info in type(params).model_fields.items():
            value = getattr(params, name)
            shown = value.model_dump(mode="json", exclude_unset=True) if hasattr(value, "model_dump") else value
            text = shown if isinstance(shown, str) else json.dumps(shown, default=str, ensure_ascii=False)
            rows.append(
                {
                    "stage": stage.name,
                    "name": name,
                    "value": text,
                    "given": name in given,
                    "meaning": info.description or "",
                }
            )
    return rows


def key_rows(found: Found) -> list[dict[str, Any]]:
    """Every unit of the run with its state, key and quality."""
    rows = []
    for (stage, unit), row in found.rows.items():
        header = found.header(found.run.recipe.table[stage].writes, unit)
        rows.append({"stage": stage, "unit": unit or "-", "state": row["state"], "key": header.key if header else ""})
        rows[-1]["quality"] = row["quality"]
    return rows


def version_rows() -> list[tuple[str, str]]:
    """Of piegraph, Python and the packages that results come from, on this machine."""
    rows = [("piegraph", __version__), ("Python", platform.python_version()), ("system", platform.platform(terse=True))]
    for package in PACKAGES:
        try:
            rows.append((package, importlib.metadata.version(package)))
        except importlib.metadata.PackageNotFoundError:
            continue
    return rows


def plan_command(found: Found, plan: Artifact) -> str:
    """The command that asks a plan's question again; empty where the recipe does."""
    if found.fresh("plan", None):
        return ""
    defaults = found.run.recipe.table["plan"].params().model_dump(mode="json")
    words = ["piegraph plan", found.option]
    for name, value in plan.params.items():
        if value is None or name not in defaults or defaults[name] == value:
            continue
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, bool):
            words.append(option if value else f"--no-{option[2:]}")
            continue
        if isinstance(value, dict):
            value = [f"{k}={v}" for k, v in value.items()]
        words += [option, shlex.quote(",".join(map(str, value)) if isinstance(value, list) else str(value))]
    return " ".join(words)
