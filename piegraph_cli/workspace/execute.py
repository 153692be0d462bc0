"""Running stages: skip what is fresh, take the lock, read, call, write; over sequences in parallel; failures kept apart."""

import logging
import time
import traceback
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from filelock import Timeout

from piegraph_cli.errors import DataError, PiegraphError
from piegraph_cli.stages import STAGES, Stage
from piegraph_cli.workspace.artifact import Artifact, read_artifact, read_key, remove_leftovers, write_artifact
from piegraph_cli.workspace.parallel import each
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run

log = logging.getLogger("piegraph")

LEFT_OUT = "left out, since it failed before"


@dataclass(frozen=True)
class Output:
    """What a stage returns: arrays by dataset name, one line on their quality, and warnings with the next step."""

    arrays: Mapping[str, np.ndarray]
    quality: str
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Context:
    """What a stage may use beside its inputs and settings."""

    run: Run
    sequence: str | None
    device: str
    checkpoint: "Checkpoint"
    quiet: bool

    def progress(self, items: Iterable, what: str, total: int | None = None) -> Iterator:
        """The items, with a progress bar on stderr where that is a terminal."""
        from tqdm import tqdm

        name = f"{what} {self.sequence}" if self.sequence else what
        yield from tqdm(items, desc=name, total=total, leave=False, disable=None if not self.quiet else True, delay=1)


