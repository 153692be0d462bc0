"""Pieces of experiments: the figures of one model from one seed, or of its trials, in a small text file that can be kept.

A folder of pieces looks like the folder of runs that they are from: `tblock/pgnd@10.seed0.json` has what a model predicts
of every held-out sequence, `planning/tblock/pgnd@10.json` every trial. Tables are made of pieces alone.
"""

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from piegraph_cli.errors import DataError, PiegraphError
from piegraph_cli.evaluation.tables import as_json
from piegraph_cli.evaluation.trials import Trial
from piegraph_cli.files import atomic_file

METRICS = ("pd", "cd", "s", "pd_truth")


class _Kept(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Made(_Kept):
    """When, by what and where the figures were made."""

    date: str = ""
    software: str = ""
    machine: str = ""
    wall_s: float | None = None
    cpu_s: float | None = None


class Training(_Kept):
    """What one training took and came to."""

    steps: int
    parameters: int
    loss: float | None
    """The best on validation sequences, or the last one where there are none."""
    static_loss: float | None = None
    """The same if nothing moves."""
    made: Made = Made()


class Piece(_Kept):
    """What is kept of one model from one seed, or of all trials of one model in one environment."""

    kind: Literal["model", "trials"]
    place: str
    """Folder of the run, below that of all runs."""
    environment: str
    model: str
    seed: int | None
    command: str
    made: Made
    versions: dict[str, int]
    """Of the stages that the figures are from."""
    keys: dict[str, str]
    """Of the artifacts that the figures are from."""
    settings: dict[str, dict[str, Any]]
    """By stage, as far as they do not name files."""
    training: Training | None = None
    windows: dict[int, int] = Field(default_factory=dict)
    """By horizon."""
    failed: str | None = None
    columns: list[str] = Field(default_factory=list)
    rows: list[list[Any]] = Field(default_factory=list)

    @property
    def name(self) -> str:
        """Its file below the folder of pieces; without colons, which some file systems do not have."""
        name = f"{self.place}/{self.model}{'' if self.seed is None else f'.seed{self.seed}'}.json"
        return name.replace(":", "_")

    @property
    def trouble(self) -> str | None:
        """Why its figures count for nothing, if so: it failed, or did not learn."""
        if self.failed:
            return f"failed: {self.failed.splitlines()[0]}"
        of = self.training
        if of is None or of.static_loss is None or (of.loss is not None and of.loss < of.static_loss):
            return None
        loss = "nothing" if of.loss is None else f"{of.loss:.4g}"
        return f"did not learn: its loss, {loss}, is not below {of.static_loss:.4g}, that of nothing moving"

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Means of the metrics over the windows of each sequence, a row for every sequence and horizon."""
        columns: dict[str, list[Any]] = {name: [] for name in ("horizon", "sequence", *METRICS)}
        place = {name: k for k, name in enumerate(self.columns)}
        for horizon in self.windows:
            for row in self.rows:
                columns["horizon"].append(horizon)
                columns["sequence"].append(str(row[0]).encode())
                for metric in METRICS:
                    at = place.get(f"{metric} {horizon}")
                    columns[metric].append(math.nan if at is None or row[at] is None else float(row[at]))
        return {name: np.array(values) for name, values in columns.items()}

    @property
    def trials(self) -> list[Trial]:
        """Each trial."""
        return [
            Trial(self.environment, self.model, goal, seed, np.array(pd), np.array(cd), np.array(seconds))
            for goal, seed, pd, cd, seconds in self.rows
        ]

    def text(self) -> str:
        """As it is kept: JSON, a line for each sequence or trial."""
        whole = json.loads(as_json(self.model_dump()))
        rows = whole.pop("rows")
        head = [f" {json.dumps(name)}: {json.dumps(value)}" for name, value in whole.items()]
        lines = ",\n".join(f"  {json.dumps(row, separators=(',', ':'))}" for row in rows)
        return ",\n".join(["{\n" + head[0], *head[1:], ' "rows": [' + (f"\n{lines}\n ]" if rows else "]")]) + "\n}\n"


def rounded(values: Any, digits: int = 6) -> Any:
    """Numbers with so many significant digits, in lists as they were."""
    if isinstance(values, (list, tuple, np.ndarray)):
        return [rounded(value, digits) for value in values]
    return float(f"{float(values):.{digits}g}")


def read_piece(path: Path) -> Piece:
    """A piece. Raises `DataError` for a file that is none."""
    try:
        piece = Piece.model_validate_json(path.read_text(encoding="utf-8"))
        wrong = [row for row in piece.rows if len(row) != len(piece.columns)]
        problem = f"a row of {len(wrong[0])} in place of {len(piece.columns)} values" if wrong else ""
    except ValidationError as error:
        first = error.errors()[0]
        problem = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    except (OSError, ValueError, RecursionError) as error:
        problem = str(error)
    if problem:
        raise DataError(f"is no piece of an experiment: {problem}", str(path), "remove it, and make it again")
    return piece


def read_pieces(folder: Path) -> list[Piece]:
    """All pieces of a folder. Raises `DataError` for one that does not lie where it belongs."""
    pieces = []
    for path in sorted(folder.rglob("[!.]*.json")):
        piece = read_piece(path)
        if folder / piece.name != path:
            raise DataError(f"belongs to {piece.name}", str(path), "give it its name again")
        pieces.append(piece)
    return pieces


def keep_pieces(pieces: Iterable[Piece], folder: Path) -> list[PiegraphError]:
    """Write pieces; one of artifacts that its file is of already stays as it is. Returns what could not be written."""
    errors: list[PiegraphError] = []
    for piece in pieces:
        path = folder / piece.name
        try:
            if not (path.is_file() and _same(read_piece(path), piece)):
                with atomic_file(path) as temporary:
                    temporary.write_text(piece.text(), encoding="utf-8")
        except DataError as error:
            errors.append(error)
    return errors


def _same(kept: Piece, now: Piece) -> bool:
    return (kept.keys, kept.failed, kept.settings) == (now.keys, now.failed, now.settings)


def check_comparable(pieces: Sequence[Piece]) -> None:
    """Raises `DataError` that names both where two pieces of one table are not made alike.

    Stages must be of one version and the dataset the same one; trials must be of one kind.
    """
    seen: dict[tuple[str, str], tuple[Any, Piece]] = {}
    for piece in pieces:
        marks: dict[str, Any] = {f"version of {stage}": version for stage, version in piece.versions.items()}
        if "dataset" in piece.keys:
            marks["dataset"] = piece.keys["dataset"][:12]
        alike = ("trials", "plan") if piece.kind == "trials" else ("evaluate",)
        for stage in alike:
            marks |= {f"{stage}.{k}": v for k, v in piece.settings.get(stage, {}).items() if k not in OWN}
        for what, mark in marks.items():
            first, other = seen.setdefault((piece.environment, what), (mark, piece))
            if first != mark:
                raise DataError(
                    f"cannot stand beside {other.name}: {what} is {mark}, there {first}",
                    piece.name,
                    "remove the older one, and make it again",
                )


OWN = {"label", "model", "planner", "network"}
"""Settings of a stage that are of one model alone."""


def changed(piece: Piece, now: dict[str, dict[str, Any]]) -> str | None:
    """In which setting a piece differs from those in force, if it does."""
    for stage, settings in now.items():
        for name, value in settings.items():
            then = piece.settings.get(stage, {}).get(name)
            if then != value:
                return f"made with other settings than those in force: {stage}.{name} was {then}, is {value}"
    return None
