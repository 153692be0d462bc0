"""What commands print: the result on stdout, as lines or as one JSON object; the log on stderr and in the run folder."""

import contextlib
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from piegraph_cli import __version__
from piegraph_cli.stages import STAGES

if TYPE_CHECKING:
    from piegraph_cli.workspace.execute import Outcome

FEW = 8
"""Up to this many units are listed one by one."""


@dataclass(frozen=True)
class Report:
    """What a command prints: an object for `--json`, lines for people, and the exit code."""

    value: dict[str, Any]
    lines: list[str]
    exit_code: int = 0


def emit(report: Report, as_json: bool) -> None:
    """Print a report, and end with its exit code."""
    if as_json:
        from piegraph_cli.evaluation.tables import as_json as text_of

        print(text_of(report.value))
    else:
        print("\n".join(report.lines))
    if report.exit_code:
        raise typer.Exit(report.exit_code)


def summary(outcomes: "Sequence[Outcome]", folder: Path) -> Report:
    """A line per stage, or per unit where there are few; failures last. The exit code is the first failure's."""
    lines, failed = [], [o for o in outcomes if o.error]
    for name in dict.fromkeys(o.stage for o in outcomes):
        of_stage = [o for o in outcomes if o.stage == name and not o.error]
        if len(of_stage) > FEW:
            cached = sum(o.state == "cached" for o in of_stage)
            units = f"{STAGES[name].unit}s"
            lines.append(
                f"{name:24s} {len(of_stage)} {units}, {cached} of them fresh already; last: {of_stage[-1].quality}"
            )
        else:
            lines += [f"{name} {o.unit or '':{23 - len(name)}s} {o.state:6s}  {o.quality}" for o in of_stage]
    if failed:
        lines.append("failed: " + ", ".join(f"{o.stage} {o.unit}" if o.unit else o.stage for o in failed))
    value = {
        "run": str(folder),
        "outcomes": [asdict(o) | {"error": str(o.error) if o.error else None} for o in outcomes],
    }
    return Report(value, lines or ["nothing to do"], exit_code(outcomes))


def with_failures(value: dict[str, Any], lines: list[str], outcomes: "Sequence[Outcome]") -> Report:
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

    def row(o: "Outcome") -> dict[str, str | None]:
        return {STAGES[o.stage].unit: o.unit, "error": str(o.error)}

    value = value | {
        "missing": [row(o) | {"command": error.hint} for o, error in missing],
        "failed": [row(o) for o in failed],
    }
    return Report(value, lines, exit_code(outcomes))


def exit_code(outcomes: "Sequence[Outcome]") -> int:
    """That of the first failure; 0 where nothing failed."""
    return next((o.error.exit_code for o in outcomes if o.error), 0)


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
    """Log to stderr, and with details to RUN/run.log."""
    log = logging.getLogger("piegraph")
    log.setLevel(logging.DEBUG)
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setLevel(logging.INFO)
    stderr.setFormatter(logging.Formatter("%(message)s"))
    log.handlers = [stderr]
    with contextlib.ExitStack() as stack:
        stack.callback(log.handlers.clear)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(contextlib.closing(_LogFile(folder / "run.log", encoding="utf-8")))
        except OSError as error:  # what is fresh can be read all the same
            log.warning("nothing is noted in run.log: %s", error)
        else:
            file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
            log.addHandler(file)
        log.debug("piegraph %s: %s", __version__, sys.argv[1:])
        yield
