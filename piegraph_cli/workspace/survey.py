"""What a run has and lacks: the state of every unit, counts per stage, and what a run of the recipe would make and why."""

import os
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from piegraph_cli.workspace.run import FROM_OTHERS, Run
from piegraph_cli.workspace.stage import Stage, Unit

UNCHECKED = "unchecked: written before artifacts had checksums"
STATES = ("fresh", "stale", "missing", "failed")


def status(run: Run) -> list[dict[str, Any]]:
    """One row per stage and unit: stage, unit, artifact, its bytes, state, quality, why it failed or is stale or unchecked."""
    rows = [_row(run, stage, unit) for stage in run.chain for unit in run.units(stage)]
    run.known.save()
    return rows


def _row(run: Run, stage: Stage, unit: Unit) -> dict[str, Any]:
    state, header, path = run.state(stage, unit), run.header(stage, unit), str(run.path(stage.writes, unit))
    try:
        size = os.stat(path).st_size
    except OSError:
        size = 0
    return {
        "stage": stage.name,
        "unit": unit,
        "artifact": path,
        "bytes": size,
        "state": state,
        "quality": header.quality if header and state == "fresh" else "",
        "failure": (run.failure(stage, unit) if state == "failed" else None) or "",
        "reason": _said_of(run, stage, unit, state),
    }


def _said_of(run: Run, stage: Stage, unit: Unit, state: str) -> str:
    """Why a stale artifact is stale, and what is to know of a fresh one."""
    header = run.header(stage, unit)
    if state == "fresh" and header and not header.checked:
        return UNCHECKED
    return run.why_stale(stage, unit) if state == "stale" else ""


def count_states(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per stage, how many units are in each state, and the bytes of its artifacts."""
    counts: dict[str, Counter] = {}
    for row in rows:
        of_stage = counts.setdefault(row["stage"], Counter())
        of_stage[row["state"]] += 1
        of_stage["bytes"] += row["bytes"]
    return [{"stage": name} | {what: found[what] for what in (*STATES, "bytes")} for name, found in counts.items()]


@dataclass
class _Foreseen(Run):
    """A run as it would be if all that is to be made were made, and nothing failed."""

    to_make: set[tuple[str, Unit]] = field(default_factory=set)

    def fresh(self, stage: Stage, unit: Unit) -> bool:
        return (stage.name, unit) in self.to_make or super().fresh(stage, unit)


def foresee(run: Run, until: str | None, force: bool) -> list[dict[str, Any]]:
    """What running the recipe would make, in order: stage, unit and reason. What failed before is tried again."""
    foreseen, made = _Foreseen(run.folder, run.recipe), []
    for stage in foreseen.chain:
        units = foreseen.units(stage)
        wanted = [u for u in units if force or not foreseen.fresh(stage, u)]
        # all states of a stage are worked out before any is assumed
        made += [{"stage": stage.name, "unit": u, "reason": _reason(run, foreseen, stage, u, force)} for u in wanted]
        foreseen.to_make |= {(stage.name, u) for u in wanted}
        if stage.name == until:
            break
    return made


def _reason(run: Run, foreseen: _Foreseen, stage: Stage, unit: Unit, force: bool) -> str:
    header = run.header(stage, unit)
    if header is None and not run.path(stage.writes, unit).exists():
        failure = run.failure(stage, unit)
        return f"failed before: {failure.splitlines()[0]}" if failure else "missing"
    if header is not None and header.key == foreseen.key(stage, unit):
        return "--force"
    why = foreseen.why_stale(stage, unit)
    again = [name for name, u in foreseen.files(stage, unit) if (foreseen.maker(name).name, u) in foreseen.to_make]
    if why == FROM_OTHERS and again:
        return f"{' and '.join(dict.fromkeys(again))} would be made again"
    return why if not force else f"--force, and {why}"
