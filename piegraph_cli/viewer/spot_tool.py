"""Truth by hand: click the same spot of the object in a few frames, and see how far the tracked particles are off."""

from collections.abc import Callable
from typing import ClassVar

from piegraph_cli.errors import DataError, command_line
from piegraph_cli.evaluation.overlays import label
from piegraph_cli.recording.clicks import Click, read_clicks, write_clicks
from piegraph_cli.stages import open_run, score
from piegraph_cli.viewer.desk import Desk
from piegraph_cli.viewer.lazy import lazily
from piegraph_cli.viewer.tool import Tool
from piegraph_cli.viewer.viewer import Viewer

COLORS = ((255, 60, 60), (60, 220, 60), (80, 140, 255), (255, 200, 0), (255, 0, 255), (0, 230, 230))
NEW = "a new one"


def _same_place(one: Click, other: Click) -> bool:
    return (one.spot, one.camera, one.frame) == (other.spot, other.camera, other.frame)


class SpotTool(Tool):
    """Clicks are kept as they are made, in a table beside the run: RUN/clicks/SEQUENCE.csv.

    What tracking says is not drawn: it would lead the hand.
    """

    name: ClassVar[str] = "true spots"
    needs: ClassVar[tuple[str, ...]] = ("frames",)

    def __init__(self, viewer: Viewer, desk: Desk):
        super().__init__(viewer, desk)
        self.spot = self.gui.add_dropdown("spot", (NEW,))
        self.undo = self.gui.add_button("take the last click back")
        self.score = self.gui.add_button("score")
        self.told = self.gui.add_markdown("")
        self.clicks: list[Click] = []
        self.undo.on_click(lambda _: viewer.post(self._undo))
        self.score.on_click(lambda _: viewer.post(self._score))

    def take(self) -> None:
        """Begin with the clicks that there are."""
        self.file = score.clicks_file(open_run(self.viewer.opened.folder), self.viewer.sequence.name)
        self.clicks = []
        self.told.content = f"Click one spot of the object in this frame, then in later ones. Kept in {self.file}"
        if self.file.is_file():
            self.clicks = read_clicks(self.file)
        self.desk.open(self._clicked)
        self._name_spots(NEW)
        self.frame_changed()

    def lay_down(self) -> None:
        """Leave the images."""
        self.desk.close()

    def frame_changed(self) -> None:
        """Show the frame with the clicks on it."""
        import cv2

        sequence, frame = self.viewer.sequence, self.viewer.frame
        images, names = self.pictures(frame), self._names()
        for c, camera in enumerate(sequence.cameras):
            number = self._number(c)
            for click in self.clicks:
                if (click.camera, click.frame) == (camera.name, number):
                    at, color = (round(click.column), round(click.row)), COLORS[names.index(click.spot) % len(COLORS)]
                    cv2.drawMarker(images[c], at, color, cv2.MARKER_CROSS, 14, 1)
                    label(images[c][max(at[1] - 18, 0) :, min(at[0] + 2, images[c].shape[1] - 1) :], click.spot)
            label(images[c], f"{camera.name}, image {number}" if number >= 0 else f"{camera.name} lost this frame")
        self.desk.show(images)

    def _number(self, camera: int) -> int:
        """What the recording calls the image that is shown; -1 where the camera lost it."""
        frames = self.viewer.sequence.get("frames")
        assert frames is not None
        return int(frames.row("source_frame", self.viewer.frame)[camera])

    def _names(self) -> list[str]:
        return list(dict.fromkeys(click.spot for click in self.clicks))

    def _name_spots(self, chosen: str) -> None:
        self.spot.options = (*self._names(), NEW)
        self.spot.value = chosen

    def _clicked(self, camera: int, pixel: tuple[float, float]) -> None:
        number, name = self._number(camera), self.viewer.sequence.cameras[camera].name
        if number < 0:
            self.told.content = f"{name} lost this frame: its picture is of another moment; take another frame"
            return
        spot = self.spot.value
        if spot == NEW:
            spot = next(str(k) for k in range(1, 10_000) if str(k) not in self._names())
        one = Click(spot, name, number, *pixel)
        self._change(lambda clicks: [*(c for c in clicks if not _same_place(c, one)), one])
        self._name_spots(spot)

    def _undo(self) -> None:
        if not self.clicks:
            return
        last = self.clicks[-1]
        self._change(lambda clicks: [c for c in clicks if not _same_place(c, last)])
        self._name_spots(last.spot if last.spot in self._names() else NEW)

    def _change(self, change: Callable[[list[Click]], list[Click]]) -> None:
        """Change the table as it is now, whoever else clicks; one without clicks is no file."""
        with open_run(self.viewer.opened.folder).lock(f"clicks/{self.viewer.sequence.name}"):
            self.clicks = change(read_clicks(self.file) if self.file.is_file() else [])
            if self.clicks:
                write_clicks(self.file, self.clicks)
            else:
                self.file.unlink(missing_ok=True)
        lines = [
            f"**{name}**: images {', '.join(str(n) for n in sorted({c.frame for c in self.clicks if c.spot == name}))}"
            for name in self._names()
        ]
        self.told.content = "\n\n".join([*lines, f"kept in {self.file}"])
        self.frame_changed()

    def _score(self) -> None:
        """Say how far tracked particles are off; `piegraph score` keeps it."""
        sequence, file = self.viewer.sequence, self.file
        run, name, why = open_run(self.viewer.opened.folder), sequence.name, sequence.missing("masks", "tracks")
        frames, masks = sequence.get("frames"), sequence.get("masks")
        if frames is None or masks is None or why:
            self.told.content = why
            return

        def scored() -> tuple[str, list[str]]:
            if not file.is_file():
                raise DataError("there is no click yet", str(file), "click one spot of the object in two frames")
            tracks = run.read("tracks", name)  # fresh ones were made of frames and masks that are
            inputs = {"frames": lazily(frames), "masks": lazily(masks), "tracks": tracks}
            return score.score_clicks(inputs, file)[1:]

        def tell(found: tuple[str, list[str]]) -> None:
            told, warnings = found
            keeps = f"`{command_line('score', '--run', run.folder)}` keeps it"
            self.told.content = "\n\n".join([f"**{told}**", *warnings, keeps])

        self.told.content = "looking …"
        self.look_up(scored, tell, self.told)
