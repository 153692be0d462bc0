"""Prompts by hand: click the object in the first images, see the mask that `segment` would make, keep the prompt."""

from collections.abc import Collection
from typing import ClassVar

import numpy as np

from piegraph_cli.errors import command_line
from piegraph_cli.evaluation.overlays import draw_mask, label
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.stages import STAGES, open_run, segment
from piegraph_cli.viewer.desk import Desk
from piegraph_cli.viewer.lazy import lazily
from piegraph_cli.viewer.tool import Tool
from piegraph_cli.viewer.viewer import Viewer
from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.recipe import change_recipe
from piegraph_cli.workspace.run import Run

MARK = (255, 255, 0)
POINT, BOX = "a point on it", "two corners of a box"
ONE, ALL = "this sequence", "all sequences"

Slot = tuple[str, str | None]


class PromptTool(Tool):
    """Where the object is in the first frame: a point or a box in each camera, for one sequence or for all."""

    name: ClassVar[str] = "prompt"
    needs: ClassVar[tuple[str, ...]] = ("frames", "hands")

    def __init__(self, viewer: Viewer, desk: Desk):
        super().__init__(viewer, desk)
        self.kind = self.gui.add_dropdown("click", (POINT, BOX))
        self.whom = self.gui.add_dropdown("for", (ONE, ALL))
        self.forget = self.gui.add_button("without a prompt")
        self.keep = self.gui.add_button("save into the recipe")
        self.told = self.gui.add_markdown("")
        self.points: dict[str, tuple[float, float]] = {}
        self.boxes: dict[str, tuple[float, float, float, float]] = {}
        self.corner: tuple[int, tuple[float, float]] | None = None
        self.forget.on_click(lambda _: viewer.post(self._forget))
        self.keep.on_click(lambda _: viewer.post(self._keep))

    def take(self) -> None:
        """Begin with the prompts that the recipe has for this sequence."""
        params = self._run().params(segment.STAGE.name).of(self.viewer.sequence.name)
        self.points, self.boxes, self.corner = dict(params.points), dict(params.prompts), None
        self.desk.open(self._clicked)
        self._see()

    def lay_down(self) -> None:
        """Leave the images."""
        self.desk.close()

    def _run(self) -> Run:
        return open_run(self.viewer.opened.folder)

    def _clicked(self, camera: int, pixel: tuple[float, float]) -> None:
        name = self.viewer.sequence.cameras[camera].name
        if self.kind.value == POINT:
            self.points[name] = pixel
            self.boxes.pop(name, None)
        elif self.corner is None or self.corner[0] != camera:
            self.corner = camera, pixel
            self.told.content = f"first corner in {name}: click the opposite one"
            self._show(0, None)
            return
        else:
            (x0, y0), (x1, y1) = self.corner[1], pixel
            self.boxes[name] = min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)
            self.points.pop(name, None)
        self.corner = None
        self._see()

    def _forget(self) -> None:
        self.points, self.boxes, self.corner = {}, {}, None
        self._see()

    def _see(self) -> None:
        """Show the masks that `segment` would make of these prompts, or why it would make none."""
        self._show(0, None)
        self.told.content = "looking …"
        params: SegmentParams = self._run().params(segment.STAGE.name)
        params = params.of(self.viewer.sequence.name).model_copy(update={"points": self.points, "prompts": self.boxes})
        self.look_up(lambda: segment.foresee_masks(*self._artifacts(), params), self._tell_masks, self.told)

    def _tell_masks(self, found: tuple[int, list[np.ndarray], list[str]]) -> None:
        frame, masks, warnings = found
        self._show(frame, masks)
        pixels = ", ".join(
            f"{camera.name} {int(mask.sum())} px"
            for camera, mask in zip(self.viewer.sequence.cameras, masks, strict=True)
        )
        given = f"{len(self.points)} points, {len(self.boxes)} boxes" if self.points or self.boxes else "no prompt"
        self.told.content = "\n\n".join([f"{given}; the mask in frame {frame}: {pixels}", *warnings])

    def _artifacts(self) -> tuple[Artifact, Artifact]:
        """Frames and hands of the sequence; hands that are fresh were made of frames that are."""
        frames = self.viewer.sequence.get("frames")
        assert frames is not None
        return lazily(frames), self._run().read("hands", self.viewer.sequence.name)

    def _show(self, frame: int, masks: list[np.ndarray] | None) -> None:
        import cv2

        images = self.pictures(frame)
        for c, camera in enumerate(self.viewer.sequence.cameras):
            if masks is not None:
                images[c] = draw_mask(images[c], masks[c])
            if camera.name in self.points:
                cv2.drawMarker(images[c], _at(self.points[camera.name]), MARK, cv2.MARKER_CROSS, 16, 2)
            if camera.name in self.boxes:
                box = self.boxes[camera.name]
                cv2.rectangle(images[c], _at(box[:2]), _at(box[2:]), MARK, 1)
            if self.corner is not None and self.corner[0] == c:
                cv2.drawMarker(images[c], _at(self.corner[1]), MARK, cv2.MARKER_TILTED_CROSS, 12, 1)
            label(images[c], f"{camera.name}, frame {frame}")
        self.desk.show(images)

    def _keep(self) -> None:
        """Write the prompts into the run's recipe, and say what is stale by that."""
        run = self._run()
        before = _stale(run)
        with run.lock("recipe.toml"):
            run = self._run()  # what another process changed meanwhile stays
            old: SegmentParams = run.params(segment.STAGE.name)
            whom = self.viewer.sequence.name if self.whom.value == ONE else ""
            new = old.prompted(whom, self.boxes, self.points)
            values = {
                name: getattr(new, name) for name in ("prompts", "points") if getattr(new, name) != getattr(old, name)
            }
            path = run.folder / "recipe.toml"
            change_recipe(path, STAGES, segment.STAGE, values)
        run = self._run()
        self.told.content = f"saved in {path}. {told_stale(_stale(run) - before, run)}"
        self.viewer.tell("Prompt saved", str(path), "green")


def _at(pixel) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _stale(run: Run) -> set[Slot]:
    """The stages and units of a run that were made and are stale."""
    return {(stage.name, u) for stage in run.chain for u in run.units(stage) if run.state(stage, u) == "stale"}


def told_stale(slots: Collection[Slot], run: Run) -> str:
    """What became stale, in a line, with the command that makes it again."""
    if not slots:
        return "Nothing that was made is stale by it."
    units: dict[str, list[str]] = {}
    for stage in run.chain:
        if found := sorted(unit or "" for name, unit in slots if name == stage.name):
            units[stage.name] = found
    said = [name if found == [""] else f"{name} ({', '.join(found)})" for name, found in units.items()]
    return f"Stale now: {', '.join(said)}. Make it again: `{command_line('run', '--run', run.folder)}`"
