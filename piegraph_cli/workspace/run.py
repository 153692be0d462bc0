"""A run folder: where its artifacts are, the key each should have, and so what is fresh, stale, failed or missing."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

from piegraph_cli.errors import DataError, InputError, PiegraphError, UsageError, command_line
from piegraph_cli.files import atomic_file
from piegraph_cli.params import Params
from piegraph_cli.workspace.artifact import Artifact, Header, read_artifact
from piegraph_cli.workspace.known import Known, files_below, known_of
from piegraph_cli.workspace.locks import held
from piegraph_cli.workspace.recipe import Recipe, load_recipe, put
from piegraph_cli.workspace.stage import Inputs, Stage, Table, Unit

_as_json = json.JSONEncoder(sort_keys=True).encode

Found = TypeVar("Found")
BLOCK = 1 << 20
"""Bytes of a file that are read at a time."""

FROM_OTHERS = "what it was made from has changed"


@dataclass(frozen=True)
class _Settings:
    """The settings of one unit, what results depend on of them, and the files they name."""

    params: Params
    content: dict[str, Any]
    files: dict[str, Path]
    gone: bool
    """Whether a file is not there."""


@dataclass
class Run:
    """One run folder with the recipe in force.

    Keys, states and failures are worked out once per object: make a new one after a change.
    """

    folder: Path
    recipe: Recipe
    _keys: dict[tuple[str, Unit], str] = field(default_factory=dict)
    _headers: dict[tuple[str, Unit], Header | None] = field(default_factory=dict)
    _fresh: dict[tuple[str, Unit], bool] = field(default_factory=dict)
    _failed: dict[tuple[str, Unit], str | None] = field(default_factory=dict)
    _settings: dict[tuple[str, Unit], "_Settings"] = field(default_factory=dict)
    _units: dict[str, list[Unit]] = field(default_factory=dict)
    _beside: dict[Path, "Run"] = field(default_factory=dict)
    _found: dict[str, Any] = field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy in another process works its keys out anew."""
        return Run, (self.folder, self.recipe)

    @classmethod
    def open(cls, folder: Path, table: Table, recipe: Recipe | None = None) -> "Run":
        """An existing run, or an empty one where there is none yet; with another recipe than the one it keeps."""
        path = folder / "recipe.toml"
        if folder.exists() and not folder.is_dir():
            raise UsageError("is a file", str(folder), "give --run a folder")
        if recipe is None:
            recipe = load_recipe(path, table) if path.exists() else Recipe(table)
        return cls(folder, recipe)

    def beside(self, folder: Path) -> "Run":
        """Another run whose results this one uses, opened once."""
        if folder not in self._beside:
            self._beside[folder] = Run.open(folder, self.recipe.table)
        return self._beside[folder]

    def once(self, stage: str, find: Callable[["Run"], Found]) -> Found:
        """What a stage has to look up of this run to name its units, found once."""
        if stage not in self._found:
            self._found[stage] = find(self)
        return self._found[stage]

    def save_recipe(self) -> None:
        """Keep the recipe in force in the run folder."""
        path = self.folder / "recipe.toml"
        if not path.exists() or load_recipe(path, self.recipe.table) != self.recipe:
            self.recipe.save(path)

    def path(self, artifact: str, unit: Unit) -> Path:
        """Where an artifact is."""
        return self.folder / _place(artifact, unit)

    @cached_property
    def known(self) -> Known:
        """What is known of files from earlier reads."""
        return known_of(self.folder)

    def header(self, stage: Stage, unit: Unit) -> Header | None:
        """What the stage's artifact says of itself; None where it is absent, damaged or of another schema."""
        slot = (stage.name, unit)
        if slot not in self._headers:
            place = _place(stage.writes, unit)
            self._headers[slot] = self.known.header(place, f"{self.folder}/{place}", stage.writes)
        return self._headers[slot]

    def checkpoint(self, stage: Stage, unit: Unit) -> Path:
        """Where a long stage keeps its state until it is done."""
        return self.folder / "checkpoints" / f"{stage.name}.{unit}.h5"

    def lock(self, name: str) -> AbstractContextManager[bool]:
        """The lock that keeps two processes from making the same artifact; tells whether another had it before."""
        return held(self.lock_file(name))

    def lock_file(self, name: str) -> Path:
        """Where that lock is."""
        return self.folder / ".locks" / f"{name.replace('/', '.')}.lock"

    @cached_property
    def chain(self) -> list[Stage]:
        """The stages of this run, in order."""
        return self.recipe.chain()

    @cached_property
    def _producers(self) -> dict[str, Stage]:
        return {stage.writes: stage for stage in self.chain}

    @cached_property
    def _makers(self) -> dict[str, Stage]:
        return {stage.writes: stage for stage in reversed(list(self.recipe.table.values()))} | self._producers

    def producer(self, artifact: str) -> Stage | None:
        """The stage of this run's chain that writes an artifact, if one does."""
        return self._producers.get(artifact)

    def params(self, stage: str) -> Any:
        """The settings of a stage by name, whether it is in this run's chain or not."""
        return self.recipe.params(self.recipe.table[stage])

    def units(self, stage: Stage) -> list[Unit]:
        """What a stage works through: the run's sequences, its models, its trials, or the run itself (None)."""
        if stage.name not in self._units:
            first = None if stage.units else self.maker(stage.reads[0])
            self._units[stage.name] = list(stage.units(self)) if stage.units else self.units(first) if first else []
        return self._units[stage.name]

    def maker(self, artifact: str) -> Stage:
        """The stage that writes an artifact here, or would if it were in the chain."""
        return self._makers[artifact]

    def made(self, artifact: str) -> list[str]:
        """The units that this run has an artifact of, or can make it of: those that failed are left out."""
        producer = self.producer(artifact)
        return [u for u in self.units(producer) if u and not self.failure(producer, u)] if producer else []

    def settings(self, stage: Stage, unit: Unit) -> Params:
        """The settings that one unit of a stage depends on."""
        return self._settings_of(stage, unit).params

    def _settings_of(self, stage: Stage, unit: Unit) -> "_Settings":
        slot = (stage.name, unit if stage.settings else None)
        if slot not in self._settings:
            own = stage.settings if unit or stage.unit == "run" else None
            params = own(self, unit) if own else self.recipe.params(stage)
            files = params.files()
            gone = not all(path.exists() for path in files.values())
            self._settings[slot] = _Settings(params, params.content(), files, gone)
        return self._settings[slot]

    def inputs(self, stage: Stage, unit: Unit) -> Inputs:
        """What one unit of a stage reads, by artifact in the order of the stage's record."""
        return stage.inputs(self, unit) if stage.inputs else dict.fromkeys(stage.reads, unit)

    def files(self, stage: Stage, unit: Unit) -> Iterator[tuple[str, Unit]]:
        """The (artifact, unit) that one unit of a stage reads, one by one."""
        for artifact, units in self.inputs(stage, unit).items():
            yield from ((artifact, u) for u in (units if isinstance(units, list) else [units]))

    def key(self, stage: Stage, unit: Unit) -> str:
        """The key the stage's artifact has when it is fresh: a hash of the stage, its settings and its inputs' keys."""
        slot = (stage.name, unit)
        if slot not in self._keys:
            self._keys[slot] = self._work_out_key(stage, unit)
        return self._keys[slot]

    def _work_out_key(self, stage: Stage, unit: Unit) -> str:
        of = self._settings_of(stage, unit)
        if of.gone and (kept := self._kept_key(stage, unit, of.content)):
            return kept
        settings = dict(of.content)
        for name, path in of.files.items():
            settings = put(
                settings, name, self.known.content(path, partial(content_hash, path, name.rpartition(".")[2]))
            )
        for name, (path, artifact) in of.params.artifacts().items():
            header = self.known.header(os.path.abspath(path), str(path), artifact)
            settings[name] = header.key if header else None
        inputs = [[name, u, self.key(self.maker(name), u)] for name, u in self.files(stage, unit)]
        text = _as_json([stage.name, stage.version, None if stage.reads else unit, settings, inputs])
        return hashlib.sha256(text.encode()).hexdigest()

    def _kept_key(self, stage: Stage, unit: Unit, settings: dict[str, Any]) -> str | None:
        """The key of an artifact whose source files are gone, if it was made with these settings: it stays usable."""
        header = self.header(stage, unit)
        return header.key if header and (header.version, header.params) == (stage.version, settings) else None

    def why_stale(self, stage: Stage, unit: Unit) -> str:
        """What differs between a stale artifact and the one that would be made."""
        header = self.header(stage, unit)
        if header is None:
            try:
                read_artifact(self.path(stage.writes, unit), stage.writes)
            except DataError as error:
                return error.message
            return "unreadable"
        if header.version != stage.version:
            return f"made by version {header.version} of the stage, this is version {stage.version}"
        settings = self._settings_of(stage, unit).content
        now, then = (values | values.get("settings", {}) | {"settings": None} for values in (settings, header.params))
        changed = [name for name, value in now.items() if then.get(name) != value]
        return f"settings changed: {', '.join(changed)}" if changed else FROM_OTHERS

    def fresh(self, stage: Stage, unit: Unit) -> bool:
        """Whether the artifact is there and is what would be made."""
        slot = (stage.name, unit)
        if slot not in self._fresh:
            header = self.header(stage, unit)
            self._fresh[slot] = header is not None and header.key == self.key(stage, unit)
        return self._fresh[slot]

    def read(self, artifact: str, unit: Unit = None) -> Artifact:
        """An artifact of this run. Raises `InputError` with the command that makes it where it is not fresh."""
        producer = self.maker(artifact)
        state = self.state(producer, unit)
        if state != "fresh":
            default = command_line("run", "--run", self.folder, "--until", producer.name)
            hint = producer.command(self, unit) if producer.command else default
            raise InputError(f"{artifact} is {state}", str(self.path(artifact, unit)), hint)
        return self.known.read(_place(artifact, unit), self.path(artifact, unit), artifact)

    def state(self, stage: Stage, unit: Unit) -> str:
        """`fresh`, `stale`, `missing` or `failed`."""
        if self.fresh(stage, unit):
            return "fresh"
        if self.failure(stage, unit):
            return "failed"
        return "stale" if self.path(stage.writes, unit).exists() else "missing"

    def failure(self, stage: Stage, unit: Unit) -> str | None:
        """Why this stage, or one before it on the unit of the same name, failed with the settings in force, if one did.

        What is fresh has not failed, whatever was tried since.
        """
        if not self.failures:
            return None
        slot = (stage.name, unit)
        if slot not in self._failed:
            record = self.failures.get(f"{stage.name}/{unit}")
            own = record and record["key"] == self.key(stage, unit) and not self.fresh(stage, unit)
            self._failed[slot] = record["message"] if record and own else self.failed_before(stage, unit)
        return self._failed[slot]

    def failed_before(self, stage: Stage, unit: Unit) -> str | None:
        """Why a stage that this one depends on failed on the unit of the same name, if one did."""
        if not self.failures or unit is None:
            return None
        before = (self.producer(name) for name, u in self.files(stage, unit) if u == unit)
        return next((why for earlier in before if earlier and (why := self.failure(earlier, unit))), None)

    @cached_property
    def failures(self) -> dict[str, dict[str, Any]]:
        """Recorded failures by `stage/unit`; what is no such record is left out."""
        try:
            found = json.loads((self.folder / "failures.json").read_text()).items()
            return {k: r for k, r in found if isinstance(r["key"], str) and isinstance(r["message"], str)}
        except (OSError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
            return {}

    def record_failures(self, stage: Stage, tried: list[Unit], failed: Mapping[Unit, PiegraphError]) -> None:
        """Replace the failures recorded for the units of a stage that were tried."""
        with self.lock("failures.json"):
            self.__dict__.pop("failures", None)
            places = {f"{stage.name}/{unit}" for unit in tried}
            kept = {place: record for place, record in self.failures.items() if place not in places}
            for unit, error in failed.items():
                kept[f"{stage.name}/{unit}"] = {"key": self.key(stage, unit), "message": str(error)}
            if kept != self.failures:
                with atomic_file(self.folder / "failures.json") as temporary:
                    temporary.write_text(json.dumps(kept, indent=1))
            self.failures, self._failed = kept, {}


def _place(artifact: str, unit: Unit) -> str:
    """Where an artifact is in a run folder."""
    return f"{artifact}/{unit}.h5" if unit else f"{artifact}.h5"


BESIDE = ("calibration_sequence", "T_world_robot")
"""Fields of a cameras.json that say nothing of its cameras."""


def content_hash(path: Path, setting: str) -> str:
    """sha256 of a file, or of a folder's file names and contents, together with a cameras.json beside it.

    Names that begin with a dot are nobody's.
    """
    digest = hashlib.sha256()
    if path.is_dir():
        try:
            files = sorted(path / name for name, _ in files_below(str(path)))
        except OSError as error:
            where = str(error.filename or path)
            raise DataError(f"cannot be read: {error.strerror or error}", where, "give yourself the right") from None
    elif path.is_file():
        files = [path]
    else:
        raise DataError("no such file or folder", str(path), f"correct the setting {setting}")
    files += [p for p in [path.parent / "cameras.json"] if p.is_file() and p != path]
    for file in files:
        digest.update(os.fsencode(file.relative_to(path.parent).as_posix()) + b"\0")
        digest.update(_file_hash(file))
    return digest.hexdigest()


def _file_hash(path: Path) -> bytes:
    """sha256 of a file, which may be larger than the memory; of a cameras.json without `BESIDE`."""
    digest = hashlib.sha256()
    try:
        if path.name == "cameras.json":
            return hashlib.sha256(_of_cameras(path.read_bytes())).digest()
        with path.open("rb") as file:
            while part := file.read(BLOCK):
                digest.update(part)
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror or error}", str(path), "give yourself the right") from None
    return digest.digest()


def _of_cameras(data: bytes) -> bytes:
    """A cameras.json as it would be written without `BESIDE`; as it is where it has nothing of these."""
    if not any(f'"{name}"'.encode() in data for name in BESIDE):
        return data
    try:
        kept = {name: value for name, value in json.loads(data).items() if name not in BESIDE}
    except (ValueError, AttributeError, RecursionError):
        return data  # reading it says what is wrong
    return (json.dumps(kept, indent=1) + "\n").encode()
