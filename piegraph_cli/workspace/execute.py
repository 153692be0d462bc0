"""Running stages: skip what is fresh, take the lock, read, call, write; over units in parallel; failures kept apart."""

import contextlib
import logging
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from piegraph_cli.errors import DataError, InputError, MissingError, PiegraphError, command_line
from piegraph_cli.files import refused, remove_leftovers
from piegraph_cli.process import out_of_memory, short_of_memory
from piegraph_cli.signals import go_on
from piegraph_cli.workspace.artifact import Artifact, read_artifact, read_key, write_artifact
from piegraph_cli.workspace.locks import have_locks
from piegraph_cli.workspace.parallel import each
from piegraph_cli.workspace.progress import Tell, silent, watching
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.said import keep_warnings
from piegraph_cli.workspace.spent import Clock
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    import numpy as np

log = logging.getLogger("piegraph")


class LeftOut(DataError):
    """A unit was not tried, since it failed before."""


@dataclass(frozen=True)
class Checkpoint:
    """Where a long stage keeps its state; a state saved under another key is ignored."""

    path: Path
    stage: Stage
    key: str
    clock: Clock = field(default_factory=Clock)
    """Goes on with the state: what the tries before took counts."""

    def load(self) -> "dict[str, np.ndarray] | None":
        """The saved state, or None."""
        if read_key(self.path, "checkpoint") != self.key:
            return None
        saved = read_artifact(self.path, "checkpoint")
        self.clock.add(saved.made.get("wall_ms", 0), saved.made.get("cpu_ms", 0))
        return {name.removeprefix("state/"): value for name, value in saved.arrays.items()}

    def save(self, state: "Mapping[str, np.ndarray]") -> None:
        """Replace the saved state."""
        import numpy as np

        arrays = {f"state/{name}": np.asarray(value) for name, value in state.items()}
        write_artifact(
            self.path,
            "checkpoint",
            arrays,
            stage=self.stage.name,
            stage_version=self.stage.version,
            key=self.key,
            params={},
            inputs={},
            spent=self.clock.spent(),
        )


@dataclass(frozen=True)
class Options:
    """How to run: not part of any cache key."""

    only: tuple[str, ...] = ()
    """Units to work on; all where none is named."""
    force: bool = False
    jobs: int = 1
    backend: Literal["local", "ray"] = "local"
    device: str = "auto"


@dataclass(frozen=True)
class Outcome:
    """What became of one unit of a stage."""

    stage: str
    unit: Unit
    state: Literal["done", "cached", "failed"]
    seconds: float
    quality: str = ""
    warnings: tuple[str, ...] = ()
    error: PiegraphError | None = None


def run_stage(run: Run, stage: Stage, options: Options) -> list[Outcome]:
    """Run one stage over all its units; a unit that fails leaves the others be. Failures are recorded in the run.

    Units that failed in an earlier stage are failures here as well, without being tried.
    """
    run = Run(run.folder, run.recipe)
    try:
        _check_before(run, [stage], options)
        return _run_stage(run, stage, options)
    finally:
        run.known.save()


def _check_before(run: Run, stages: Sequence[Stage], options: Options) -> None:
    """Have the stages that can look at what they will need, before the first of them takes its time."""
    most = max((len(_to_do(run, stage, options)) for stage in stages), default=0)
    if trouble := short_of_memory(min(options.jobs, most)) if most else "":
        log.warning("%s", trouble)
    for stage in stages:
        if stage.check is None:
            continue
        todo = _to_do(run, stage, options)
        for warning in stage.check(run, todo, min(options.jobs, len(todo))) if todo else ():
            log.warning("%s: %s", stage.name, warning)


def _to_do(run: Run, stage: Stage, options: Options) -> list[Unit]:
    """The units that are wanted and not fresh, as far as one can tell now."""
    wanted = [u for u in run.units(stage) if not options.only or u in options.only]
    return [u for u in wanted if options.force or not run.fresh(stage, u)]


