"""What a run has for a report: what is fresh is read, what is not is named with the reason and the command that makes it."""

import logging
import shlex
from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from piegraph_cli.errors import DataError, PiegraphError
from piegraph_cli.stages import STAGES, sequences
from piegraph_cli.workspace.artifact import Artifact, Header, read_artifact
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.said import kept_warnings
from piegraph_cli.workspace.stage import Stage, Unit
from piegraph_cli.workspace.survey import status

log = logging.getLogger("piegraph")


@dataclass(frozen=True)
class Gap:
    """What is not in the report: units of a stage that share a reason."""

    stage: str
    state: str
    """`stale`, `missing`, `failed` or `damaged`."""
    units: list[str]
    why: str
    command: str


@dataclass
class Found:
    """A run, looked over once."""

    run: Run
    damaged: dict[tuple[str, Unit], Gap] = field(default_factory=dict)
    """By artifact and unit."""

    @cached_property
    def rows(self) -> dict[tuple[str, Unit], dict[str, Any]]:
        """State, quality and failure of each unit, by stage and unit."""
        return {(row["stage"], row["unit"]): row for row in status(self.run)}

    @cached_property
    def warnings(self) -> dict[tuple[str, Unit], list[str]]:
        """What was said of each unit when it was made."""
        return kept_warnings(self.run)

    @cached_property
    def sequences(self) -> list[str]:
        """By name; none in a run of trials alone."""
        return sequences(self.run)

    def has(self, stage: str) -> bool:
        """Whether the stage is part of this run."""
        return STAGES[stage] in self.run.chain

    def units(self, stage: str, *states: str) -> list[Unit]:
        """The units of a stage in one of these states, or all of them."""
        return [
            unit
            for (name, unit), row in self.rows.items()
            if name == stage and row["state"] in (states or row["state"])
        ]

    def fresh(self, stage: str, unit: Unit) -> bool:
        """Whether the unit's artifact is what would be made."""
        return self.rows.get((stage, unit), {}).get("state") == "fresh"

    def header(self, artifact: str, unit: Unit) -> Header | None:
        """What a fresh artifact says of itself."""
        stage = self.run.producer(artifact)
        return self.run.header(stage, unit) if stage and self.fresh(stage.name, unit) else None

    def read(self, artifact: str, unit: Unit, only: Collection[str] | None = None) -> Artifact | None:
        """A fresh artifact, or None; one that is damaged is noted."""
        if self.header(artifact, unit) is None or (artifact, unit) in self.damaged:
            return None
        try:
            return read_artifact(self.run.path(artifact, unit), artifact, only)
        except DataError as error:
            stage = self.run.maker(artifact)
            log.warning("left out of the report: %s", error)
            again = f"piegraph {stage.name} {self.option} --force"
            self.damaged[artifact, unit] = Gap(stage.name, "damaged", [unit or "-"], str(error), again)
            return None

    def command(self, stage: Stage, unit: Unit) -> str:
        """What makes a unit."""
        if stage.command:
            return stage.command(self.run, unit)
        named = STAGES[stage.name].on_demand and not self.has(stage.name)
        return f"piegraph {stage.name} {self.option}" if named else f"piegraph run {self.option} --until {stage.name}"

    @cached_property
    def option(self) -> str:
        """`--run FOLDER`, as a shell takes it."""
        return f"--run {shlex.quote(str(self.run.folder))}"

    def gaps(self) -> list[Gap]:
        """What is not fresh, equal reasons together, and what could not be read. A failure is named where it began."""
        found: dict[tuple[str, str, str, str], list[str]] = {}
        failed: set[tuple[Unit, str]] = set()
        for (name, unit), row in self.rows.items():
            if row["state"] == "fresh" or (name == "plan" and self.plan[0] is not None):
                continue
            why = row["failure"] or row["reason"] or "not made yet"
            if row["state"] == "failed":
                if (unit, why) in failed:
                    continue
                failed.add((unit, why))
            slot = (name, row["state"], why, self.command(STAGES[name], unit))
            found.setdefault(slot, []).append(unit or "-")
        return [Gap(name, state, units, why, how) for (name, state, why, how), units in found.items()] + [
            *self.damaged.values()
        ]

    @cached_property
    def plan(self) -> tuple[Artifact | None, str]:
        """The plan, if it was made with the model that the run has now; else None and why.

        A plan answers a question of its own, so the recipe's settings of planning do not make it stale.
        """
        path, stage = self.run.path("plan", None), STAGES["plan"]
        if not path.exists():
            return None, "not made yet"
        try:
            header = self.run.header(stage, None)
            if header is None or header.version != stage.version:
                return None, "made by another version of the stage"
            plan = read_artifact(path, "plan")
            for place, key in plan.inputs.items():
                artifact, _, unit = place.partition("/")
                if self.run.key(self.run.maker(artifact), unit or None) != key:
                    return None, "the model has changed since"
        except (PiegraphError, KeyError) as error:
            return None, str(error)
        return plan, ""
