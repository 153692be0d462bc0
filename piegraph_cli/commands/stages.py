"""The commands of the stages, all of them made from the stages' records."""

import contextlib
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from inspect import Signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.commands.options import running, stage_parameters
from piegraph_cli.commands.output import Report, emit, logging_to, summary, with_failures
from piegraph_cli.errors import PiegraphError, UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.call import options_of
from piegraph_cli.workspace.stage import Stage, load

if TYPE_CHECKING:
    from piegraph_cli.workspace.execute import Options, Outcome
    from piegraph_cli.workspace.recipe import Recipe
    from piegraph_cli.workspace.run import Run


def stage_commands() -> dict[str, Callable[..., None]]:
    """A command per stage, in the order of the pipeline."""
    return {stage.name: _command(stage) for stage in STAGES.values()}


def require_run(folder: Path) -> None:
    """Refuse a folder that is no run."""
    if not (folder / "recipe.toml").exists():
        raise UsageError(
            "not a run folder: it has no recipe.toml", str(folder), "start with piegraph ingest, or piegraph run"
        )


def _command(stage: Stage) -> Callable[..., None]:
    call = stage.call
    options = call.options() if call.options else options_of(stage.params)

    def command(
        folder: Path | None, force: bool, jobs: int, backend: str, device: str, as_json: bool, **values: Any
    ) -> None:
        given = {name: value for name, value in values.items() if value is not None}
        out: Path | None = given.pop("out", None) if call.out else None
        if folder is None:
            assert call.folder.default is not None
            folder = call.folder.default(given)
        instead = call.instead if call.instead and given.pop(call.instead.flag) else None
        run = open_run(folder)
        settings, units = call.apply(run, given) if call.apply else (given, ())
        how = running(units, force, jobs, backend, device)  # type: ignore[arg-type]
        before = run.recipe
        run.recipe = before.with_values(stage, settings, f"piegraph {stage.name}", Path.cwd())
        if instead:
            emit(Report(*instead.make(folder, run.recipe.params(stage), jobs, force)), as_json)
            return
        if stage.reads:
            require_run(folder)
        if call.out and (out or not os.access(folder, os.W_OK)):
            emit(_run_beside(stage, run, how, out), as_json)
            return
        emit(_run_in(folder, stage, run, how, before), as_json)

    command.__signature__ = Signature(stage_parameters(call, options))  # type: ignore[attr-defined]
    command.__doc__ = f"{stage.help[0].upper()}{stage.help[1:]}.\n\n{call.more}".strip()
    return command


def _run_in(folder: Path, stage: Stage, run: "Run", how: "Options", before: "Recipe") -> Report:
    """Run the stage; a new folder in which nothing was made is taken away again, unless its log tells of a bug."""
    new = not folder.exists()
    try:
        with logging_to(folder):
            report = _run(stage, run, how, before)
    except PiegraphError:
        if new:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    made = (folder / "recipe.toml").exists() or any(folder.rglob("*.h5"))
    if new and not made and report.error and report.error.kind != "bug":
        shutil.rmtree(folder, ignore_errors=True)
    return report


def _run(stage: Stage, run: "Run", options: "Options", before: "Recipe") -> Report:
    """Run the stage; keep settings that worked in the recipe, where the stage's are kept at all."""
    from piegraph_cli.workspace.execute import LeftOut, run_stage
    from piegraph_cli.workspace.together import keep_settings, tell_changes

    begin = time.monotonic()
    outcomes = run_stage(run, stage, options)
    seconds = time.monotonic() - begin
    for outcome in outcomes:
        if isinstance(outcome.error, LeftOut):
            logging.getLogger("piegraph").error("%s", outcome.error)
    tell_changes(run, outcomes)
    if stage.call.remembers and _accepted(outcomes):
        keep_settings(run, stage, before)
    return _report(stage, open_run(run.folder, run.recipe), outcomes, seconds)


