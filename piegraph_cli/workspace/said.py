"""What stages said of the artifacts they made: their warnings, kept in RUN/warnings.json beside the key they are about."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from piegraph_cli.files import atomic_file
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.stage import Stage, Unit

NAME = "warnings.json"


def keep_warnings(run: Run, stage: Stage, said: Mapping[Unit, Sequence[str]]) -> None:
    """Replace what is kept of units that were made by what was said now; nothing is written where nothing changes.

    Raises `DataError` where it cannot be written.
    """
    if not any(said.values()) and not (run.folder / NAME).exists():
        return
    with run.lock(NAME):
        before = _read(run)
        kept = {place: record for place, record in before.items() if place not in {f"{stage.name}/{u}" for u in said}}
        for unit, warnings in said.items():
            if warnings:
                kept[f"{stage.name}/{unit}"] = {"key": run.key(stage, unit), "warnings": list(warnings)}
        if kept != before:
            with atomic_file(run.folder / NAME) as temporary:
                temporary.write_text(json.dumps(kept, indent=1))


def kept_warnings(run: Run) -> dict[tuple[str, Unit], list[str]]:
    """By stage and unit, what was said when the artifact that is there was made."""
    found: dict[tuple[str, Unit], list[str]] = {}
    for place, record in _read(run).items():
        name, _, of = place.partition("/")
        stage, unit = run.recipe.table.get(name), None if of == "None" else of
        header = run.header(stage, unit) if stage else None
        if header is not None and header.key == record.get("key"):
            found[name, unit] = [str(text) for text in record.get("warnings", [])]
    return found


def _read(run: Run) -> dict[str, dict[str, Any]]:
    try:
        records = json.loads((run.folder / NAME).read_text())
        return {place: record for place, record in records.items() if isinstance(record, dict)}
    except (OSError, ValueError, AttributeError):
        return {}
