"""A run folder: where its artifacts are, the key each should have, and so what is fresh, stale, failed or missing."""

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from filelock import FileLock

from piegraph_cli.dynamics.params import TrainParams
from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.errors import DataError, PiegraphError, UsageError
from piegraph_cli.evaluation.params import EvaluateParams
from piegraph_cli.params import Params
from piegraph_cli.planning.params import PlanParams, TrialParams, TrialsParams
from piegraph_cli.recording.layout import list_sequences
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.stages import STAGES, Stage
from piegraph_cli.workspace.artifact import atomic_file, read_artifact, read_header, read_key
from piegraph_cli.workspace.grid import (
    evaluate_params,
    evaluated_names,
    model_name,
    model_params,
    trained_name,
    trained_names,
    trial_names,
    trial_params,
)
from piegraph_cli.workspace.recipe import Recipe, load_recipe


@dataclass
class Run:
    """One run folder with the recipe in force. Keys are worked out once per object: make a new one after a change."""

    folder: Path
    recipe: Recipe
    _keys: dict[tuple[str, str | None], str | None] = field(default_factory=dict)

    @classmethod
    def open(cls, folder: Path, recipe: Recipe | None = None) -> "Run":
        """An existing run, or an empty one where there is none yet; with another recipe than the one it keeps."""
        path = folder / "recipe.toml"
        if folder.exists() and not folder.is_dir():
            raise UsageError("is a file", str(folder), "give --run a folder")
        if recipe is None:
            recipe = load_recipe(path) if path.exists() else Recipe()
        return cls(folder, recipe)

    def save_recipe(self) -> None:
        """Keep the recipe in force in the run folder."""
        path = self.folder / "recipe.toml"
        if not path.exists() or load_recipe(path) != self.recipe:
            self.recipe.save(path)

    def path(self, artifact: str, sequence: str | None) -> Path:
        """Where an artifact is."""
        return self.folder / artifact / f"{sequence}.h5" if sequence else self.folder / f"{artifact}.h5"

    def checkpoint(self, stage: Stage, unit: str | None) -> Path:
        """Where a long stage keeps its state until it is done."""
        return self.folder / "checkpoints" / f"{stage.name}.{unit}.h5"

    def lock(self, name: str) -> FileLock:
        """The lock that keeps two processes from making the same artifact."""
        folder = self.folder / ".locks"
        folder.mkdir(parents=True, exist_ok=True)
        return FileLock(folder / f"{name.replace('/', '.')}.lock")

    def producer(self, artifact: str) -> Stage:
        """The stage of this run's chain that writes an artifact."""
        return next(stage for stage in self.recipe.chain() if stage.writes == artifact)

    @cached_property
    def sequences(self) -> list[str]:
        """Names of the run's sequences, from its simulation or its recording; none in a run of trials alone."""
        first = self.recipe.chain()[0].name
        if first == "trials":
            return []
        if first == "simulate":
            params = self.recipe.params(STAGES["simulate"])
            assert isinstance(params, SimulateParams)
            return [f"sequence_{i:04d}" for i in range(params.sequences)]
        if not self.recording.exists() and (self.folder / "frames").is_dir():
            return sorted(path.stem for path in (self.folder / "frames").glob("*.h5"))
        return [folder.name for folder in list_sequences(self.recording)]

    @property
    def recording(self) -> Path:
        """The recording folder of this run."""
        params = self.recipe.params(STAGES["ingest"])
        assert isinstance(params, IngestParams)
        if params.recording is None:
            raise UsageError(
                "this run has no recording", str(self.folder), "piegraph ingest --recording FOLDER --run RUN"
            )
        return params.recording

    def units(self, stage: Stage) -> list[str | None]:
        """What a stage works through: the run's sequences, its models, its trials, or the run itself (None)."""
        params = self.recipe.params(stage)
        if isinstance(params, TrialsParams):
            return list(trial_names(params))
        if isinstance(params, TrainParams):
            return list(trained_names(params))
        if isinstance(params, EvaluateParams):
            return list(evaluated_names(params, self._train))
        return list(self.sequences) if stage.per == "sequence" else [None]

    @property
    def _train(self) -> TrainParams:
        params = self.recipe.params(STAGES["train"])
        assert isinstance(params, TrainParams)
        return params

    def params(self, stage: Stage, unit: str | None) -> Params:
        """The settings that one unit of a stage depends on: the stage's, or those of one model or trial alone."""
        params = self.recipe.params(stage)
        if unit is not None and isinstance(params, TrialsParams):
            return trial_params(params, unit, params.trained or self.folder.resolve().parent)
        if unit is not None and isinstance(params, TrainParams):
            return model_params(params, unit)
        if unit is not None and isinstance(params, EvaluateParams):
            return evaluate_params(params, unit)
        return params

    def inputs(self, stage: Stage, unit: str | None) -> list[tuple[str, str | None]]:
        """The (artifact, unit) files a stage reads; sequences that failed earlier are left out of what reads them all."""
        chain = {s.writes for s in self.recipe.chain()}
        names = [n for n in (*stage.reads, *stage.optional) if n in chain or n in stage.reads]
        files: list[tuple[str, str | None]] = []
        for name in names:
            producer = self.producer(name)
            if producer.per == "run":
                files.append((name, None))
            elif producer.per == "model":
                model = self._model_of(stage, unit)
                files += [(name, model)] if model else []
            elif stage.per == "sequence":
                files.append((name, unit))
            else:
                files += [(name, s) for s in self.sequences if not self.failure(producer, s)]
        return files

    def _model_of(self, stage: Stage, unit: str | None) -> str | None:
        """The trained model that a unit of `evaluate`, or `plan`, reads."""
        params = self.recipe.params(stage)
        if isinstance(params, PlanParams):
            return trained_name(model_name(params.model, self._train.seeds[0]))
        return trained_name(str(unit))

    def key(self, stage: Stage, sequence: str | None) -> str:
        """The key the stage's artifact has when it is fresh: a hash of the stage, its settings and its inputs' keys."""
        slot = (stage.name, sequence)
        if slot not in self._keys:
            params = self.params(stage, sequence)
            settings = params.model_dump(mode="json")
            gone = [path for path in params.files().values() if not path.exists()]
            if gone and (kept := self._kept_key(stage, sequence, settings)):
                self._keys[slot] = kept
                return kept
            for name, path in params.files().items():
                settings[name] = content_hash(path / sequence if path.is_dir() and sequence else path, name)
            if isinstance(params, TrialParams) and params.network:
                settings["network"] = read_key(params.network, "model")
            inputs = [[name, s, self.key(self.producer(name), s)] for name, s in self.inputs(stage, sequence)]
            unit = sequence if not stage.reads else None
            text = json.dumps([stage.name, stage.version, unit, settings, inputs], sort_keys=True)
            self._keys[slot] = hashlib.sha256(text.encode()).hexdigest()
        return self._keys[slot]  # type: ignore[return-value]

    def _kept_key(self, stage: Stage, sequence: str | None, settings: dict[str, Any]) -> str | None:
        """The key of an artifact whose source files are gone, if it was made with these settings: it stays usable."""
        header = read_header(self.path(stage.writes, sequence), stage.writes)
        return header.key if header and (header.version, header.params) == (stage.version, settings) else None

    def why_stale(self, stage: Stage, sequence: str | None) -> str:
        """What differs between a stale artifact and the one that would be made."""
        path = self.path(stage.writes, sequence)
        header = read_header(path, stage.writes)
        if header is None:
            try:
                read_artifact(path, stage.writes)
            except DataError as error:
                return error.message
            return "unreadable"
        if header.version != stage.version:
            return f"made by version {header.version} of the stage, this is version {stage.version}"
        settings = self.params(stage, sequence).model_dump(mode="json")
        now, then = (values | values.get("settings", {}) | {"settings": None} for values in (settings, header.params))
        changed = [name for name, value in now.items() if then.get(name) != value]
        return f"settings changed: {', '.join(changed)}" if changed else "what it was made from has changed"

    def state(self, stage: Stage, sequence: str | None) -> str:
        """`fresh`, `stale`, `missing` or `failed`."""
        stored = read_key(self.path(stage.writes, sequence), stage.writes)
        if stored is not None and stored == self.key(stage, sequence):
            return "fresh"
        if self.failure(stage, sequence):
            return "failed"
        return "stale" if self.path(stage.writes, sequence).exists() else "missing"

    def failure(self, stage: Stage, sequence: str | None) -> str | None:
        """Why this stage, or one before it, failed on a sequence with the settings in force; None where none did."""
        for earlier in self.recipe.chain():
            record = self.failures.get(f"{earlier.name}/{sequence}")
            if earlier.per == stage.per and record and record["key"] == self.key(earlier, sequence):
                return record["message"]
            if earlier == stage:
                break
        return None

    @cached_property
    def failures(self) -> dict[str, dict[str, Any]]:
        """Recorded failures by `stage/sequence`."""
        try:
            return json.loads((self.folder / "failures.json").read_text())
        except (OSError, ValueError):
            return {}

    def record_failures(self, stage: Stage, failed: dict[str | None, PiegraphError]) -> None:
        """Replace the failures recorded for a stage."""
        with self.lock("failures.json"):
            self.__dict__.pop("failures", None)
            kept = {place: record for place, record in self.failures.items() if not place.startswith(f"{stage.name}/")}
            for sequence, error in failed.items():
                record = {"key": self.key(stage, sequence), "message": str(error)}
                kept[f"{stage.name}/{sequence}"] = record
            if kept != self.failures:
                with atomic_file(self.folder / "failures.json") as temporary:
                    temporary.write_text(json.dumps(kept, indent=1))
            self.failures = kept


def content_hash(path: Path, setting: str) -> str:
    """sha256 of a file, or of a folder's file names and contents together with a cameras.json beside the folder."""
    digest = hashlib.sha256()
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        files += [p for p in [path.parent / "cameras.json"] if p.is_file()]
    elif path.is_file():
        files = [path]
    else:
        raise DataError("no such file or folder", str(path), f"correct the setting {setting}")
    for file in files:
        digest.update(file.relative_to(path.parent if path.is_dir() else file.parent).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