def _run_beside(stage: Stage, run: "Run", options: "Options", out: Path | None) -> Report:
    """Run the stage in a folder that borrows what the run has: nothing is written into it. The artifact is kept in `out`."""
    written = f"{stage.writes}.h5"
    if out is not None:
        _check_out(out, stage)
    own = {written, "run.log", "failures.json", "warnings.json", ".locks", ".known.json", "checkpoints"}
    with tempfile.TemporaryDirectory(prefix="piegraph-") as made:
        folder = Path(made)
        for entry in run.folder.resolve().iterdir():
            if entry.name not in own:
                (folder / entry.name).symlink_to(entry)
            elif entry.name == ".known.json":  # what was read of files is known there, too, and may change there
                with contextlib.suppress(OSError):
                    shutil.copyfile(entry, folder / entry.name)
        with logging_to(folder), _called(folder, run.folder):
            report = _run(stage, open_run(folder, run.recipe), options, run.recipe)
            report = replace(report, error=_renamed(report.error, folder, run.folder))
            if out is None:
                logging.getLogger("piegraph").warning("%s: cannot be written, so the answer is not kept", run.folder)
        if out is not None and (folder / written).exists():
            with atomic_file(out) as temporary:
                shutil.copyfile(folder / written, temporary)
    if report.value and stage.name in report.value:
        report.value[stage.name] = str(out) if out else None
    return report


@contextlib.contextmanager
def _called(folder: Path, name: Path) -> Iterator[None]:
    """While this lasts a folder is called by another name in what is logged: that of the run it stands for."""

    def rename(record: logging.LogRecord) -> bool:
        record.msg, record.args = record.getMessage().replace(str(folder), str(name)), ()
        return True

    log = logging.getLogger("piegraph")
    log.addFilter(rename)
    try:
        yield
    finally:
        log.removeFilter(rename)


def _renamed(error: PiegraphError | None, folder: Path, name: Path) -> PiegraphError | None:
    """The error with the folder called by another name."""
    if error is None:
        return None
    texts = (text.replace(str(folder), str(name)) for text in (error.message, error.where, error.hint))
    return type(error)(*texts)


def _check_out(out: Path, stage: Stage) -> None:
    """Refuse to write where something else is, a model or a recipe, say. Raises `UsageError`."""
    from piegraph_cli.workspace.artifact import read_header

    if out.is_dir():
        raise UsageError("is a folder", str(out), f"name a file in it: --out {out / f'{stage.writes}.h5'}")
    if os.path.lexists(out) and read_header(out, stage.writes) is None:
        text = f"there is something already that is no {stage.writes} of this version"
        raise UsageError(text, str(out), "remove it, or --out FILE by another name")


def _accepted(outcomes: "Sequence[Outcome]") -> bool:
    """Whether settings worked: for one unit at least, and none was refused or lacked what it reads."""
    from piegraph_cli.errors import InputError

    refused = any(isinstance(o.error, (UsageError, InputError)) for o in outcomes)
    return not refused and any(not o.error for o in outcomes)


def _report(stage: Stage, run: "Run", outcomes: "Sequence[Outcome]", seconds: float) -> Report:
    """What the run has now, where the stage tells it and its only unit did not fail; else what became of the units."""
    report = summary(outcomes, run.folder)
    if stage.call.describe and any(o.unit is None and o.error for o in outcomes):
        return replace(report, value=None)
    if stage.call.describe:
        value, lines = load(stage.call.describe)(run)
        if stage.unit != "run":
            return with_failures(value, lines, outcomes)
        error = load(stage.call.refuses)(run) if stage.call.refuses else None
        if error is not None:
            logging.getLogger("piegraph").error("%s", error)
        return Report(value, lines, error.exit_code if error else 0, error)
    made = sum(o.state == "done" for o in outcomes)
    if stage.call.counts and made:
        rate = made * getattr(run.recipe.params(stage), stage.call.counts) / seconds
        told = {**(report.value or {}), f"{stage.call.counts}_per_second": rate}
        return replace(report, value=told, lines=[*report.lines, f"{rate:.1f} {stage.call.counts} a second"])
    return report
