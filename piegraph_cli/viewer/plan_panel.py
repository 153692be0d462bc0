"""The tab of plans: which stroke of which plan is looked at, and what was searched for it."""

from typing import ClassVar

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.colors import GOAL, OBJECT, PREDICTED
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.model_panel import swatch
from piegraph_cli.viewer.plan_layer import BEFORE, ELITE, PlanLayer, Shown
from piegraph_cli.viewer.viewer import Viewer
from piegraph_cli.workspace.slices import Slices


def hexed(color: tuple[int, int, int]) -> str:
    """`#rrggbb` of three numbers in 0-255."""
    return "#" + "".join(f"{part:02x}" for part in color)


LEGEND = {
    "goal": GOAL,
    "before": hexed(BEFORE),
    "predicted": PREDICTED,
    "after": OBJECT,
    "stroke": "#141414",
    "elites": hexed(ELITE),
    "candidates, dark where cheap": "#2846a0",
}


class PlanPanel(Panel):
    """Episode, stroke and iteration of the search; the recording is hidden meanwhile, unless asked for."""

    title: ClassVar[str] = "Plan"

    def __init__(self, viewer: Viewer):
        super().__init__(viewer)
        gui = viewer.server.gui
        self.layer = viewer.layer(PlanLayer)
        self.note = gui.add_markdown("")
        self.show = gui.add_checkbox("show the plan", False)
        self.recording = gui.add_checkbox("and the recording", False)
        self.episode = gui.add_slider("plan", 1, 2, 1, 1)
        self.step = gui.add_slider("stroke", 1, 2, 1, 1)
        self.candidates = gui.add_checkbox("candidates", True)
        self.iteration = gui.add_slider("iteration", 1, 2, 1, 1, hint="of the search, where it looks at candidates")
        colors = "".join(f"<div>{swatch(color)}{name}</div>" for name, color in LEGEND.items())
        self.legend = gui.add_html(f'<div style="padding:0 0.8em;font-size:0.85em">{colors}</div>')
        for element in (self.show, self.recording):
            element.on_update(lambda _: viewer.post(self._shown))
        for element in (self.step, self.candidates, self.iteration):
            element.on_update(lambda _: viewer.post(self._looked))
        self.episode.on_update(lambda _: viewer.post(self._episode_chosen))
        viewer.on_sequence(self._run_changed)

    def _run_changed(self) -> None:
        """Open the plan of the run, if it is another one than is open."""
        opened, plan = self.viewer.opened, self.layer.plan
        path = opened.run.path("plan", None)
        if plan is not None and plan.path == path and not plan.changed():
            return
        if plan is not None:
            plan.close()
        self.layer.plan, self.note.content = None, opened.absent("plan")
        if path.exists():
            try:
                self.layer.plan, self.note.content = Slices(path, "plan"), ""
            except DataError as error:
                self.note.content = f"the plan cannot be shown: {error}"
        elements = (self.show, self.recording, self.episode, self.step, self.candidates, self.iteration, self.legend)
        for element in elements:
            element.visible = self.layer.plan is not None
        if self.layer.plan is None:
            self.show.value = False
            self._shown()
            return
        episodes = self.layer.plan.lengths["episode"]
        self.episode.max, self.episode.visible = max(2, episodes), episodes > 1
        self.episode.value = 1
        self._episode_chosen()

    def _episode_chosen(self) -> None:
        """Go to the first stroke of a plan."""
        steps = self._steps()
        self.step.max, self.step.visible, self.step.value = max(2, len(steps)), len(steps) > 1, 1
        plan = self.layer.plan
        assert plan is not None
        self.iteration.max = max(2, plan.lengths["iteration"])
        self.iteration.value = 1
        self._looked()
        self._shown()

    def _steps(self) -> np.ndarray:
        plan = self.layer.plan
        assert plan is not None
        return np.flatnonzero(plan["episode"] == int(self.episode.value) - 1)

    def _looked(self) -> None:
        """Look at another stroke or iteration."""
        plan, steps = self.layer.plan, self._steps()
        if plan is None or not len(steps):
            return
        step = int(steps[min(int(self.step.value), len(steps)) - 1])
        iteration = min(int(self.iteration.value), plan.lengths["iteration"]) - 1
        self.layer.looked = Shown(step, iteration, bool(self.candidates.value))
        self.note.content = plan_text(plan, step)
        self.viewer.draw_again(self.layer)

    def _shown(self) -> None:
        """Follow the boxes; the view goes to what is shown."""
        viewer, on = self.viewer, bool(self.show.value) and self.layer.plan is not None
        was = self.layer in viewer.on
        viewer.switch(self.layer, on)
        viewer.leave_alone(self.layer if on and not self.recording.value else None)
        if on:
            plan, step = self.layer.plan, self.layer.looked.step
            assert plan is not None
            goal = plan.row("goal", int(plan["episode"][step]))
            viewer.look_at(np.concatenate([goal, plan.row("before", step)]))
        elif was:
            viewer.look_at_object()


def plan_text(plan: Slices, step: int) -> str:
    """What is to be said of one stroke of a plan."""
    episode = int(plan["episode"][step])
    start, end = plan["start_distance"][episode] * 100, plan["end_distance"][episode] * 100
    text = f"{start:.1f} cm from the goal at the start, "
    text += f"{end:.1f} cm at the end" if np.isfinite(end) else "not executed"
    text += f" ({plan.texts('metric')[episode]}). "
    kind = "pick" if plan["mode"][step] else "push"
    found = plan["distance"][step] * 100
    text += f"This {kind}: {plan['cost'][step] * 100:.1f} cm predicted"
    return text + (f", {found:.1f} cm after it." if np.isfinite(found) else ".")
