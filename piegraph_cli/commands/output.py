"""What commands tell: the result on stdout, as lines or in the envelope of `--json`; the log in the run folder."""

import contextlib
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from piegraph_cli import __version__
from piegraph_cli.commands.answer import answer, error_object
from piegraph_cli.errors import DataError, MissingError, PiegraphError, UsageError
from piegraph_cli.stages import STAGES
from piegraph_cli.text import Column, Line, Table, plain

if TYPE_CHECKING:
    from piegraph_cli.workspace.execute import Outcome

FEW = 8
"""Up to this many units are listed one by one."""


@dataclass(frozen=True)
class Report:
    """What a command tells: the `result` of `--json`, lines for people, and the exit code."""

    value: dict[str, Any] | None
    lines: Sequence[Line]
    exit_code: int = 0
    error: PiegraphError | None = None
    """Why the exit code is not 0; by default the lines say it."""
    warnings: list[str] = field(default_factory=list)
    """Those among the lines; what is logged comes by itself."""


def emit(report: Report, as_json: bool) -> None:
    """Print a report, or keep it for the envelope, and end with its exit code."""
    if as_json:
        answer().result = report.value
        answer().warnings += report.warnings
        answer().error = error_object(_why(report)) if report.exit_code else None
    else:
        _show(report.lines)
    if report.exit_code:
        raise typer.Exit(report.exit_code)


def _show(lines: Sequence[Line]) -> None:
    """Print lines; tables are drawn where stdout is a terminal, and are plain text in files and pipes."""
    if sys.stdout.isatty() and any(isinstance(line, Table) for line in lines):
        from piegraph_cli.commands.terminal import show

        show(lines)
    else:
        print("\n".join(plain(lines)))


def _why(report: Report) -> PiegraphError:
    """Why a command did not end with 0."""
    kinds = {kind.exit_code: kind for kind in (UsageError, DataError, MissingError)}
    return report.error or kinds.get(report.exit_code, PiegraphError)("\n".join(plain(report.lines)[-1:]))


def summary(outcomes: "Sequence[Outcome]", folder: Path) -> Report:
    """A line per stage, or per unit where there are few; failures last. The exit code is the first failure's."""
    rows, failed = [], [o for o in outcomes if o.error]
    for name in dict.fromkeys(o.stage for o in outcomes):
        of_stage = [o for o in outcomes if o.stage == name and not o.error]
        if len(of_stage) > FEW:
            cached = sum(o.state == "cached" for o in of_stage)
            units = f"{len(of_stage)} {STAGES[name].unit}s"
            state = "cached" if cached == len(of_stage) else f"done, {cached} of them cached" if cached else "done"
            rows.append((name, units, state, f"last: {of_stage[-1].quality}"))
        else:
            rows += [(name, o.unit or "", o.state, o.quality) for o in of_stage]
    lines: list[Line] = [
        Table([Column("stage", 9), Column("of", 14), Column("state", 6), Column("result")], rows)
    ] * bool(rows)
    if failed:
        lines.append("failed: " + ", ".join(f"{o.stage} {o.unit}" if o.unit else o.stage for o in failed))
    value = {
        "run": str(folder),
        "outcomes": [asdict(o) | {"error": error_object(o.error) if o.error else None} for o in outcomes],
    }
    return _ended(value, lines or ["nothing to do"], outcomes)


def with_failures(value: dict[str, Any], lines: list[Line], outcomes: "Sequence[Outcome]") -> Report:
    """What a run has of a stage and what it has not: units whose inputs nobody made, with the command that makes these,
    and units that failed.
    """
    from piegraph_cli.errors import InputError

    missing = [(o, o.error) for o in outcomes if isinstance(o.error, InputError)]
    failed = [o for o in outcomes if o.error and not isinstance(o.error, InputError)]
    by_hint: dict[str, list[str]] = {}
    for o, error in missing:
        by_hint.setdefault(error.hint, []).append(f"{o.unit} ({error.message})")
    lines = lines + ([""] if missing or failed else [])
    for hint, units in by_hint.items():
        lines.append(f"missing: {', '.join(units)}\n  try: {hint}")
    if failed:
        lines.append(f"failed: {', '.join(str(o.unit) for o in failed)}")

    def row(o: "Outcome") -> dict[str, Any]:
        return {STAGES[o.stage].unit: o.unit, "error": error_object(o.error) if o.error else None}

    value = value | {
        "missing": [row(o) | {"command": error.hint} for o, error in missing],
        "failed": [row(o) for o in failed],
    }
    return _ended(value, lines, outcomes)


def _ended(value: dict[str, Any], lines: Sequence[Line], outcomes: "Sequence[Outcome]") -> Report:
    """A report that ends as the first failure says."""
    error = next((o.error for o in outcomes if o.error), None)
    return Report(value, lines, error.exit_code if error else 0, error)


class _LogFile(logging.FileHandler):
    """A log file whose own failure (a full disk, say) neither ends nor clutters the command."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Drop what cannot be written."""

    def close(self) -> None:
        """Close, even if the last lines cannot be written."""
        with contextlib.suppress(OSError):
            super().close()


@contextlib.contextmanager
def logging_to(folder: Path) -> Iterator[None]:
    """Log with details to RUN/run.log too."""
    log = logging.getLogger("piegraph")
    with contextlib.ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(contextlib.closing(_LogFile(folder / "run.log", encoding="utf-8")))
        except OSError as error:  # what is fresh can be read all the same
            log.warning("nothing is noted in run.log: %s", error)
        else:
            file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
            log.addHandler(file)
            stack.callback(log.removeHandler, file)
        log.debug("piegraph %s: %s", __version__, sys.argv[1:])
        yield