def _run_stage(run: Run, stage: Stage, options: Options) -> list[Outcome]:
    wanted = [u for u in run.units(stage) if not options.only or u in options.only]
    for unit in wanted[:1]:
        _require_inputs(run, stage, unit)
    left_out = {u: why for u in wanted if (why := run.failed_before(stage, u))}
    units = [u for u in wanted if u not in left_out]
    todo = [u for u in units if options.force or not run.fresh(stage, u)]
    tried = set(todo)
    cached = [u for u in units if u not in tried]
    _drop_states(run, stage, cached)
    outcomes = [Outcome(stage.name, u, "cached", 0.0, _quality(run, stage, u)) for u in cached]
    outcomes += _work_through(run, stage, todo, options) if todo else []
    _log_outcomes(outcomes)
    if todo:
        try:
            # what was not made yet is no failure: once it is there, the same key is to be tried
            failed = {o.unit: o.error for o in outcomes if o.error and not isinstance(o.error, InputError)}
            run.record_failures(stage, todo, failed)
            keep_warnings(run, stage, {o.unit: o.warnings for o in outcomes if o.state == "done"})
        except DataError as full:  # a full disk: the outcomes still count
            log.error("%s", full)
    for unit, why in left_out.items():
        error = LeftOut(f"left out, since it failed before: {why.splitlines()[0]}", str(unit))
        outcomes.append(Outcome(stage.name, unit, "failed", 0.0, error=error))
    return sorted(outcomes, key=lambda o: o.unit or "")


def _drop_states(run: Run, stage: Stage, units: Sequence[Unit]) -> None:
    """Remove states of units that are made: of processes that were killed between the artifact and the end."""
    for unit in units:
        with contextlib.suppress(OSError):
            run.checkpoint(stage, unit).unlink(missing_ok=True)


def _work_through(run: Run, stage: Stage, units: list[Unit], options: Options) -> list[Outcome]:
    jobs = max(1, min(options.jobs, len(units)))
    if jobs > 1 or options.backend == "ray":
        _tell_processes(run, stage, units)

    def lost(unit: Unit, error: PiegraphError) -> Outcome:
        return Outcome(stage.name, unit, "failed", 0.0, error=error)

    outcomes = []
    have_locks(run.lock_file("").parent)
    with watching(stage.name, len(units), stage.unit, jobs > 1, options.backend == "local") as (tell, finish):
        work = partial(run_unit, Run(run.folder.resolve(), run.recipe), stage, options=options, tell=tell)
        for outcome in each(work, units, jobs, options.backend, lost):
            go_on()
            outcomes.append(outcome)
            finish(outcome.unit or "")
    return outcomes


def _tell_processes(run: Run, stage: Stage, units: list[Unit]) -> None:
    """Keep what the keys of these units need in the run folder, where other processes read it once, when they start."""
    for unit in units:
        with contextlib.suppress(PiegraphError, OSError):  # whoever works on the unit says so
            run.key(stage, unit)
    run.known.save()


def run_unit(run: Run, stage: Stage, unit: Unit, options: Options, tell: Tell = silent) -> Outcome:
    """Make one artifact, unless another process has just made it. Every error of the stage comes back as an outcome."""
    start, before = time.monotonic(), _inode(run.path(stage.writes, unit))
    try:
        with run.lock(f"{stage.writes}/{unit}" if unit else stage.writes) as waited:
            for file in (run.path(stage.writes, unit), run.checkpoint(stage, unit)):
                remove_leftovers(file)
            if (waited or not options.force) and run.fresh(stage, unit):
                return Outcome(stage.name, unit, "cached", 0.0, _quality(run, stage, unit))
            other = _inode(run.path(stage.writes, unit)) != before and not run.fresh(stage, unit)
            warnings = _made_meanwhile(run, stage, unit) if other else []
            output = _make(run, stage, unit, options, tell)
        warnings += output.warnings
        return Outcome(stage.name, unit, "done", time.monotonic() - start, output.quality, tuple(warnings))
    except PiegraphError as error:
        go_on()
        return Outcome(stage.name, unit, "failed", time.monotonic() - start, error=error)
    except Exception as error:
        go_on()  # what a signal was made into, by a module that was being imported perhaps, is no bug
        log.debug("%s", traceback.format_exc())
        return Outcome(stage.name, unit, "failed", time.monotonic() - start, error=_told(error, run, stage))


def _inode(path: Path) -> int | None:
    """Which file is at a place: one that is made again is another one."""
    try:
        return path.stat().st_ino
    except OSError:
        return None


def _made_meanwhile(run: Run, stage: Stage, unit: Unit) -> list[str]:
    """What to say where another process made an artifact while this one waited, and not as this one has to."""
    why = run.why_stale(stage, unit)
    return [f"another piegraph has just made {stage.writes} otherwise ({why}); it is made again as this command has it"]