@dataclass(frozen=True)
class Checkpoint:
    """Where a long stage keeps its state; a state saved under another key is ignored."""

    path: Path
    key: str

    def load(self) -> dict[str, np.ndarray] | None:
        """The saved state, or None."""
        if read_key(self.path, "checkpoint") != self.key:
            return None
        arrays = read_artifact(self.path, "checkpoint").arrays
        return {name.removeprefix("state/"): value for name, value in arrays.items()}

    def save(self, state: Mapping[str, np.ndarray]) -> None:
        """Replace the saved state."""
        arrays = {f"state/{name}": np.asarray(value) for name, value in state.items()}
        name = self.path.stem.partition(".")[0]
        write_artifact(
            self.path,
            "checkpoint",
            arrays,
            stage=name,
            stage_version=STAGES[name].version,
            key=self.key,
            params={},
            inputs={},
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
    recipe: Recipe | None = None
    """Settings to run with in place of the run's own."""


@dataclass(frozen=True)
class Outcome:
    """What became of one unit of a stage."""

    stage: str
    sequence: str | None
    state: Literal["done", "cached", "failed"]
    seconds: float
    quality: str = ""
    warnings: tuple[str, ...] = ()
    error: PiegraphError | None = None


def run_stage(folder: Path, stage: Stage, options: Options) -> list[Outcome]:
    """Run one stage over all its units; a unit that fails leaves the others be. Failures are recorded in the run.

    Sequences that failed in an earlier stage are failures here as well, without being tried.
    """
    run = Run.open(folder, options.recipe)
    if stage.per == "run":
        _require_inputs(run, stage)
    wanted = [u for u in run.units(stage) if not options.only or u in options.only]
    left_out = {u: why for u in wanted if u is not None and (why := _failed_earlier(run, stage, u))}
    units = [u for u in wanted if u not in left_out]
    todo = [u for u in units if options.force or run.state(stage, u) != "fresh"]
    outcomes = [Outcome(stage.name, u, "cached", 0.0, _quality(run, stage, u)) for u in units if u not in todo]
    outcomes += _work_through(run, stage, todo, options)
    failed = {o.sequence: o.error for o in outcomes if o.error}
    _log_outcomes(outcomes)
    if todo:
        try:
            run.record_failures(stage, failed)
        except DataError as full:  # a full disk: the outcomes still count
            log.error("%s", full)
    for unit, why in left_out.items():
        error = DataError(f"{LEFT_OUT}: {why.splitlines()[0]}", str(unit))
        outcomes.append(Outcome(stage.name, unit, "failed", 0.0, error=error))
    return sorted(outcomes, key=lambda o: o.sequence or "")


def _work_through(run: Run, stage: Stage, units: list[str | None], options: Options) -> list[Outcome]:
    from tqdm import tqdm

    many = len(units) > 1 or options.backend == "ray"
    work = partial(run_unit, run.folder.resolve(), stage.name, options=options, quiet=many)

    def lost(unit: str | None, error: PiegraphError) -> Outcome:
        return Outcome(stage.name, unit, "failed", 0.0, error=error)

    jobs = max(1, min(options.jobs, len(units)))
    bar = tqdm(total=len(units), desc=stage.name, leave=False, disable=None if many else True)
    with bar:
        return [outcome for outcome in each(work, units, jobs, options.backend, lost) if bar.update() or True]


def run_unit(folder: Path, stage_name: str, sequence: str | None, options: Options, quiet: bool = True) -> Outcome:
    """Make one artifact, unless another process has just made it. Every error of the stage comes back as an outcome."""
    stage, run, start = STAGES[stage_name], Run.open(folder, options.recipe), time.monotonic()
    try:
        path = run.path(stage.writes, sequence)
        with _locked(run, stage, sequence) as waited:
            for file in (path, run.checkpoint(stage, sequence)):
                remove_leftovers(file)
            if (waited or not options.force) and run.state(stage, sequence) == "fresh":
                return Outcome(stage_name, sequence, "cached", 0.0, _quality(run, stage, sequence))
            output = _make(run, stage, sequence, options, quiet)
        return Outcome(stage_name, sequence, "done", time.monotonic() - start, output.quality, tuple(output.warnings))
    except PiegraphError as error:
        return Outcome(stage_name, sequence, "failed", time.monotonic() - start, error=error)
    except Exception as error:
        log.debug("%s", traceback.format_exc())
        bug = PiegraphError(
            f"{type(error).__name__}: {error}", f"bug in {stage_name}", f"the traceback is in {folder}/run.log"
        )
        bug.traceback = traceback.format_exc()  # type: ignore[attr-defined]
        return Outcome(stage_name, sequence, "failed", time.monotonic() - start, error=bug)


def _make(run: Run, stage: Stage, sequence: str | None, options: Options, quiet: bool) -> Output:
    key = run.key(stage, sequence)
    files = run.inputs(stage, sequence)
    inputs: dict[str, Any] = {}
    for name in dict.fromkeys(name for name, _ in files):
        units = [unit for n, unit in files if n == name]
        if run.producer(name).per == "sequence" and stage.per != "sequence":
            inputs[name] = _OnDemand(run, name, [unit for unit in units if unit])
        else:
            inputs[name] = _read_fresh(run, name, units[0])
    checkpoint = Checkpoint(run.checkpoint(stage, sequence), key)
    context = Context(run, sequence, options.device, checkpoint, quiet)
    params = run.params(stage, sequence)
    output = stage.load()(inputs, params, context)
    write_artifact(
        run.path(stage.writes, sequence),
        stage.writes,
        output.arrays,
        stage=stage.name,
        stage_version=stage.version,
        key=key,
        params=params.model_dump(mode="json"),
        inputs={f"{name}/{s}" if s else name: run.key(run.producer(name), s) for name, s in files},
        quality=output.quality,
    )
    checkpoint.path.unlink(missing_ok=True)
    return output


class _OnDemand(Mapping[str, Artifact]):
    """One artifact of many sequences, read when asked for: the frames of a whole recording would not fit into memory."""

    def __init__(self, run: Run, name: str, sequences: list[str]):
        self.run, self.name, self.sequences = run, name, sequences

    def __getitem__(self, sequence: str) -> Artifact:
        if sequence not in self.sequences:
            raise KeyError(sequence)
        return _read_fresh(self.run, self.name, sequence)

    def __iter__(self) -> Iterator[str]:
        return iter(self.sequences)

    def __len__(self) -> int:
        return len(self.sequences)


def _read_fresh(run: Run, name: str, sequence: str | None) -> Artifact:
    producer = run.producer(name)
    state = run.state(producer, sequence)
    if state != "fresh":
        where = str(run.path(name, sequence))
        raise DataError(f"{name} is {state}", where, f"piegraph run --run {run.folder} --until {producer.name}")
    return read_artifact(run.path(name, sequence), name)


def _require_inputs(run: Run, stage: Stage) -> None:
    files = run.inputs(stage, None)
    for name in stage.reads:
        if not any(n == name for n, _ in files):
            reasons = "; ".join(sorted({r["message"].splitlines()[0] for r in run.failures.values()}))
            raise DataError(
                f"no sequence has {name}: {reasons}", str(run.folder), f"piegraph status --run {run.folder}"
            )


def _failed_earlier(run: Run, stage: Stage, sequence: str) -> str | None:
    chain = run.recipe.chain()
    before = [s for s in chain[: chain.index(stage)] if s.per == stage.per] if stage in chain else []
    return run.failure(before[-1], sequence) if before else None


def _quality(run: Run, stage: Stage, sequence: str | None) -> str:
    import h5py

    with h5py.File(run.path(stage.writes, sequence), "r") as file:
        return str(file.attrs["quality"])


class _locked:
    """The lock of one artifact; tells whether another process had it, for then its result may be used."""

    def __init__(self, run: Run, stage: Stage, sequence: str | None):
        self.lock = run.lock(f"{stage.writes}/{sequence}" if sequence else stage.writes)

    def __enter__(self) -> bool:
        try:
            self.lock.acquire(timeout=0)
            return False
        except Timeout:
            log.info("waiting for another piegraph that works on %s", self.lock.lock_file)
            self.lock.acquire()
            return True

    def __exit__(self, *_: object) -> None:
        self.lock.release()


def _log_outcomes(outcomes: list[Outcome]) -> None:
    """Failures and warnings to the user, equal ones once; everything to the log file."""
    failures: dict[str, list[Outcome]] = {}
    for outcome in sorted(outcomes, key=lambda o: o.sequence or ""):
        name = f"{outcome.stage} {outcome.sequence}" if outcome.sequence else outcome.stage
        if outcome.error:
            failures.setdefault(str(outcome.error), []).append(outcome)
            log.debug("%s", getattr(outcome.error, "traceback", ""))
        elif outcome.state == "done":
            log.debug("%s: %s (%.1f s)", name, outcome.quality, outcome.seconds)
            for warning in outcome.warnings:
                log.warning("%s: %s", name, warning)
    for message, same in failures.items():
        names = ", ".join(o.sequence for o in same if o.sequence)
        log.error("%s failed%s: %s", same[0].stage, f" on {names}" if names else "", message)


def run_chain(folder: Path, until: str | None, options: Options) -> list[Outcome]:
    """Run a recipe's stages in order, each on what the stages before it could make."""
    chain = Run.open(folder, options.recipe).recipe.chain()
    outcomes: list[Outcome] = []
    for stage in chain:
        begin = time.monotonic()
        found = run_stage(folder, stage, options)
        outcomes += [o for o in found if not (o.error and o.error.message.startswith(LEFT_OUT))]
        log.info("%-9s %6.1f s", stage.name, time.monotonic() - begin)
        if (stage.per == "run" and found[-1].error) or stage.name == until:
            break
    return outcomes


def status(folder: Path) -> list[dict[str, Any]]:
    """One row per stage and unit: stage, sequence, artifact, state, quality and the failure's message."""
    run = Run.open(folder)
    rows = []
    for stage in run.recipe.chain():
        for unit in run.units(stage):
            state = run.state(stage, unit)
            rows.append(
                {
                    "stage": stage.name,
                    "sequence": unit,
                    "artifact": str(run.path(stage.writes, unit)),
                    "state": state,
                    "quality": _quality(run, stage, unit) if state == "fresh" else "",
                    "failure": (run.failure(stage, unit) if state == "failed" and unit else None) or "",
                    "reason": run.why_stale(stage, unit) if state == "stale" else "",
                }
            )
    return rows
