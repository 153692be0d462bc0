"""The tab of the run: each stage of its recipe, how good what it made is, and the command for what is not made yet."""

from collections import Counter
from typing import ClassVar

from piegraph_cli.errors import PiegraphError
from piegraph_cli.stages import open_run
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.source import OpenRun
from piegraph_cli.viewer.viewer import Viewer
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.stage import Stage, Unit

FEW = 4
"""Units of a stage that are told one by one; of more the states are counted."""


def stage_lines(opened: OpenRun, sequence: str) -> list[str]:
    """A line of Markdown per stage: of one sequence where a stage's units are sequences, else of all units."""
    run = open_run(opened.folder)
    lines = []
    for stage in run.chain:
        try:
            units = [u for u in run.units(stage) if stage.unit != "sequence" or u == sequence]
            rows = [_row(run, stage, unit) for unit in units]
        except PiegraphError as error:
            lines.append(f"**{stage.name}**: {error.message}")
            continue
        if len(rows) > FEW:
            counts = Counter(state for state, _ in rows)
            lines.append(f"**{stage.name}**: " + ", ".join(f"{count} {state}" for state, count in counts.items()))
        else:
            lines += [f"**{stage.name}** {state}{': ' + text if text else ''}" for state, text in rows]
        if any(state != "fresh" for state, _ in rows) or not rows:
            lines.append(f"`{opened.command(stage.writes)}`")
    return lines


def _row(run: Run, stage: Stage, unit: Unit) -> tuple[str, str]:
    """State, and what there is to say of it."""
    state, header = run.state(stage, unit), run.header(stage, unit)
    name = f"{unit}: " if unit and stage.unit != "sequence" else ""
    if state == "failed":
        return state, name + (run.failure(stage, unit) or "").split("\n")[0]
    if state == "stale":
        return state, name + run.why_stale(stage, unit)
    return state, name + (header.quality if header else "") if state == "fresh" else name.removesuffix(": ")


class RunPanel(Panel):
    """What is fresh, stale, missing or failed; worked out behind, since keys are made of all that was recorded."""

    title: ClassVar[str] = "Run"

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        self.note = viewer.server.gui.add_markdown("")
        viewer.on_sequence(self._sequence_changed)

    def _sequence_changed(self) -> None:
        opened, name = self.viewer.opened, self.viewer.sequence.name
        head = [f"`{opened.folder}`"]
        if opened.trouble:
            self.note.content = "\n\n".join([*head, opened.trouble, f"`{opened.remedy}`"])
            return
        self.note.content = "\n\n".join([*head, "looking ..."])

        def show(lines: list[str]) -> None:
            self.note.content = "\n\n".join([*head, *lines])

        self.viewer.behind(lambda: stage_lines(opened, name), show)