def _told(error: Exception, run: Run, stage: Stage) -> PiegraphError:
    """An error that nobody foresaw: of a machine that lacks something, or a bug."""
    if out_of_memory(error):
        hint = "fewer --jobs, or end other programs; what is done is kept"
        return MissingError(f"there is not enough memory: {str(error) or type(error).__name__}", stage.name, hint)
    if told := refused(error, stage.name):
        return told
    bug = PiegraphError(
        f"{type(error).__name__}: {error}", f"bug in {stage.name}", f"the traceback is in {run.folder}/run.log"
    )
    bug.traceback = traceback.format_exc()  # type: ignore[attr-defined]
    return bug


def _make(run: Run, stage: Stage, unit: Unit, options: Options, tell: Tell) -> Output:
    key = run.key(stage, unit)
    inputs: dict[str, Any] = {
        name: _OnDemand(run, name, units) if isinstance(units, list) else run.read(name, units)
        for name, units in run.inputs(stage, unit).items()
    }
    checkpoint = Checkpoint(run.checkpoint(stage, unit), stage, key)
    context = Context(run, unit, options.device, checkpoint, tell)
    params = run.settings(stage, unit)
    output = stage.load()(inputs, params, context)
    write_artifact(
        run.path(stage.writes, unit),
        stage.writes,
        output.arrays,
        stage=stage.name,
        stage_version=stage.version,
        key=key,
        params=params.content(),
        inputs={f"{name}/{u}" if u else name: run.key(run.maker(name), u) for name, u in run.files(stage, unit)},
        quality=output.quality,
        spent=checkpoint.clock.spent(),
    )
    checkpoint.path.unlink(missing_ok=True)
    return output


class _OnDemand(Mapping[str, Artifact]):
    """One artifact of many units, read when asked for: the frames of a whole recording would not fit into memory."""

    def __init__(self, run: Run, name: str, units: list[str]):
        self.run, self.name, self.units = run, name, units

    def __getitem__(self, unit: str) -> Artifact:
        if unit not in self.units:
            raise KeyError(unit)
        return self.run.read(self.name, unit)

    def __iter__(self) -> Iterator[str]:
        return iter(self.units)

    def __len__(self) -> int:
        return len(self.units)


def _require_inputs(run: Run, stage: Stage, unit: Unit) -> None:
    """Refuse a stage that gathers what no unit has."""
    for name, units in run.inputs(stage, unit).items():
        if units == [] and name in stage.reads:
            reasons = "; ".join(sorted({r["message"].splitlines()[0] for r in run.failures.values()}))
            raise DataError(
                f"no {run.maker(name).unit} has {name}: {reasons}",
                str(run.folder),
                command_line("status", "--run", run.folder),
            )


def _quality(run: Run, stage: Stage, unit: Unit) -> str:
    header = run.header(stage, unit)
    return header.quality if header else ""


def _log_outcomes(outcomes: list[Outcome]) -> None:
    """Failures and warnings to the user, equal ones once; everything to the log file."""
    failures: dict[str, list[Outcome]] = {}
    for outcome in sorted(outcomes, key=lambda o: o.unit or ""):
        name = f"{outcome.stage} {outcome.unit}" if outcome.unit else outcome.stage
        if outcome.error:
            failures.setdefault(str(outcome.error), []).append(outcome)
            log.debug("%s", getattr(outcome.error, "traceback", ""))
        elif outcome.state == "done":
            log.debug("%s: %s (%.1f s)", name, outcome.quality, outcome.seconds)
            for warning in outcome.warnings:
                log.warning("%s: %s", name, warning)
    for message, same in failures.items():
        names = ", ".join(o.unit for o in same if o.unit)
        log.error("%s failed%s: %s", same[0].stage, f" on {names}" if names else "", message)


def run_chain(run: Run, until: str | None, options: Options) -> list[Outcome]:
    """Run a recipe's stages in order, each on what the stages before it could make."""
    outcomes: list[Outcome] = []
    current = Run(run.folder, run.recipe)
    try:
        last = next((k for k, stage in enumerate(current.chain) if stage.name == until), len(current.chain))
        _check_before(current, current.chain[: last + 1], options)
        for stage in current.chain:
            begin = time.monotonic()
            found = _run_stage(current, stage, options)
            outcomes += [o for o in found if not isinstance(o.error, LeftOut)]
            log.info("%-9s %6.1f s", stage.name, time.monotonic() - begin)
            if any(o.unit is None and o.error for o in found) or stage.name == until:
                break
            if any(o.state != "cached" for o in found):
                current = Run(run.folder, run.recipe)
    finally:
        current.known.save()
    return outcomes
