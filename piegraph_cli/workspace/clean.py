"""What lies in a run folder and serves nothing any more: stale artifacts, those of no unit, and what killed processes left.

Only files that piegraph wrote are named, and links are not followed.
"""

import os
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from piegraph_cli.errors import DataError
from piegraph_cli.workspace.artifact import read_header
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.stage import Stage, Unit

TEMPORARY = re.compile(r"\.(.+)\.\d+\.tmp")
"""What `atomic_file` writes before it renames."""

ABANDONED = 60.0
"""Seconds after which a temporary file is taken for one that nobody writes any more."""


@dataclass(frozen=True)
class Waste:
    """A file that could go."""

    path: Path
    bytes: int
    changed: int
    """When, in nanoseconds."""
    reason: str
    lock: Path | None
    """What a process that writes the file holds."""


def find_waste(run: Run) -> list[Waste]:
    """The files of a run that could go; what another process works on is left out.

    Results of stages that a recipe has to name are left be where it does not name them: each answers a question of its own.
    """
    found = [*_artifacts(run), *_checkpoints(run), *_temporaries(run)]
    held = {lock for lock in {waste.lock for waste in found} if lock is not None and _held(lock)}
    return [waste for waste in found if waste.lock not in held]


def remove(waste: list[Waste]) -> list[Waste]:
    """Remove files and their locks; those that changed or are in use by now are left. Returns what was removed."""
    removed = []
    for one in waste:
        try:
            if one.lock is None:
                removed += _removed(one)
            else:
                one.lock.parent.mkdir(exist_ok=True)
                with FileLock(one.lock, timeout=0):
                    removed += _removed(one)
                    one.lock.unlink(missing_ok=True)
        except Timeout:
            continue
        except OSError as error:
            raise DataError(f"cannot be removed: {error}", str(one.path), "check permissions") from None
    return removed


def remove_locks(run: Run) -> None:
    """Remove the lock files that nobody holds: they are empty, and made when they are needed."""
    for entry in _files(run, run.lock_file("").parent.name):
        if entry.name.endswith(".lock"):
            with suppress(Timeout, OSError), FileLock(entry.path, timeout=0):
                Path(entry.path).unlink(missing_ok=True)


def _removed(waste: Waste) -> list[Waste]:
    try:
        found = waste.path.lstat()
    except FileNotFoundError:
        return []
    if (found.st_size, found.st_mtime_ns) != (waste.bytes, waste.changed):
        return []
    waste.path.unlink()
    return [waste]


def _artifacts(run: Run) -> Iterator[Waste]:
    for artifact in dict.fromkeys(stage.writes for stage in run.recipe.table.values()):
        stage = run.producer(artifact)
        if stage is None and run.maker(artifact).on_demand:
            continue
        units = set(run.units(stage)) if stage else set()
        for unit, entry in _stored(run, artifact):
            if read_header(Path(entry.path), artifact) is None:
                continue  # nothing says that it was written here
            if stage is None:
                reason = "no stage of the recipe makes it"
            elif unit not in units and not (stage.belongs and stage.belongs(run, unit)):
                reason = f"of no {stage.unit} of this run"
            else:
                reason = "" if run.fresh(stage, unit) else f"stale: {run.why_stale(stage, unit)}"
            if reason:
                yield _waste(entry, reason, run.lock_file(f"{artifact}/{unit}" if unit else artifact))


def _stored(run: Run, artifact: str) -> Iterator[tuple[Unit, os.DirEntry]]:
    """Files at the places of one artifact, by unit."""
    yield from ((None, entry) for entry in _files(run) if entry.name == f"{artifact}.h5")
    for entry in _files(run, artifact):
        if entry.name.endswith(".h5"):
            yield entry.name.removesuffix(".h5"), entry


def _checkpoints(run: Run) -> Iterator[Waste]:
    """States of trainings that nothing goes on from."""
    places: dict[str, tuple[Stage, Unit]] = {}
    for stage in run.chain:
        places |= {run.checkpoint(stage, unit).name: (stage, unit) for unit in run.units(stage)}
    for entry in _files(run, "checkpoints"):
        header = read_header(Path(entry.path), "checkpoint")
        if header is None:
            continue
        if entry.name not in places:
            name, _, unit = entry.name.removesuffix(".h5").partition(".")
            writer = run.recipe.table.get(name)  # which may be at work on it, with settings that are not kept yet
            lock = run.lock_file(f"{writer.writes}/{unit}") if writer else None
            yield _waste(entry, "checkpoint of nothing in this run", lock)
            continue
        stage, unit = places[entry.name]
        if run.fresh(stage, unit) or header.key != run.key(stage, unit):
            yield _waste(entry, "checkpoint that nothing goes on from", run.lock_file(f"{stage.writes}/{unit}"))


def _temporaries(run: Run) -> Iterator[Waste]:
    artifacts = {stage.writes for stage in run.recipe.table.values()}
    for folder in ("", "checkpoints", *sorted(artifacts)):
        for entry in _files(run, folder):
            age = time.time() - entry.stat(follow_symlinks=False).st_mtime
            if TEMPORARY.fullmatch(entry.name) and age > ABANDONED:
                yield _waste(entry, "left by a process that was killed")


def _held(lock: Path) -> bool:
    """Whether a process holds a lock; nothing is written to find out."""
    if not lock.is_file():
        return False
    try:
        with FileLock(lock, timeout=0):
            return False
    except (Timeout, OSError):  # where there are no locks nobody knows
        return True


def _files(run: Run, folder: str = "") -> list[os.DirEntry]:
    """The plain files of a run folder or of a folder in it that is no link, by name."""
    path = run.folder / folder
    if not path.is_dir() or (folder and path.is_symlink()):
        return []
    with os.scandir(path) as entries:
        return sorted((e for e in entries if e.is_file(follow_symlinks=False)), key=lambda e: e.name)


def _waste(entry: os.DirEntry, reason: str, lock: Path | None = None) -> Waste:
    found = entry.stat(follow_symlinks=False)
    return Waste(Path(entry.path), found.st_size, found.st_mtime_ns, reason, lock)
