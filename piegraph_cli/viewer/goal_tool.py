"""Goals by hand: drag and turn the object's particles, or bend them, keep them as a goal, and ask for the strokes."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from piegraph_cli.errors import command_line
from piegraph_cli.params import mode_word
from piegraph_cli.recording.ground import level, moved
from piegraph_cli.recording.points import write_points
from piegraph_cli.stages import open_run
from piegraph_cli.viewer.desk import Desk
from piegraph_cli.viewer.goal_shape import GoalShape
from piegraph_cli.viewer.tool import Tool
from piegraph_cli.viewer.viewer import Viewer
from piegraph_cli.workspace.slices import Slices

if TYPE_CHECKING:
    from piegraph_cli.planning.question import Answer

ROOT = "/goal_by_hand"
GOAL, START, STROKE, PREDICTED = (214, 39, 40), (120, 120, 120), (255, 140, 0), (44, 160, 44)
FREE, HELD = (30, 110, 230), (150, 40, 190)
MOVE, BEND = "move and turn", "bend"
"""What dragging does."""


class GoalTool(Tool):
    """The particles of the frame that is shown, at a place where they shall be."""

    name: ClassVar[str] = "goal"
    needs: ClassVar[tuple[str, ...]] = ("tracks",)

    def __init__(self, viewer: Viewer, desk: Desk):
        super().__init__(viewer, desk)
        self.how = self.gui.add_dropdown("drag to", (MOVE, BEND))
        self.count = self.gui.add_slider("points to hold", min=2, max=12, step=1, initial_value=5, visible=False)
        self.again = self.gui.add_button("from this frame anew")
        self.file = self.gui.add_text("file", "")
        self.keep = self.gui.add_button("save the goal")
        self.ask = self.gui.add_button("plan")
        self.told = self.gui.add_markdown("")
        self.shape: GoalShape | None = None
        self.frame = 0
        self.balls: dict[int, Any] = {}
        self.how.on_update(lambda _: viewer.post(self._handles))
        self.count.on_update(lambda _: viewer.post(self._handles))
        self.again.on_click(lambda _: viewer.post(self.take))
        self.keep.on_click(lambda _: viewer.post(self._keep))
        self.ask.on_click(lambda _: viewer.post(self._plan))

    def take(self) -> None:
        """Begin with the particles where they are."""
        sequence, frame = self.viewer.sequence, self.viewer.frame
        self.lay_down()
        self.shape = GoalShape(self._tracks().row("positions", frame))
        self.file.value = str(self.viewer.opened.folder / "goals" / f"{sequence.name}.npz")
        self.frame = frame
        self.told.content = (
            f"From frame {frame}: grey as it is, red as it shall be; green as it is expected after the strokes."
        )
        scene = self.viewer.server.scene
        scene.add_point_cloud(f"{ROOT}/start", self.shape.start, START, point_size=0.004, precision="float32")
        self.cloud = scene.add_point_cloud(
            f"{ROOT}/goal", self.shape.points, GOAL, point_size=0.006, precision="float32"
        )
        self._handles()

    def _tracks(self) -> Slices:
        tracks = self.viewer.sequence.get("tracks")
        assert tracks is not None
        return tracks

    def lay_down(self) -> None:
        """Take goal, handles and strokes away."""
        self.viewer.server.scene.remove_by_name(ROOT)
        self.shape = None

    def _handles(self) -> None:
        """What one drags by: a gizmo in the middle, or points of the object."""
        if self.shape is None:
            return
        scene = self.viewer.server.scene
        scene.remove_by_name(f"{ROOT}/by")
        self.count.visible = self.how.value == BEND
        self.balls = {}
        if self.how.value == MOVE:
            self._add_gizmo()
            return
        for particle in self.shape.controls(int(self.count.value)):
            ball = scene.add_icosphere(f"{ROOT}/by/{particle}", 0.007, FREE, position=self.shape.points[particle])
            self.balls[int(particle)] = ball
            ball.on_drag(self._dragging(int(particle)))

    def _add_gizmo(self) -> None:
        assert self.shape is not None
        points, middle = self.shape.points.copy(), self.shape.points.mean(0)
        gizmo = self.viewer.server.scene.add_transform_controls(
            f"{ROOT}/by/gizmo", 0.12, active_axes=(True, True, False), depth_test=False, position=middle
        )

        def turn_and_move() -> None:
            if self.shape is not None:
                w, _, _, z = gizmo.wxyz
                x, y = gizmo.position[:2] - middle[:2]
                self.shape.move(points, middle[:2], float(x), float(y), 2 * float(np.arctan2(z, w)))
                self._changed()

        gizmo.on_update(lambda _: self.viewer.post(turn_and_move))

    def _dragging(self, particle: int):
        async def dragged(event) -> None:  # in order, unlike callbacks on threads
            eye = np.asarray(event.client.camera.position)
            along = np.asarray(event.end_position) - eye
            self.viewer.post(lambda: self._drag(particle, eye, along))

        return dragged

    def _drag(self, particle: int, eye: np.ndarray, along: np.ndarray) -> None:
        """Bring a particle to where a ray meets the table at its height."""
        if self.shape is None or particle not in self.balls or along[2] > -1e-3 * np.linalg.norm(along):
            return
        ahead = (float(self.shape.points[particle, 2]) - eye[2]) / along[2]
        if ahead > 0:
            self.shape.drag(particle, (eye + ahead * along)[:2])
            self._changed()

    def _changed(self) -> None:
        assert self.shape is not None
        self.cloud.points = self.shape.points
        for particle, ball in self.balls.items():
            ball.position = self.shape.points[particle]
            ball.color = HELD if particle in self.shape.held else FREE
        self.viewer.server.scene.remove_by_name(f"{ROOT}/plan")

    def _doubt(self) -> list[str]:
        assert self.shape is not None
        seen = self._tracks()["positions"]
        return [doubt] if (doubt := self.shape.doubt(seen)) else []

    def _keep(self) -> None:
        """Write the goal as `plan --goal` takes it: in the cameras' world."""
        if self.shape is None:
            return
        run, path = open_run(self.viewer.opened.folder), Path(self.file.value)
        T_world_table = np.linalg.inv(level(run.params("ingest").table))
        write_points(path, moved(self.shape.points, T_world_table))
        at = self._tracks().path
        command = command_line("plan", "--run", run.folder, "--state", f"{at}:{self.frame}", "--goal", path)
        self.told.content = "\n\n".join([f"saved as {path}", f"`{command}`", *self._doubt()])

    def _plan(self) -> None:
        """Ask for the strokes to the goal, with the settings of the run, and draw them."""
        if self.shape is None:
            return
        start, goal, rest = self.shape.start, self.shape.points.copy(), self._tracks().row("positions", 0)
        self.told.content = "planning …"
        self.look_up(lambda: self._answer(start, goal, rest), self._tell_plan, self.told)

    def _tell_plan(self, answer: "Answer") -> None:
        self._draw_plan(answer)
        rows = [
            f"stroke {k}: {mode_word(int(mode))} from ({a[0]:+.3f}, {a[1]:+.3f}) to ({b[0]:+.3f}, {b[1]:+.3f}) m"
            for k, (mode, (a, b)) in enumerate(self._strokes(answer), 1)
        ]
        if not rows:
            rows = [f"no stroke: {100 * answer.start_distance:.1f} cm from the goal already"]
        else:
            rows.append(
                f"{100 * answer.start_distance:.1f} cm from the goal now, {100 * answer.steps[-1].plan.cost:.1f} cm expected"
            )
        self.told.content = "\n\n".join([*rows, *answer.warnings, *self._doubt()])

    @staticmethod
    def _strokes(answer: "Answer") -> list:
        strokes = answer.strokes
        return [] if strokes is None else list(zip(strokes.mode.tolist(), strokes.ends.tolist(), strict=True))

    def _answer(self, start: np.ndarray, goal: np.ndarray, rest: np.ndarray) -> "Answer":
        """The plan for tracked particles, whose goal is known one by one; all [N, 3] (m) in the run's world."""
        from piegraph_cli.stages.models import load_model

        run = open_run(self.viewer.opened.folder)
        model = load_model(run.folder, run.params("plan").model)
        return model.plan(start, goal=goal, rest=rest, corresponds=True, table=(0.0, 0.0, 0.0))

    def _draw_plan(self, answer: "Answer") -> None:
        scene = self.viewer.server.scene
        scene.remove_by_name(f"{ROOT}/plan")
        strokes = self._strokes(answer)
        if not strokes:
            return
        height = float(self.shape.start[:, 2].max()) + 0.01 if self.shape is not None else 0.03
        arrows = np.array([[[*a, height], [*b, height]] for _, (a, b) in strokes], np.float32)
        scene.add_arrows(
            f"{ROOT}/plan/strokes", arrows, STROKE, shaft_radius=0.003, head_radius=0.008, head_length=0.018
        )
        for k, (start, _) in enumerate(arrows, 1):
            scene.add_label(f"{ROOT}/plan/{k}", str(k), position=start)
        scene.add_point_cloud(
            f"{ROOT}/plan/predicted", answer.predicted[-1], PREDICTED, point_size=0.005, precision="float32"
        )
