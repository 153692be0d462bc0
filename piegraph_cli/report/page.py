"""The report of a run: RUN/report/index.html, one file that needs nothing beside it."""

import base64
import datetime
import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piegraph_cli import __version__
from piegraph_cli.evaluation.tables import Metrics, summarise_scores
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.files import atomic_file
from piegraph_cli.report import tables
from piegraph_cli.report.drawn import Drawn
from piegraph_cli.report.found import Found, Gap
from piegraph_cli.report.outcomes import model_verdict, plan_verdict, trials_verdict
from piegraph_cli.report.pictures import SEQUENCE, share_of
from piegraph_cli.report.sections import model_section, plan_section, sequence_section, trials_section
from piegraph_cli.report.verdicts import Verdict, part_verdict
from piegraph_cli.report.words import Part, sequence_parts
from piegraph_cli.stages import open_run
from piegraph_cli.stages.evaluate import read_metrics
from piegraph_cli.stages.trials import read_trials

HERE = Path(__file__).parent
Progress = Callable[[list[str]], Iterable[str]]
STAGES_OF = {"recording": "ingest", "hands": "hands", "masks": "segment", "tracks": "track"}


@dataclass(frozen=True)
class Written:
    """A report that was written."""

    path: Path
    verdicts: list[Verdict]
    left_out: list[Gap]


def write_report(folder: Path, progress: Progress = iter, out: Path | None = None) -> Written:
    """Write the report of a run, into it or into `out`; what was drawn before and has not changed is not drawn again.

    `progress` goes through the names of sequences as they are drawn. Raises `DataError` where it cannot be written.
    """
    run = open_run(folder)
    found, out = Found(run), out or folder / "report"
    drawn = Drawn(out / ".drawn")
    parts = {name: sequence_parts(found, name) for name in found.sequences}
    metrics, scores = read_metrics(run) if found.has("evaluate") else ({}, [])
    arrays: Metrics = {label: [one.arrays for one in seeds] for label, seeds in metrics.items()}
    trials = read_trials(run) if found.has("trials") else []
    verdicts = _verdicts(found, parts, arrays, trials)
    shown = [sequence_section(found, name, parts[name], drawn) for name in progress(found.sequences)]
    content = _about(found, scores) | {
        "verdicts": verdicts,
        "sequences": shown,
        "parts": list(next(iter(parts.values()), {})),
        "fewer": share_of(len(shown)) < SEQUENCE,
        "model": model_section(found, metrics, arrays, drawn),
        "plan": plan_section(found, drawn),
        "trials": trials_section(found, trials, drawn),
        "gaps": (gaps := found.gaps()),
    }
    text = _render(content)
    drawn.forget_others()
    with atomic_file(out / "index.html") as temporary:
        temporary.write_bytes(text.encode("utf-8", "replace"))
    return Written(out / "index.html", verdicts, gaps)


def _about(found: Found, scores: list[Any]) -> dict[str, Any]:
    """What a page says of the run as a whole."""
    return {
        "name": found.run.folder.resolve().name,
        "version": __version__,
        "date": datetime.datetime.now().astimezone().strftime("%d %B %Y, %H:%M"),
        "option": found.option,
        "checks": tables.check_rows(found),
        "scores": summarise_scores([one.arrays for one in scores]),
        "recipe": (found.run.folder / "recipe.toml").read_text("utf-8", "replace"),
        "settings": tables.setting_rows(found),
        "versions": tables.version_rows(),
        "keys": tables.key_rows(found),
    }


def _render(content: dict[str, Any]) -> str:
    """The page; everything in it is escaped but the style, the script and the plots of `svg_of`."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    script = (HERE / "page.js").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["plot"] = Markup
    style = Markup((HERE / "page.css").read_text("utf-8"))
    return environment.get_template("page.html").render(content, style=style, script=Markup(script), digest=digest)


def _verdicts(found: Found, parts: dict[str, dict[str, Part]], metrics: Metrics, trials: list[Trial]) -> list[Verdict]:
    verdicts = []
    for part in dict.fromkeys(part for of in parts.values() for part in of):
        stage = STAGES_OF[part] if found.has(STAGES_OF[part]) else found.run.maker("tracks").name
        verdicts.append(part_verdict(found, part, stage, {name: of[part] for name, of in parts.items()}))
    if found.has("train"):
        verdicts += [model_verdict(found, metrics), plan_verdict(found)]
    if found.has("trials"):
        verdicts.append(trials_verdict(found, trials))
    return verdicts
